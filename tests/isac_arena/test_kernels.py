"""Kernels are compiled once: the tiny runs reach all that real runs use, and the marker says what is there."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from estimation.kernel_cache import source_digest
from isac_arena import kernels as module
from isac_arena.own_packages import ROOT


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
