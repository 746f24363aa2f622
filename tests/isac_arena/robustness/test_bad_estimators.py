"""A finished run and functions that fail: the run stays as it was, byte for byte, until another is whole."""

import shutil
from pathlib import Path

import pytest

import isac_arena as ia
from isac_arena.campaign import files
from tests.command_line import arena_here, failure

pytestmark = pytest.mark.whole  # whole commands: `.ci/run` runs them after the quick tests

FUNCTIONS = """
import os, sys, warnings
from pathlib import Path
import numpy as np
from estimation.channel.config import ChannelConfig
from estimation.channel.estimate import estimate_channel

def good(sweep):
    return estimate_channel(sweep, config=ChannelConfig(method="power"))

def raises(sweep):
    raise KeyError("mine")

def late(sweep):
    return 1 / 0 if sweep.stop == 3 else good(sweep)

def leaves(sweep):
    sys.exit(0)

def dies(sweep):
    os._exit(0) if sweep.stop == 1 else None
    return good(sweep)

def nothing(sweep):
    return None

def stops(sweep):
    raise KeyboardInterrupt

def moves(sweep):
    os.chdir("/")
    np.seterr(all="raise")
    warnings.simplefilter("error")
    return good(sweep)
"""


def tree(folder: Path) -> dict[str, bytes]:
    """Contents of all files but those in side folders."""
    found = (file for file in folder.rglob("*") if file.is_file() and ".part" not in str(file))
    return {str(file.relative_to(folder)): file.read_bytes() for file in found}


@pytest.fixture(scope="module")
def made(finished: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bad") / "finished"
    shutil.copytree(finished, folder)
    (folder / "bad.py").write_text(FUNCTIONS)
    return folder


@pytest.mark.parametrize("verb", ["estimate", "run"])
@pytest.mark.parametrize("name", ["raises", "leaves", "nothing", "absent", "stops"])
def test_a_failed_estimator_leaves_the_run_as_it_was(made: Path, verb: str, name: str) -> None:
    before = tree(made / "run")
    command = ("estimate", "run") if verb == "estimate" else ("run", "small.toml", "--out", "run")
    line = failure(*command, "--estimator", f"bad:{name}", cwd=made)
    assert ("interrupted" if name == "stops" else "channel = 'bad:") in line
    assert tree(made / "run") == before


@pytest.mark.parametrize("name", ["late", "dies"])
def test_a_function_that_fails_at_one_stop_loses_that_stop_alone(
    made: Path, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(made)  # its source is part of what the results depend on
    shutil.copytree(made / "run", tmp_path / "run")
    stop = {"late": 3, "dies": 1}[name]
    done = arena_here("estimate", tmp_path / "run", "--estimator", f"bad:{name}", cwd=made)
    assert done.returncode == 1 and f"channel = 'bad:{name}': stop {stop}: " in done.stderr
    assert done.stderr.count("\n") == 1 and "the run went on without" in done.stderr
    assert arena_here("score", tmp_path / "run", cwd=made).returncode == 0
    run = ia.open(tmp_path / "run")
    status = [estimate.status for estimate in run.channel]
    assert status[stop] == "failed" and status.count("ok") == len(status) - 1
    assert f"stop {stop}: " in run.channel[stop].reason
    assert arena_here("verify", tmp_path / "run", cwd=made).returncode == 0
    again = arena_here("estimate", tmp_path / "run", cwd=made)  # the stop that failed is tried again
    assert again.returncode == 1 and f"stop {stop}: " in again.stderr
    assert not list((tmp_path / "run").glob(".*")), "the side folder of another command is removed"


def test_a_lost_record_is_made_again_and_nothing_else_changes(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "run", tmp_path / "run")
    before = tree(tmp_path / "run")
    for name in ("truth/stop_000.nc", "channel/stop_001.nc", "map/slam.nc"):
        (tmp_path / "run" / name).unlink()
        assert arena_here("estimate", tmp_path / "run", cwd=made).returncode == 0
        after = tree(tmp_path / "run")
        assert {one for one in before if after.get(one) != before[one]} <= {"manifest.json"}, name
    (tmp_path / "run" / "scene.toml").rename(tmp_path / "scene.toml")
    assert "scene.toml: missing" in failure(
        "compare", tmp_path / "run", "run", "--out", tmp_path / "out", cwd=made
    )
    (tmp_path / "scene.toml").rename(tmp_path / "run" / "scene.toml")
    (tmp_path / "run" / "manifest.json").unlink()
    kept = tree(tmp_path / "run")
    for verb in ("estimate", "score"):
        assert "which results report.html shows" in failure(verb, tmp_path / "run", cwd=made)
        assert tree(tmp_path / "run") == kept


@pytest.mark.slow
def test_a_failed_budget_leaves_the_one_before_as_it_was(made: Path, tmp_path: Path) -> None:
    command = ("budget", "small.toml", "--out", tmp_path / "budget", "--stops", "0:2")
    assert arena_here(*command, cwd=made).returncode == 0
    before = tree(tmp_path)
    for name in ("raises", "leaves", "nothing", "stops"):
        failure(*command, "--estimator", f"bad:{name}", cwd=made)
        assert tree(tmp_path) == before, name
    assert arena_here(*command, "--estimator", "bad:good", cwd=made).returncode == 0
    assert tree(tmp_path).keys() == before.keys() and not list((tmp_path / "budget").glob(".*"))
    assert arena_here("verify", tmp_path / "budget", "--share", "0", cwd=made).returncode == 0
    assert "holds a campaign" in failure("budget", "small.toml", "--out", "run", cwd=made)


def test_a_full_disk_in_a_second_run_loses_nothing(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = tree(made / "run")
    command = ("run", "small.toml", "--out", "run", "--estimator", "bad:good")
    write = files.write_bytes
    written = []

    def full(path: Path, content: bytes) -> None:
        written.append(path)
        if len(written) == 7:
            raise OSError(28, "No space left on device", str(path))
        write(path, content)

    with monkeypatch.context() as patched:
        patched.setattr(files, "write_bytes", full)
        assert "No space left" in failure(*command, cwd=made)
    assert tree(made / "run") == before


def test_a_whole_run_replaces_the_first(made: Path, tmp_path: Path) -> None:
    whole = tmp_path / "run"
    shutil.copytree(made / "run", whole)
    assert (
        arena_here(
            "run", made / "small.toml", "--out", tmp_path / "fresh", "--estimator", "bad:good", cwd=made
        ).returncode
        == 0
    )
    for name in ("good", "moves"):
        again = arena_here("estimate", whole, "--estimator", f"bad:{name}", cwd=made)
        assert again.returncode == 0, again.stderr
        assert not (whole / "scores.json").exists() and not (whole / "report.html").exists()
        assert not list(whole.glob(".*.part"))
        assert arena_here("score", whole, cwd=made).returncode == 0
        if name == "good":
            assert arena_here("report", whole, cwd=made).returncode == 0
            found, fresh = tree(whole), tree(tmp_path / "fresh")
            assert {name for name in fresh if found.get(name) != fresh[name]} <= {"manifest.json"}
            assert found.keys() == fresh.keys()
        assert arena_here("verify", whole, "--share", "0", cwd=made).returncode == 0
