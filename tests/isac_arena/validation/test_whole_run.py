"""The costs of a whole run: ratios of a record, the page, and the quick bench."""

import pytest

from isac_arena.validation.benches.run_cost import STAGES, RunCost, performance_page, stage_table
from isac_arena.validation.benches.whole_run import bench_whole_run

STAGES_S = {
    "plan": 1.0, "trace": 2.0, "samples": 2.0, "channel": 10.0, "maps": 6.0, "scores": 0.5, "report": 1.5,
    "files": 1.0,
}  # fmt: skip
COST = RunCost("box_room", 4, 2.0, 1.0, STAGES_S, 0.05, 0.01, 39.0, 900.0)


def test_ratios_of_a_run():
    assert COST.run_over_generation == pytest.approx(24 / 3)
    assert COST.scoring_share == pytest.approx(2 / 16)


def test_the_table_has_every_stage_in_seconds_and_passes():
    rows = {row[0]: row[1:] for row in stage_table(COST).rows}
    assert [name for name in rows if name in STAGES.values()] == list(STAGES.values())
    assert rows["channel estimates"] == (10.0, 2.5, pytest.approx(50.0), "41.7%")
    assert rows["whole run"] == (24.0, 6.0, pytest.approx(120.0), "100.0%")
    assert rows["rays and samples alone"] == (3.0, 0.75, pytest.approx(15.0), "12.5%")


def test_the_page_names_floor_stages_and_its_command():
    page = performance_page([COST, COST])
    assert "arena bench campaign --page docs/performance.md" in page
    assert "| box_room | 39 MB | 50.0 ms | 10.0 ms | 900 MB |" in page
    assert page.count("| channel estimates | 10.00 | 2.500 | 50 | 41.7% |") == 2
    assert "8.0 times its rays and samples alone. The largest part is channel estimates: 42%" in page


@pytest.mark.whole
def test_the_quick_bench_times_every_stage_and_writes_the_page(tmp_path):
    page = tmp_path / "performance.md"
    found = bench_whole_run(1, True, page)
    assert [row.key for row in found.rows] == ["campaign.run_over_generation", "campaign.score_and_report_share"]
    (table,) = found.tables
    assert all(seconds > 0 for _, seconds, *_ in table.rows)
    assert page.read_text().startswith("# Performance\n")
