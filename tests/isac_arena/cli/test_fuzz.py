"""Mutated configs and damaged files: one line or the whole truth, never a traceback, a hang or a part of it."""

import ast
import copy
import json
import pickle
import random
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from isac_arena.campaign.files import read_record
from isac_arena.campaign.load import LIBRARY as CAMPAIGNS
from isac_arena.campaign.load import resolve_campaign
from isac_arena.campaign.manifest import read_manifest
from isac_arena.campaign.results import StopEstimate
from isac_arena.cli.main import app
from isac_arena.scoring.record import ScoreTables
from isac_arena.sweep.cases import design_points
from isac_arena.sweep.config import SweepConfig
from isac_arena.sweep.store import read_failures, read_plan, read_scores, read_sweep
from isac_arena.verification.compare import compare_records
from scenes.config import LIBRARY as SCENES
from scenes.config import SceneConfig
from scenes.toml_config import validate_config
from sim.truth import Truth
from tests.command_line import ROOT, arena_here, environment
from tests.isac_arena.cli.sweep_files import CAMPAIGN, SWEEP

JUNK: list[Any] = [
    0, -1, 1, 2**63, -(2**70), 1e308, -1e-308, 0.0, -0.0, float("nan"), float("inf"), True, False, "", "x", "0",
    "../..", "/dev/null", "\x00", "a" * 5000, [], [[]], [1], [None], {}, {"type": "circle"}, {"a": {"b": []}},
    None, [1.0, 2.0], [[0.0, 0.0], [0.0, 0.0]], "nan", "é\n", {"name": "wall"},
]  # fmt: skip
CONFIG_SEEDS = 150
FILE_SEEDS = 200


