"""`arena new`, `arena settings` and `arena campaign`: files to start from run, and every setting is documented."""

from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from pydantic import BaseModel

import isac_arena as ia
from isac_arena.settings import FILES, setting_tables, settings_page
from isac_arena.sweep.config import SweepConfig
from isac_arena.sweep.plan import make_plan
from isac_arena.user_functions.room import close_rooms
from scenes.random_arena import random_arena
from scenes.toml_config import load_config
from tests.command_line import arena_here, failure


def leaves(model: type[BaseModel]) -> set[tuple[str, str]]:
    """Fields of a model and of all models in it that hold no model, by model and name, without the schema."""
    found: set[tuple[str, str]] = set()
    for name, field in model.model_fields.items():
        inner = list(models(field.annotation))
        found |= set().union(*map(leaves, inner)) if inner else {(model.__doc__ or "", name)}
    return found


def models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in models(argument)]


@pytest.mark.parametrize("file", FILES)
def test_every_setting_is_documented(file: str) -> None:
    tables = setting_tables(file)
    assert all(row.meaning and row.default and row.unit for table in tables for row in table.settings)
    assert all(row.allowed != "-" for table in tables for row in table.settings)
    there = {(doc.partition("\n\n")[0].split()[0], name) for doc, name in leaves(FILES[file])}
    documented = {(table.about.split()[0], row.name) for table in tables for row in table.settings}
    assert documented == there
    page = settings_page()
    assert all(f"| `{row.name}` |" in page for table in tables for row in table.settings)


def test_a_new_campaign_and_a_new_scene_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments in (("scene", "hall"), ("campaign", "mine", "--scene", "hall.toml")):
        assert arena_here("new", *arguments, cwd=tmp_path).returncode == 0
    campaign = ia.load_campaign("mine.toml")
    default = ia.load_campaign({"name": "mine", "scene": "box_room", "seed": 1})
    assert {**campaign.config.model_dump(), "scene": "box_room"} == default.config.model_dump()
    assert len(campaign.stops) == 12 and campaign.trace([0])[0].paths.is_los.sum() == 1
    assert "is there already" in failure("new", "scene", "hall", cwd=tmp_path)
    lines = Path("mine.toml").read_text().splitlines()
    first, last = lines.index("[mapping]"), lines.index("[trajectory]")
    chosen = [" = " in line and " = ..." not in line for line in lines[first:last]]  # "..." has no default
    lines[first:last] = [
        line.removeprefix("# ") if own else line for line, own in zip(lines[first:last], chosen, strict=True)
    ]
    Path("all.toml").write_text("\n".join(lines))
    every = ia.load_campaign("all.toml").config
    assert (every.mapping, every.slam.noise) == (default.config.mapping, default.config.slam.noise)


def test_a_random_scene_is_that_of_its_seed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = arena_here("new", "scene", "maze", "--random", 101, "--stops", 5, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    scene = ia.load_scene("maze.toml")
    made = random_arena(np.random.default_rng(101), 0.5, 5)
    assert scene.name == "maze" and scene.object_names == made.object_names and len(scene.stops) == 5


def test_a_new_estimator_and_a_new_sweep_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arena_here("new", "estimator", "my_lab", cwd=tmp_path)
    names: dict[str, Any] = {}
    exec(compile(Path("my_lab.py").read_text(), "my_lab.py", "exec"), names)
    campaign = ia.load_campaign("box_room", waveform={"comb": 12})
    (truth,) = campaign.trace([1])
    found = ia.estimate_channel(campaign.observe(truth), names["estimate"])
    los_s = truth.paths.delay_s[truth.paths.is_los] + truth.clock_bias_s
    assert found.delay_s[0] == pytest.approx(los_s[0], abs=1e-9)
    assert "must be a Python name" in failure("new", "estimator", "my-lab", cwd=tmp_path)
    for hides in ("class", "random", "numpy"):  # a numpy.py in this folder would stop every later command
        assert "must not hide a word or module" in failure("new", "estimator", hides, cwd=tmp_path)
        assert not Path(f"{hides}.py").exists()
    arena_here("new", "sweep", "power", cwd=tmp_path)
    config = load_config("power.toml", SweepConfig)
    assert len(make_plan("power.toml", config, tmp_path / "out", range(config.repeats)).jobs) == 8


@pytest.mark.whole
@pytest.mark.parametrize(
    "stage",
    [
        "channel",
        "shapes",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("mapping", "slam", "tracker")),
    ],
)
def test_a_new_function_of_every_stage_passes_its_test(
    stage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    assert arena_here("new", "estimator", f"own_{stage}", "--stage", stage, cwd=tmp_path).returncode == 0
    names: dict[str, Any] = {}
    exec(compile(Path(f"test_own_{stage}.py").read_text(), f"test_own_{stage}.py", "exec"), names)
    tests = [value for name, value in names.items() if name.startswith("test_")]
    assert len(tests) == 1
    tests[0]()
    close_rooms()


def test_the_library_and_the_settings_are_listed(tmp_path: Path) -> None:
    listed = arena_here("campaign", "list").stdout.splitlines()
    assert [line.split()[0] for line in listed] == ia.library_campaigns() and all(
        len(line) < 150 and line.endswith(".") for line in listed
    )
    shown = arena_here("campaign", "show", "box_room").stdout
    assert 'scene = "box_room"' in shown and "4 receiver stops" in shown
    assert "tolerance_db" in arena_here("settings", "channel.los").stdout
    assert "table = 'chanel': must be campaign, scene, sweep, dataset, recording or one of" in failure(
        "settings", "chanel"
    )
    assert arena_here("settings", "--out", tmp_path / "page.md").returncode == 0
    assert (tmp_path / "page.md").read_text() == settings_page()
