"""The command line for tests: in a process of its own, or in this one where only its output and files matter."""

import io
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from importlib import invalidate_caches
from pathlib import Path
from unittest import mock

from isac_arena.cli.main import main

ROOT = Path(__file__).resolve().parents[1]
ARENA = [sys.executable, "-c", "from isac_arena.cli.main import main; main()"]

Result = subprocess.CompletedProcess[str]


def environment(columns: int = 200) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": str(columns)}


def arena(*arguments: object, cwd: Path = ROOT) -> Result:
    """A command in a process of its own."""
    command = [*ARENA, *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, cwd=cwd, env=environment(), check=False, timeout=600
    )


def arena_here(*arguments: object, cwd: Path = ROOT, columns: int = 200) -> Result:
    """A command in this process, which has imported and compiled what it needs: seconds faster.

    A user's modules in `cwd` are imported anew each time.
    """
    out, err, command = io.StringIO(), io.StringIO(), ["arena", *map(str, arguments)]
    path, hook, before = sys.path[:], sys.unraisablehook, Path.cwd()
    imported = set(sys.modules)
    invalidate_caches()  # of the files in a folder
    os.chdir(cwd)
    try:
        with (
            redirect_stdout(out),
            redirect_stderr(err),
            mock.patch.object(sys, "argv", command),
            mock.patch.dict(os.environ, COLUMNS=str(columns)),
        ):
            main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    finally:
        os.chdir(before)
        sys.path[:], sys.unraisablehook = path, hook
        for name in set(sys.modules) - imported:
            if cwd != ROOT and Path(getattr(sys.modules[name], "__file__", None) or ROOT).parent == cwd:
                del sys.modules[name]
    return subprocess.CompletedProcess(command, code, out.getvalue(), err.getvalue())


def failure(*arguments: object, cwd: Path = ROOT) -> str:
    """The one line of a command that has to fail cleanly."""
    result = arena_here(*arguments, cwd=cwd)
    assert result.returncode not in (0, 70), result
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("arena: "), result.stderr
    assert "Traceback" not in result.stdout
    return lines[0]
