"""Kernels are compiled once: the tiny runs reach all that real runs use, and the marker says what is there."""

from __future__ import annotations

import json
import pkgutil
from importlib import import_module
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

import estimation
import sim
from estimation.kernel_cache import source_digest
from isac_arena import kernels as module
from isac_arena.campaign.load import library_campaigns
from isac_arena.own_packages import ROOT

RARE = {  # kernels that the tiny runs do not reach
    "noise._even": "is part of the kernel that calls it",
    "line_evidence.segment_log_likelihood": "contours.method = 'points'",
    "mic_likelihood.log_likelihood": "contours.method = 'points' and 'mic'",
    "contour._circle_paths": "predictions of one circle, for tests and figures",
    "wall._wall_paths": "predictions of one wall, for tests and figures",
    "raised.raised_range": "points with a height of their own",
    "raised._predicted": "points with a height of their own",
    "assignment._assign_raised": "points with a height of their own",
}
LARGE = {"campus_arena_63", "campus_arena_hardware"}  # the first takes 400 MB a stop; the second is a tiny run


@pytest.fixture
def marker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A marker of one source and one file, in a folder of its own."""
    path, kernel = tmp_path / "marker.json", tmp_path / "kernel.nbi"
    kernel.touch()
    monkeypatch.setattr(module, "_marker", lambda: path)
    name = "sim/signal/noise.py"
    content = {"machine": module._machine(), "sources": {name: source_digest(ROOT / name)}, "files": [str(kernel)]}
    path.write_text(json.dumps(content))
    return path


def test_the_marker_is_of_these_sources_this_machine_and_these_files(marker: Path) -> None:
    good = json.loads(marker.read_text())
    assert module.kernels_compiled()
    other = {
        "machine": ["1.0", "3.9.0", "z80"],
        "sources": {"sim/signal/noise.py": "other"},
        "files": ["/none.nbi"],
    }
    for key, value in other.items():
        marker.write_text(json.dumps(good | {key: value}))
        assert not module.kernels_compiled(), key
    for text in ("", "[]", "{}", '{"machine": 3}'):
        marker.write_text(text)
        assert not module.kernels_compiled(), text
    marker.unlink()
    assert not module.kernels_compiled()


def test_kernels_are_compiled_where_they_are_missing_alone(marker: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problems, said = ["", "ValueError: no compiler"], StringIO()
    monkeypatch.setattr(module, "compile_side_by_side", lambda: problems.pop(0))
    module.ensure_kernels(Console(file=said))
    assert len(problems) == 2
    marker.unlink()
    module.ensure_kernels(Console(file=said))
    assert len(problems) == 1 and not said.getvalue()
    module.ensure_kernels(Console(file=said, width=200))
    assert said.getvalue() == "kernels: ValueError: no compiler; they are compiled where they are first used\n"


def test_a_failure_in_the_process_that_compiles_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "__name__", "no_such_module")
    assert module.compile_side_by_side() == "ModuleNotFoundError: No module named 'no_such_module'"


def kernels_on_disk() -> set[str]:
    """The kernels that the tiny runs left on disk, by module and name."""
    if not module.kernels_compiled():
        assert module.compile_side_by_side() == ""
    files = [Path(name) for name in json.loads(module._marker().read_text())["files"]]
    return {file.name.rpartition("-")[0].split("-")[0] for file in files}


def test_the_tiny_runs_compile_all_kernels_but_those_of_rare_settings() -> None:
    """A kernel that they do not reach belongs here with its reason, or the tiny runs need one more setting."""
    for package in (sim, estimation):
        for each in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if each.name != "sim.propagation.tracer":
                import_module(each.name)
    found = {f"{path.stem}.{one.py_func.__name__}" for path, each in module.kernels().items() for one in each}
    assert found - kernels_on_disk() <= RARE.keys()


def used() -> set[tuple[str, str]]:
    """Kernels that this process has called, with the types of their arguments."""
    return {
        (f"{path.stem}.{one.py_func.__name__}", str(types))
        for path, each in module.kernels().items()
        for one in each
        for types in one.signatures
    }


@pytest.mark.whole
def test_campaigns_of_the_library_use_what_the_tiny_runs_compile() -> None:
    for one in module.WARM_UPS:
        module.tiny_run(*one).scores()
    known = used()
    for name in library_campaigns():
        if name not in LARGE:
            module.tiny_run(name, module.POWER, 8).scores()  # some of the stops of fixed nodes fail
            new = used() - known
            assert {kernel for kernel, _ in new} <= RARE.keys(), name
