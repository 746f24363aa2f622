"""Sweeps of campaigns with several TX, and with links."""

from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from threadpoolctl import threadpool_limits
from typer.testing import CliRunner

from isac_arena.campaign.campaign import load_campaign
from isac_arena.cli.main import app
from isac_arena.sweep.cases import make_cases
from isac_arena.sweep.config import SweepConfig
from isac_arena.sweep.job import make_job, store_scene
from isac_arena.sweep.plan import make_plan
from isac_arena.sweep.run import make_signals, read_times, score_case
from isac_arena.verification.compare import compare_records
from scenes.toml_config import load_config
from tests.isac_arena.cli.sweep_files import write_sweep

pytestmark = pytest.mark.whole  # whole commands: `.ci/run` runs them after the quick tests
SWEPT = """
name = "one case"
base = "small.toml"
stop_every = 15
"""


def several(folder: Path, devices: str) -> Path:
    """A sweep of the hall of pillars over what sends, every 15th stop."""
    write_sweep(
        folder, 1, **{"link.tx_power_dbm": "tx", "[0.0, 20.0]": devices, "stop_every = 2": "stop_every = 15"}
    )
    campaign = (folder / "small.toml").read_text()
    (folder / "small.toml").write_text(campaign.replace("box_room", "pillar_hall"))
    return folder / "sweep.toml"


def test_a_sweep_over_the_number_of_tx(tmp_path: Path) -> None:
    several(tmp_path, '["south_west", ["south_west", "north_east"]]')
    arena = CliRunner().invoke
    done = arena(app, ["sweep", str(tmp_path / "sweep.toml"), "--out", str(tmp_path / "out"), "--workers", "1"])
    assert done.exit_code == 0, done.output
    table = pq.read_table(tmp_path / "out" / "results.parquet").to_pydict()
    chosen = [row for row, key in enumerate(table["key"]) if key == "slam.position.bound_m"]
    assert [table["power"][row] for row in chosen] == ['"south_west"', '["south_west", "north_east"]']
    alone, both = (table["value"][row] for row in chosen)
    assert both < alone
    assert arena(app, ["verify", str(tmp_path / "out"), "--share", "1"]).exit_code == 0


def test_several_tx_and_links_in_a_sweep_have_the_scores_of_a_run(tmp_path: Path) -> None:
    links = 'tx = "aisle"\nrx = ["south_west"]\n[[links]]\ntx = "north_east"\nrx = ["aisle", "south_west"]\n'
    for added in ('tx = ["south_west", "north_east"]\n', f"[[links]]\n{links}"):
        file = several(tmp_path, '["-"]')
        file.write_text(SWEPT)
        text = (tmp_path / "small.toml").read_text()
        place = text.index("[waveform]") if added.startswith("tx") else len(text)
        (tmp_path / "small.toml").write_text(f"{text[:place]}{added}{text[place:]}")
        config = load_config(file, SweepConfig)
        plan = make_plan(str(file), config, tmp_path / "out", range(1))
        for scene in plan.scenes.values():
            store_scene(tmp_path / "out", scene)
        case = next(make_cases(str(file), config, [()], range(1)))
        job = make_job(replace(case, stages="all_kept"), tmp_path / "out", plan.jobs[0].n_stops)
        assert job.missing(job.paths_file) == list(job.stops)
        make_signals(job, job.stops[:1])
        with threadpool_limits(limits=1):
            whole = load_campaign(tmp_path / "small.toml").chain(job.stops).scores()
        swept = score_case(job)
        assert compare_records("tables", whole.tables, swept.tables).holds(exact=True)
        assert not job.missing(job.paths_file) and not job.missing(job.estimate_file)
        times = read_times(job)
        assert compare_records("tables", score_case(job).tables, swept.tables).holds(exact=True)
        assert read_times(job) == times and len(times) > len(job.stops)
