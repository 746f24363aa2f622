"""A kernel on disk is out of date as soon as any file of its code has changed."""

import subprocess
import sys
from pathlib import Path

from estimation.kernel_cache import source_digest

ROOT = Path(__file__).resolve().parents[2]
CALLER = """
from estimation.execution import compiled
from toolbox.steps.one import step

@compiled
def twice(x):
    return 2 * step(x)
"""
CALLEE = """
from estimation.execution import compiled
from toolbox import constant

@compiled
def step(x):
    return x + constant.SHIFT
"""


def package(folder: Path, shift: float) -> Path:
    (folder / "toolbox" / "steps").mkdir(parents=True, exist_ok=True)
    for init in ("toolbox/__init__.py", "toolbox/steps/__init__.py"):
        (folder / init).touch()
    (folder / "toolbox" / "constant.py").write_text(f"SHIFT = {shift}\n")
    (folder / "toolbox" / "steps" / "one.py").write_text(CALLEE)
    (folder / "toolbox" / "caller.py").write_text(CALLER)
    return folder / "toolbox" / "caller.py"


def run(folder: Path) -> tuple[float, int]:
    """The kernel's result in a process of its own, and how often it came from disk."""
    code = "from toolbox.caller import twice; print(twice(1.0), sum(twice.stats.cache_hits.values()))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={"PYTHONPATH": f"{folder}:{ROOT}", "PATH": ""},
        capture_output=True,
        text=True,
        check=True,
    )
    result, hits = done.stdout.split()
    return float(result), int(hits)


def test_kernel_follows_a_change_in_another_file(tmp_path):
    package(tmp_path, 1.0)
    assert run(tmp_path) == (4.0, 0)
    assert run(tmp_path) == (4.0, 1)
    package(tmp_path, 2.0)
    assert run(tmp_path) == (6.0, 0)


def test_digest_covers_imports_of_imports_and_nothing_else(tmp_path):
    caller = package(tmp_path, 1.0)
    other = tmp_path / "toolbox" / "other.py"
    before = source_digest(caller)
    other.write_text("X = 1\n")
    assert source_digest(caller) == before
    assert source_digest(package(tmp_path / "copy", 2.0)) != before
