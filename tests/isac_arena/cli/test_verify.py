import json
import shutil
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from isac_arena.campaign.files import remove_file, write_bytes, write_text
from isac_arena.campaign.manifest import check_files, read_manifest
from isac_arena.campaign.recording import recorded_run
from isac_arena.cli.main import app
from isac_arena.verification.compare import TOLERANCE, compare_metrics, compare_records
from scenes.pose import Pose
from tests.command_line import arena_here as arena
from tests.isac_arena.cli.sweep_files import write_sweep


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
    assert "computed again: 6 of 6 agree bit by bit" in sweep.stdout


def test_results_of_another_version_are_computed_again(copies: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("isac_arena.campaign.directory.code_digest", lambda *parts: "another version")
    result = verify(copies / "run", 0.3)
    assert result.exit_code == 0, result.output
    assert "agree" in result.output and "missing" not in result.output


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
    assert f"{copies / 'none'}: holds no campaign and no sweep" in str(verify(copies / "none").exception)


def test_results_that_are_not_what_comes_out_are_named(copies: Path) -> None:
    run = copies / "run"
    scores = json.loads((run / "scores.json").read_text())
    at = next(index for index, row in enumerate(scores) if row["key"] == "slam.position.rmse_m")
    scores[at]["value"] *= 0.5
    with recorded_run(run):  # somebody who covers it up
        write_text(run / "scores.json", json.dumps(scores))
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


@pytest.mark.parametrize(
    ("verb", "options"),
    [("estimate", ()), ("score", ()), ("report", ()), ("view", ("--no-open",)), ("export", ("--format", "tum"))],
)
def test_a_command_refuses_what_is_damaged_and_never_covers_it_up(
    copies: Path, verb: str, options: tuple[str, ...]
) -> None:
    run = copies / "run"
    manifest = (run / "manifest.json").read_bytes()
    shutil.copy(run / "channel" / "stop_000.nc", run / "channel" / "stop_001.nc")  # whole, but another file
    refused = CliRunner().invoke(app, [verb, str(run), *options])
    assert isinstance(refused.exception, ValueError)
    told = str(refused.exception)
    assert f"{run}/channel/stop_001.nc: damaged or edited since it was written" in told
    assert "remove it and run 'arena estimate' again" in told
    assert (run / "manifest.json").read_bytes() == manifest
    assert verify(run).exit_code == 1


def test_a_command_enters_what_it_wrote_and_nothing_else(copies: Path) -> None:
    run = copies / "run"
    scores = run / "scores.json"
    scores.write_text(scores.read_text().replace("1", "2", 1))  # which a report does not read
    (run / "notes.txt").write_text("mine")
    (run / "view.html").write_text("made by hand")
    (run / "figures" / "map.png").write_bytes(b"drawn over")
    for command in (
        ["report", str(run)],
        ["view", str(run), "--no-open"],
        ["export", str(run), "--format", "tum"],
        ["export", str(run), "--format", "geojson", "--out", str(copies / "elsewhere")],
    ):
        assert CliRunner().invoke(app, command).exit_code == 0
    found = check_files(run)
    assert found.changed == ("scores.json",) and found.unknown == ("notes.txt",) and found.missing == ()
    assert {"view.html", "export/slam.tum", "figures/map.png"} <= set(read_manifest(run).files)
    assert "scores.json: damaged or edited since it was written" in verify(run).output


def test_a_run_that_did_not_end_is_told_and_mended_by_the_next(copies: Path) -> None:
    run = copies / "run"
    with suppress(KeyboardInterrupt), recorded_run(run):
        remove_file(run / "scores.json")
        write_bytes(run / "channel" / "stop_001.nc", (run / "channel" / "stop_000.nc").read_bytes())
        raise KeyboardInterrupt
    result = verify(run)
    assert result.exit_code == 1 and "manifest.json: a run here did not end" in result.output
    assert check_files(run).unknown == ("channel/stop_001.nc",)
    (run / "channel" / "stop_001.nc").unlink()
    assert CliRunner().invoke(app, ["estimate", str(run)]).exit_code == 0
    assert CliRunner().invoke(app, ["score", str(run)]).exit_code == 0
    assert verify(run).exit_code == 0


def test_damaged_settings_and_budgets_are_named_by_every_command(copies: Path) -> None:
    run = copies / "run"
    settings = (run / "campaign.json").read_text()
    for text in (settings[:-30], settings.replace("small", "large")):
        (run / "campaign.json").write_text(text)
        for verb in ("score", "report"):
            told = str(CliRunner().invoke(app, [verb, str(run)]).exception)
            assert f"{run}/campaign.json: damaged or edited since it was written; put it back" in told
    (run / "campaign.json").write_text(settings)
    with recorded_run(run / "budget"):
        pass
    assert "budget.json: missing; run 'arena budget'" in str(
        CliRunner().invoke(app, ["report", str(run)]).exception
    )
    (run / "manifest.json").unlink()
    (run / "campaign.json").write_text(settings[:-30])
    told = str(CliRunner().invoke(app, ["score", str(run)]).exception)
    assert f"{run}/campaign.json: damaged, or of another version" in told and "put it back" in told


def test_a_value_changed_in_a_file_is_noticed_by_every_command(copies: Path) -> None:
    with h5py.File(copies / "run" / "channel" / "stop_000.nc", "a") as file:
        file["channel/delay_s"][0] *= 1.01
    result = arena("score", copies / "run", cwd=copies)
    assert result.returncode == 2 and result.stderr.count("\n") == 1
    assert "channel/stop_000.nc: damaged" in result.stderr
