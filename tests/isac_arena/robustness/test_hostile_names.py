"""Names that lead out of a folder are refused by every command, and nothing appears outside the output folder."""

import json
import shutil
from pathlib import Path

import pytest

from isac_arena.campaign.manifest import MANIFEST
from scenes.config import LIBRARY
from scenes.names import name_from, path_in
from tests.command_line import arena_here, failure
from tests.isac_arena.cli.sweep_files import CAMPAIGN, SWEEP, write_sweep

HOSTILE = [
    "..",
    "../../owned",
    "/tmp/owned",
    "a/b",
    "a\\b",
    ".hidden",
    "",
    " ",
    "a\tb",
    "x" * 300,
    "-rf",
    "a\u202eb",
]


def tree(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.mark.parametrize("name", HOSTILE)
def test_every_command_refuses_a_hostile_name(finished: Path, tmp_path: Path, name: str) -> None:
    work = tmp_path / "deep" / "er"
    work.mkdir(parents=True)
    text = json.dumps(name)
    (work / "campaign.toml").write_text(CAMPAIGN.replace('"small"', text))
    (work / "small.toml").write_text(CAMPAIGN)
    (work / "sweep.toml").write_text(SWEEP.format(repeats=1).replace('"two powers"', text))
    room = (LIBRARY / "box_room.toml").read_text()
    (work / "scene.toml").write_text(room.replace('name = "box_room"', f"name = {text}"))
    (work / "object.toml").write_text(room.replace('name = "pillar"', f"name = {text}"))
    shutil.copytree(finished / "run", work / "run")
    (work / "run" / MANIFEST).unlink()
    settings = json.loads((work / "run" / "campaign.json").read_text())
    settings["campaign"]["name"] = name
    (work / "run" / "campaign.json").write_text(json.dumps(settings))
    before = tree(tmp_path)
    commands = [
        *((verb, "campaign.toml", "--out", "out") for verb in ("run", "generate", "ablate", "budget")),
        ("link", "campaign.toml"),
        ("bound", "campaign.toml", "--out", "out.png"),
        *((verb, "run") for verb in ("estimate", "score", "report", "view")),
        *(
            ("export", "run", "--format", kind, "--out", "out")
            for kind in ("mat", "deepmimo", "tum", "geojson", "glb")
        ),
        ("export-sigmf", "run", "--stop", "0", "--tx-beam", "0"),
        ("twin", "run", "--out", "out"),
        ("sweep", "sweep.toml", "--out", "out"),
        *(("scene", "show", file) for file in ("scene.toml", "object.toml")),
        *(("scene", "export", file, "--format", "xml") for file in ("scene.toml", "object.toml")),
    ]
    for command in commands:
        line = failure(*command, cwd=work)
        assert "name = " in line, (command, line)
        assert tree(tmp_path) == before, command


def test_a_stored_name_cannot_lead_out(finished: Path, tmp_path: Path) -> None:
    for name in ("..", "../x", "/etc/passwd", "", ".", "a/../../b", "\0"):
        with pytest.raises(ValueError, match="leads out of"):
            path_in(tmp_path, name)
    assert path_in(tmp_path, "scene_files/a%2Fb.csv") == tmp_path / "scene_files" / "a%2Fb.csv"
    content = json.loads((finished / "run" / MANIFEST).read_text())
    shutil.copytree(finished / "run", tmp_path / "run")
    content["files"]["../../secret"] = next(iter(content["files"].values()))
    (tmp_path / "run" / MANIFEST).write_text(json.dumps(content))
    assert "../../secret" in failure("verify", tmp_path / "run")


def test_any_text_gives_a_valid_name() -> None:
    for text in [*HOSTILE, "hall (2).v1", "Häuser", "\ud800", "ü" * 90]:
        name = name_from(text)
        assert path_in(Path("a"), name).parent == Path("a") and len(name.encode()) <= 120
    assert name_from("hall (2).v1") == "hall (2).v1"


@pytest.mark.parametrize("name", ["scores.json", "truth/stop_000.nc", "channel", "figures", "scene_files", "map"])
def test_links_that_leave_a_run_are_refused(finished: Path, tmp_path: Path, name: str) -> None:
    work, outside = tmp_path / "work", tmp_path / "outside"
    work.mkdir()
    outside.mkdir()
    write_sweep(work)
    shutil.copytree(finished / "run", work / "run")
    place = work / "run" / name
    if place.exists():
        place.rename(outside / "kept")
    place.symlink_to(outside / "kept" if (outside / "kept").exists() else outside)
    before = tree(outside)
    commands = [
        ("run", "small.toml", "--out", "run"),
        *((verb, "run") for verb in ("estimate", "score", "report", "view", "verify")),
        ("export", "run", "--format", "tum", "--out", "out"),
        ("export-sigmf", "run", "--stop", "0", "--tx-beam", "0"),
        ("compare", "run", "run", "--out", "out"),
        ("sweep", "sweep.toml", "--out", "run"),
    ]
    for command in commands:
        assert "a link that leads out of" in failure(*command, cwd=work), command
        assert tree(outside) == before, command


def test_links_within_a_run_are_followed(finished: Path, tmp_path: Path) -> None:
    shutil.copytree(finished / "run", tmp_path / "run")
    (tmp_path / "run" / "scores.json").rename(tmp_path / "run" / "kept.json")
    (tmp_path / "run" / "scores.json").symlink_to("kept.json")
    (tmp_path / "link").symlink_to("run")
    assert arena_here("report", "link", cwd=tmp_path).returncode == 0