def mutated(document: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """A document with one to three values replaced, dropped, added or doubled somewhere inside."""
    changed = copy.deepcopy(document)
    for _ in range(rng.randint(1, 3)):
        here: Any = changed
        while True:
            keys = list(here) if isinstance(here, dict) else list(range(len(here)))
            if not keys:
                break
            key = rng.choice(keys)
            if isinstance(here[key], dict | list) and here[key] and rng.random() < 0.8:
                here = here[key]
                continue
            action = rng.choice(("replace", "replace", "replace", "drop", "add"))
            if action == "replace":
                here[key] = copy.deepcopy(rng.choice(JUNK))
            elif action == "drop":
                del here[key]
            elif isinstance(here, dict):
                here[rng.choice(("type", "name", "seed", "extra", str(key) + "s"))] = copy.deepcopy(
                    rng.choice(JUNK)
                )
            else:
                here.append(copy.deepcopy(rng.choice([*here, *JUNK])))
            break
    return changed


def damaged(content: bytes, rng: random.Random) -> bytes:
    """The bytes of a file with some of them changed, cut off, doubled or blanked."""
    data = bytearray(content)
    at, length = rng.randrange(len(data) or 1), rng.choice((1, 1, 1, 4, 64, 1024))
    match rng.choice(("flip", "flip", "noise", "cut", "blank", "double")):
        case "flip" if data:
            data[at] ^= 1 << rng.randrange(8)
        case "noise":
            data[at : at + length] = rng.randbytes(len(data[at : at + length]))
        case "cut":
            del data[at:]
        case "blank":
            data[at : at + length] = bytes(len(data[at : at + length]))
        case _:
            data[at:at] = data[at : at + length]
    return bytes(data)


def checked(call: Any, *arguments: Any) -> None:
    """The call succeeds, or fails with an error that the command line tells in one line."""
    try:
        call(*arguments)
    except (ValueError, OSError) as error:
        assert str(error)


def seeds(quick: int, slow: int) -> list[Any]:
    return [*range(quick), *(pytest.param(slow + part, marks=pytest.mark.slow) for part in range(5))]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", seeds(1, 100))
def test_mutated_campaign_and_sweep_files_are_refused_in_one_line(seed: int, tmp_path: Path) -> None:
    rng = random.Random(seed)
    campaigns = [
        tomllib.loads(CAMPAIGN),
        *(tomllib.loads(file.read_text()) for file in sorted(CAMPAIGNS.glob("*.toml"))),
    ]
    sweep = tomllib.loads(SWEEP.format(repeats=2)) | {"until": {"metric": "a", "half_width": 0.1}}
    ranges = {"design": "random", "n_points": 3, "axes": [{"field": "a", "low": 1.0, "high": 2.0, "log": True}]}
    for _ in range(CONFIG_SEEDS):
        checked(resolve_campaign, mutated(rng.choice(campaigns), rng), tmp_path / "c.toml")

        def made(document: dict[str, Any]) -> None:
            config = validate_config(document, SweepConfig, "s.toml")
            if (config.n_points or 0) <= 1000 and all((axis.count or 0) <= 100 for axis in config.axes):
                design_points(config)

        checked(made, mutated(rng.choice((sweep, {**sweep, **ranges})), rng))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", seeds(1, 100))
def test_mutated_scene_files_are_refused_in_one_line(seed: int, tmp_path: Path) -> None:
    rng = random.Random(seed)
    scenes = [tomllib.loads(file.read_text()) for file in sorted(SCENES.glob("*.toml"))]

    def built(document: dict[str, Any]) -> None:
        validate_config(document, SceneConfig, "s.toml").build(60e9, tmp_path)

    for _ in range(CONFIG_SEEDS):
        checked(built, mutated(rng.choice(scenes), rng))


FUZZ_RECORDS = """
import random, sys
from pathlib import Path
from tests.isac_arena.cli.test_fuzz import fuzz_records
fuzz_records(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
"""


def fuzz_records(folder: Path, seed: int, count: int) -> None:
    """Damage records and read them: an error of one line, or every bit of what was written."""
    rng = random.Random(seed)
    kinds = {"paths": Truth, "provenance": ScoreTables, "channel": StopEstimate}
    originals = {
        name: (file, kind, file.read_bytes(), read_record(file, kind))
        for name, kind in kinds.items()
        if (file := folder / f"{name}.nc").is_file()
    }
    assert originals
    for trial in range(count):
        name, (file, kind, content, whole) = rng.choice(sorted(originals.items()))
        changed = file.with_name(f"changed_{name}.nc")
        changed.write_bytes(damaged(content, rng))
        try:
            record = read_record(changed, kind)
        except ValueError as error:
            assert len(str(error).splitlines()) == 1 and str(changed) in str(error), (trial, error)
        else:
            assert compare_records(name, whole, record).holds(exact=True), (trial, name)


@pytest.mark.parametrize("seed", seeds(1, 100))
def test_damaged_records_are_refused_or_whole(undisturbed: Path, tmp_path: Path, seed: int) -> None:
    out = undisturbed / "out"
    for name, pattern in (("paths", "paths/*/*.nc"), ("provenance", "cases/*/provenance.nc")):
        (tmp_path / f"{name}.nc").write_bytes(min(out.glob(pattern)).read_bytes())
    result = subprocess.run(
        [sys.executable, "-c", FUZZ_RECORDS, str(tmp_path), str(seed), str(FILE_SEEDS)],
        env=environment(), cwd=ROOT, capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert result.returncode == 0, (result.returncode, result.stderr[-2000:])


@pytest.mark.parametrize("seed", seeds(1, 100))
def test_damaged_sweep_files_are_one_line(undisturbed: Path, tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    out = undisturbed / "out"
    key = min(path.name for path in (out / "cases").iterdir())
    names = ["sweep.json", "plan.json", "manifest.json", f"cases/{key}/manifest.json", f"cases/{key}/scores.json"]
    (tmp_path / "cases" / key).mkdir(parents=True)
    (tmp_path / "failures").mkdir()
    for name in names:
        (tmp_path / name).write_bytes((out / name).read_bytes())
    scores = read_scores(out, key)
    for _ in range(FILE_SEEDS):
        name = rng.choice(names)
        (tmp_path / name).write_bytes(damaged((out / name).read_bytes(), rng))
        (tmp_path / "failures" / "a.json").write_bytes(damaged(b'{"error": "x"}', rng))
        for call in (read_sweep, read_plan, read_manifest, read_failures):
            checked(call, tmp_path)
        try:
            assert read_scores(tmp_path, key) == scores  # or not at all
        except (ValueError, OSError) as error:
            assert len(str(error).splitlines()) == 1
        (tmp_path / name).write_bytes((out / name).read_bytes())


def test_a_command_on_a_damaged_campaign_ends_in_one_line(undisturbed: Path, tmp_path: Path) -> None:
    made = arena_here("generate", "small.toml", "--out", tmp_path / "run", "--no-keep-sweeps", cwd=undisturbed)
    assert made.returncode == 0, made.stderr
    rng = random.Random(1)
    files = sorted(path for path in (tmp_path / "run").rglob("*") if path.is_file())
    for _ in range(12):
        file = rng.choice(files)
        content = file.read_bytes()
        while (changed := damaged(content, rng)) == content:
            pass
        file.write_bytes(changed)
        result = CliRunner().invoke(app, ["verify", str(tmp_path / "run"), "--share", "0"])
        assert result.exit_code == 1
        if isinstance(result.exception, SystemExit):
            assert f"{file.relative_to(tmp_path / 'run')}: damaged or edited" in result.output
        else:
            assert isinstance(result.exception, ValueError) and file.name in str(result.exception)
            assert len(str(result.exception).splitlines()) == 1
        file.write_bytes(content)


def test_no_pickle_is_read_from_any_file(undisturbed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folders = [ROOT / name for name in ("scenes", "sim", "estimation", "scripts")]
    for file in sorted(path for folder in folders for path in folder.rglob("*.py")):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
        names |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert not {"pickle", "cPickle", "shelve", "marshal", "dill", "cloudpickle", "joblib"} & names, file
        for node in ast.walk(tree):
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                assert isinstance(node.value, ast.Constant) and node.value.value is False, file

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a pickle was read")

    for name in ("load", "loads", "Unpickler"):
        monkeypatch.setattr(pickle, name, refuse)
    out = undisturbed / "out"
    assert read_record(min(out.glob("cases/*/provenance.nc")), ScoreTables)
    assert json.loads((out / "manifest.json").read_text())["files"] == read_manifest(out).files
