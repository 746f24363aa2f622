import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from scripts.arena import app

CAMPAIGN = """
name = "small"
scene = "box_room"
[waveform]
n_rb = 132
[tx_array]
rows = 1
columns = 8
beams_per_panel = 12
[rx_array]
rows = 1
columns = 8
beams_per_panel = 12
panel_azimuth_deg = [-180.0, -90.0, 0.0, 90.0]
[propagation]
max_bounces = 1
diffuse_samples = 0
diffraction = false
compare_planar = false
"""
SWEEP = """
name = "two by two"
base = "small.toml"
stop_every = 15
repeats = 2
[[axes]]
field = "link.tx_power_dbm"
label = "power"
values = [0.0, 20.0]
"""


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))  # workers find the user's estimator there
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "small.toml").write_text(CAMPAIGN)
    (tmp_path / "sweep.toml").write_text(SWEEP)
    return tmp_path


def run(folder: Path, out: str, *options: str, file: str = "sweep.toml"):
    return CliRunner().invoke(app, ["sweep", str(folder / file), "--out", str(folder / out), *options])


def results(folder: Path) -> bytes:
    return (folder / "results.parquet").read_bytes() + (folder / "results.csv").read_bytes()


def test_one_and_two_workers_and_a_resumed_sweep_give_the_same_bytes(files):
    assert run(files, "one", "--workers", "1").exit_code == 0
    assert run(files, "two", "--workers", "2").exit_code == 0
    assert results(files / "one") == results(files / "two")
    done = sorted((files / "two" / "cases").iterdir())
    assert len(done) == 4
    for case in done[::2]:
        (case / "scores.json").unlink()
        for rest in case.iterdir():
            rest.unlink()
        case.rmdir()
    assert run(files, "two", "--workers", "1").exit_code == 0
    assert results(files / "one") == results(files / "two")
    assert not list((files / "two").rglob("*.part"))
    table = pq.read_table(files / "two" / "results.parquet").to_pydict()
    assert set(table["power"]) == {0.0, 20.0}
    assert set(table["seed"]) == {1, 2}
    assert len({(case, key) for case, key in zip(table["case"], table["key"], strict=True)}) == len(
        table["key"]
    )


def test_a_failed_case_is_recorded_and_stops_no_other(files):
    (files / "mine.py").write_text(
        "from estimation.channel.power import estimate_power\n"
        "def estimate(sweep):\n"
        "    import os\n"
        "    if os.path.exists(os.path.join(os.path.dirname(__file__), 'broken')):\n"
        "        raise RuntimeError('broken on purpose')\n"
        "    return estimate_power(sweep)\n"
    )
    (files / "broken").touch()
    (files / "sweep.toml").write_text(
        SWEEP.replace("repeats = 2", "repeats = 1")
        .replace("link.tx_power_dbm", "estimator")
        .replace("[0.0, 20.0]", '["mine:estimate", "estimation.channel.power:estimate_power"]')
    )
    failed = run(files, "out", "--workers", "1")
    assert failed.exit_code == 1
    assert "1 of 2 cases done, 1 failed" in failed.output
    assert "broken on purpose" in failed.output
    again = run(files, "out", "--workers", "1")
    assert again.exit_code == 1 and "1 failed" in again.output
    (files / "broken").unlink()
    mended = run(files, "out", "--workers", "1", "--retry-failed")
    assert mended.exit_code == 0, mended.output
    assert "2 of 2 cases done, 0 failed" in mended.output


def test_points_are_repeated_until_the_mean_is_known(files):
    until = '[until]\nmetric = "slam.position.rmse_m"\nhalf_width = 1e-9\nmax_repeats = 3\n'
    (files / "sweep.toml").write_text(SWEEP + until)
    assert run(files, "out", "--workers", "1").exit_code == 0
    cases = [json.loads(file.read_text()) for file in (files / "out").glob("cases/*/campaign.json")]
    assert {case["repeat"] for case in cases if case["point"] == 1} <= {0, 1, 2}
    assert max(case["repeat"] for case in cases) == 2


def test_a_dry_run_writes_nothing_and_wrong_sweeps_are_refused(files):
    planned = run(files, "out", "--dry-run")
    assert planned.exit_code == 0
    assert "4 cases, 2 points of 1 axes" in planned.output
    assert not (files / "out").exists()
    (files / "sweep.toml").write_text(SWEEP.replace("20.0", '"loud"'))
    refused = run(files, "out", "--dry-run")
    assert refused.exit_code != 0
    assert 'link.tx_power_dbm = "loud"' in str(refused.exception)
    (files / "taken").mkdir()
    (files / "taken" / "thesis.txt").touch()
    (files / "sweep.toml").write_text(SWEEP)
    assert "holds other files" in str(run(files, "taken").exception)
    assert (files / "taken" / "thesis.txt").exists()
