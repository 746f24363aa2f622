"""One attempt: a command in a process of its own, with limits, and how it ended."""

import json
import multiprocessing
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from unittest import mock

from threadpoolctl import threadpool_limits

from isac_arena.cli.main import guarded, main

Outcome = Literal["refused", "accepted", "internal", "hang", "outside"]
CPU_S = 10  # a command that is refused, or reads a file, is done long before
WALL_S = 120.0
ENDS = "SystemExit"


@dataclass(frozen=True)
class Trial:
    """How a command ended: refused in one line, accepted, by an error of ours or a signal, or not in time."""

    what: str
    outcome: Outcome
    line: str
    peak_mb: float


def command(*arguments: object) -> Callable[[], None]:
    """A command line, as it runs in a process of its own."""

    def run() -> None:
        with mock.patch("sys.argv", ["arena", *map(str, arguments)]):
            main()

    return run


def call(function: Callable[..., object], *arguments: Any) -> Callable[[], None]:
    """A function, run as a command runs it."""

    def run() -> None:
        def silent() -> None:
            function(*arguments)

        guarded(silent)

    return run


def warm(run: Callable[[], None], folder: Path) -> None:
    """Run something in this process, without output: forks of it have its imports and its compiled code.

    From now on this process has one thread: a pool of threads does not survive a fork, which would wait for it.
    """
    os.environ["OMP_NUM_THREADS"] = "1"  # of libraries that are loaded later
    threadpool_limits(1)
    before, path, hook = Path.cwd(), sys.path[:], sys.unraisablehook
    os.chdir(folder)
    try:
        with open(os.devnull, "w", encoding="utf-8") as null, redirect_stderr(null), redirect_stdout(null):
            run()
    except BaseException as end:  # every command ends by one
        if type(end).__name__ != ENDS:
            raise
    finally:
        os.chdir(before)
        sys.path[:], sys.unraisablehook = path, hook


def attempt(what: str, run: Callable[[], None], folder: Path, cpu_s: int = CPU_S) -> Trial:
    """Run something in a fork of this process, with `folder` as its working directory."""
    result = folder.parent / f"{folder.name}.json"
    result.unlink(missing_ok=True)
    process = start(run, folder, cpu_s)
    process.join(WALL_S)
    if process.is_alive():
        process.kill()
        process.join()
        return Trial(what, "hang", "no end", 0.0)
    if not result.is_file():
        ended = -(process.exitcode or 0)
        is_late = ended in (signal.SIGXCPU, signal.SIGKILL)
        return Trial(what, "hang" if is_late else "internal", f"signal {ended}", 0.0)
    found = json.loads(result.read_text(encoding="utf-8"))
    lines = [line for line in found["errors"].splitlines() if line.strip()]
    is_one_line = len(lines) == 1 and lines[0].startswith("arena: ")
    outcome: Outcome = "internal"
    if found["code"] == 0:
        outcome = "accepted"
    elif found["code"] in (1, 2, 130) and (is_one_line or found["code"] == 1):
        outcome = "refused"
    return Trial(what, outcome, lines[-1][:300] if lines else "", found["peak_mb"])


def start(run: Callable[[], None], folder: Path, cpu_s: int = CPU_S) -> Any:
    """Start something in a fork of this process."""
    process = multiprocessing.get_context("fork").Process(target=_inside, args=(run, folder, cpu_s))
    process.start()
    return process


def _inside(run: Callable[[], None], folder: Path, cpu_s: int) -> None:
    """In the new process: limits, the working directory, output to files, and at the end the result in a file."""
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.chdir(folder)
    code: Any = 0
    base = folder.parent / folder.name
    with (
        open(f"{base}.err", "w", encoding="utf-8") as errors,
        open(os.devnull, "w", encoding="utf-8") as nothing,
        redirect_stderr(errors),
        redirect_stdout(nothing),
    ):
        try:
            run()
        except BaseException as error:
            code = getattr(error, "code", None)
            if type(error).__name__ != ENDS:
                errors.write(traceback.format_exc())
                code = 99
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    text = Path(f"{base}.err").read_text(encoding="utf-8", errors="replace")
    partial = Path(f"{base}.part")
    partial.write_text(json.dumps({"code": code or 0, "errors": text, "peak_mb": peak_mb}), encoding="utf-8")
    partial.rename(f"{base}.json")


def tree(folder: Path) -> dict[str, bytes]:
    """Contents of all files below a folder but those of unfinished work."""
    found = {}
    for file in sorted(folder.rglob("*")):
        name = file.relative_to(folder).as_posix()
        if file.is_file() and ".part" not in name:
            found[name] = file.read_bytes()
    return found


def wait_until(condition: Callable[[], bool], process: Any, seconds: float) -> None:
    """Wait for a condition while a process lives, and no longer than a time."""
    ends = time.monotonic() + seconds
    while not condition() and process.is_alive() and time.monotonic() < ends:
        time.sleep(0.002)
