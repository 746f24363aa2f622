import json
import os
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from scenes.pose import Pose
from scripts.arena import app
from scripts.manifest import check_files, made_by, write_manifest
from scripts.verify_compare import TOLERANCE, compare_metrics, compare_records
from tests.scripts.sweep_files import arena, write_sweep


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a campaign in `run` and a sweep in `sweep`."""
    folder = tmp_path_factory.mktemp("made")
    write_sweep(folder, repeats=1)
    for command in (
        ("run", "small.toml", "--out", "run", "--keep-sweeps"),
        ("sweep", "sweep.toml", "--out", "sweep", "--workers", "1"),
    ):
        result = arena(*command, cwd=folder)
        assert result.returncode == 0, result.stderr
    return folder


@pytest.fixture
def copies(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path / "copy")  # with the times of the files
    return tmp_path / "copy"


def verify(directory: Path, share: float = 0.0) -> Result:
    return CliRunner().invoke(app, ["verify", str(directory), "--share", str(share)])


def test_untouched_directories_come_out_bit_by_bit(made: Path) -> None:
    campaign = arena("verify", made / "run", "--share", "0.5", cwd=made)
    assert campaign.returncode == 0, campaign.stdout
    for name in ("truth/stop_", "sweep/stop_", "channel/stop_", "map/slam.nc, poses", "scores.json"):
        assert f"  {name}" in campaign.stdout
    assert "agree bit by bit" in campaign.stdout and "made elsewhere" not in campaign.stdout
    sweep = arena("verify", made / "sweep", "--share", "1", cwd=made)
    assert sweep.returncode == 0, sweep.stdout
    assert sweep.stdout.count("provenance.nc: the same bits") == 2
    assert "computed once more: 6 of 6 agree bit by bit" in sweep.stdout


def test_damaged_edited_and_missing_files_are_named(copies: Path) -> None:
    run = copies / "run"
    damaged = bytearray((run / "map" / "slam.nc").read_bytes())
    damaged[len(damaged) // 2] ^= 1
    (run / "map" / "slam.nc").write_bytes(damaged)
    (run / "scene.toml").write_text((run / "scene.toml").read_text() + "\n")
    (run / "channel" / "stop_001.nc").unlink()
    (run / "notes.txt").touch()
    result = verify(run)
    assert result.exit_code == 1
    assert "map/slam.nc: damaged or edited since it was written" in result.output
    assert "scene.toml: damaged or edited" in result.output
    assert "channel/stop_001.nc: missing" in result.output
    assert "not of the run: notes.txt" in result.output
    (run / "manifest.json").unlink()
    assert "manifest.json: missing" in str(verify(run).exception)


def test_results_that_are_not_what_comes_out_are_named(copies: Path) -> None:
    run = copies / "run"
    scores = json.loads((run / "scores.json").read_text())
    at = next(index for index, row in enumerate(scores) if row["key"] == "slam.position.rmse_m")
    scores[at]["value"] *= 0.5
    (run / "scores.json").write_text(json.dumps(scores))
    write_manifest(run)  # somebody who covers it up
    result = verify(run, 0.25)
    assert result.exit_code == 1
    assert "scores.json: DIFFERS, by 1 of the largest value in slam.position.rmse_m" in result.output


def test_a_changed_table_or_case_of_a_sweep_is_named(copies: Path) -> None:
    sweep = copies / "sweep"
    text = (sweep / "results.csv").read_text()
    (sweep / "results.csv").write_text(text.replace("done", "fine", 1))
    result = verify(sweep)
    assert result.exit_code == 1
    assert "results.csv: damaged or edited" in result.output
    assert "results.csv: DIFFERS, does not hold what the cases hold" in result.output
    case = next((sweep / "cases").iterdir())
    (case / "scores.json").write_text("[]")
    assert f"{case.name}/scores.json: damaged or edited" in verify(sweep).output
    shutil.rmtree(case)
    assert "1 of 2 are missing" in verify(sweep).output


def test_bytes_changed_behind_the_manifest_stay_noticeable(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("first")
    write_manifest(tmp_path)
    times = (tmp_path / "a.txt").stat()
    (tmp_path / "a.txt").write_text("worst")
    os.utime(tmp_path / "a.txt", ns=(times.st_atime_ns, times.st_mtime_ns))  # as a fault of the disk would
    (tmp_path / "b.txt").write_text("second")
    write_manifest(tmp_path)
    assert check_files(tmp_path).changed == ("a.txt",)
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["made_by"] == [made_by()]
    manifest["made_by"][0]["code"] = "older"
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    (tmp_path / "c.txt").write_text("third")
    write_manifest(tmp_path)
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    origins = {
        name: manifest["made_by"][entry["made_by"]]["code"] for name, entry in manifest["files"].items()
    }
    assert origins == {"a.txt": "older", "b.txt": "older", "c.txt": made_by()["code"]}
    assert set(made_by()) == {"code", "python", "libraries", "machine", "threads"}


def test_files_that_were_added_are_no_damage(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("a")
    write_manifest(tmp_path)
    (tmp_path / "export").mkdir()
    (tmp_path / "export" / "b.txt").write_text("b")
    found = check_files(tmp_path)
    assert found.unknown == ("export/b.txt",) and found.problems == []


def test_differences_are_relative_and_nan_equals_nan() -> None:
    pose = Pose(np.array([1.0, 2.0, 4.0]), 0.5)
    near = Pose(np.array([1.0, 2.0, 4.0 * (1 + TOLERANCE / 2)]), 0.5)
    finding = compare_records("pose", pose, near)
    assert finding.where == "position_m" and finding.difference == pytest.approx(TOLERANCE / 2)
    assert finding.holds(exact=False) and not finding.holds(exact=True)
    row = {"key": "a", "value": None, "unit": "m", "direction": "lower"}
    assert compare_metrics("scores", [row], [row]).holds(exact=True)
    assert "finite in other places" in compare_metrics("scores", [row], [{**row, "value": 1.0}]).reason
    assert "other metrics: b" in compare_metrics("scores", [row], [row, {**row, "key": "b"}]).reason


def test_a_value_changed_in_a_file_is_noticed_by_every_command(copies: Path) -> None:
    with h5py.File(copies / "run" / "channel" / "stop_000.nc", "a") as file:
        file["channel/delay_s"][0] *= 1.01
    result = arena("score", copies / "run", cwd=copies)
    assert result.returncode == 2 and result.stderr.count("\n") == 1
    assert "channel/stop_000.nc: damaged" in result.stderr
