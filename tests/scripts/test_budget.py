"""`arena budget` on a small campaign: files, resuming, and bad input."""

import csv
import json

import pytest
from typer.testing import CliRunner

from scripts.arena import app
from scripts.budget_run import chosen_stops

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
diffuse_samples = 0
diffraction = false
compare_planar = false
[slam]
method = "statistical"
[shapes]
eps_m = 1.0
min_samples = 2
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("budget")
    (path / "small.toml").write_text(CAMPAIGN)
    return path


def run(folder, *options):
    return CliRunner().invoke(
        app, ["budget", str(folder / "small.toml"), "--out", str(folder / "out"), *options]
    )


@pytest.fixture(scope="module")
def done(folder):
    result = run(folder, "--stops", "0:4:2", "--repeats", "2")
    assert result.exit_code == 0, result.output
    return result


def test_the_parts_of_every_outcome_add_up_in_the_files(done, folder):
    found = json.loads((folder / "out" / "budget.json").read_text())
    assert found["stops"] == [0, 2] and found["repeats"] == 2
    kinds = {(row["outcome"], row["budget"]) for row in found["rows"]}
    assert {("pose", "stages"), ("pose", "physics"), ("shape", "stages")} <= kinds
    for outcome, kind in kinds:
        rows = [row for row in found["rows"] if (row["outcome"], row["budget"]) == (outcome, kind)]
        total = rows.pop()
        assert total["part"] == "all errors"
        assert sum(row["share"] for row in rows) == pytest.approx(1)
        if kind == "stages":
            assert rows[-1]["part"] == "rest" and rows[-1]["rms_m"] <= 1e-9
    physics = [
        row["part"] for row in found["rows"] if row["budget"] == "physics" and row["outcome"] == "pose"
    ]
    assert physics == ["multi-bounce paths", "noise", "rest", "all errors"]
    with (folder / "out" / "budget.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(found["rows"])
    assert (folder / "out" / "budget.png").read_bytes().startswith(b"\x89PNG")
    assert "pose error by stages" in done.output


def test_an_interrupted_budget_goes_on_to_the_same_end(done, folder):
    out = folder / "out"
    before = (out / "budget.json").read_bytes()
    kept = out / "repeat_00" / "all" / "channel" / "stop_000.nc"
    made = kept.stat().st_mtime_ns
    (out / "repeat_01" / "without_noise" / "errors" / "none.nc").unlink()
    (out / "repeat_01" / "all" / "errors" / "pose.nc").unlink()
    (out / "repeat_01" / "all" / "channel" / "stop_002.nc").unlink()
    assert run(folder, "--stops", "0:4:2", "--repeats", "2").exit_code == 0
    assert (out / "budget.json").read_bytes() == before
    assert kept.stat().st_mtime_ns == made


@pytest.mark.parametrize("text", ["9", "-1", "a", "0:x", "3:1", "1.5", ""])
def test_wrong_stops_are_named(folder, text):
    result = run(folder, "--stops", text)
    assert isinstance(result.exception, ValueError)
    assert str(result.exception).startswith(f"--stops = '{text}'")


def test_stops_are_chosen_as_in_python():
    assert chosen_stops(None, 3) == (0, 1, 2)
    assert chosen_stops("2,0,2", 3) == (0, 2)
    assert chosen_stops("1:", 4) == (1, 2, 3)
    assert chosen_stops("::2", 4) == (0, 2)
