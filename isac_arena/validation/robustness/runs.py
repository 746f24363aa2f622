"""Attacks on a finished run and on one at work: bad functions, kills, full disks, two commands."""

import errno
import os
import random
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

from isac_arena.validation.robustness.attempt import Trial, attempt, command, start, tree, wait_until, warm
from isac_arena.validation.robustness.files import PLAN_TAIL, write_inputs
from isac_arena.validation.robustness.functions import BODIES, SOURCE
from isac_arena.validation.robustness.made import N_STOPS, write_campaign

RUN = ("run", "small.toml", "--out", "run", "--keep-sweeps")
INPUTS = ("small.toml", "room.toml", "sweep.toml", "bad_lab.py", "plan.csv")
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
RUN_CPU_S = 60
ENDS_S = 60.0


@dataclass(frozen=True)
class Finished:
    """A run that ended, its files, and how long it took."""

    folder: Path
    files: dict[str, bytes]
    seconds: float


def finished_run(folder: Path, seed: int) -> Finished:
    """Make the small campaign in a folder and run it to its report; `RuntimeError` where that fails."""
    folder.mkdir(parents=True)
    write_campaign(folder, seed)
    write_inputs(folder)
    with (folder / "room.toml").open("a", encoding="utf-8") as file:
        file.write(PLAN_TAIL.format(plan="csv"))
    (folder / "bad_lab.py").write_text(SOURCE, encoding="utf-8")
    warm(command(*RUN), folder)
    shutil.rmtree(folder / "run")
    started = time.monotonic()
    expect(attempt("run", command(*RUN), folder, RUN_CPU_S))
    return Finished(folder, tree(folder / "run"), time.monotonic() - started)


def bad_functions(made: Finished, count: int | None) -> Iterator[tuple[Trial, bool]]:
    """Every bad estimator on the finished run, and whether its bytes stayed.

    Those that succeed count as well, and those that fail at some stops, where the command goes on without these.
    """
    for name in list(BODIES)[:: 1 if count is None else max(1, len(BODIES) // count)]:
        with _copy(made) as folder:
            verb = ("estimate", "run", "--estimator", f"bad_lab:{name}")
            ended = attempt(name, command(*verb), folder, CPU_OF_FUNCTION_S)
            stays = tree(folder / "run") == made.files
            yield ended, ended.outcome == "accepted" or stays or _went_on(ended, folder / "run")


def _went_on(ended: Trial, run: Path) -> bool:
    """Whether a command named the stops where the function failed, and made all others and the maps."""
    made = len(list(run.glob("channel/stop_*.nc"))) == N_STOPS and len(list(run.glob("map/*.nc"))) == 2
    return made and ended.outcome == "refused" and WENT_ON in ended.line


WENT_ON = "; the run went on without"
CPU_OF_FUNCTION_S = 20


def killed_runs(made: Finished, rng: random.Random, count: int) -> Iterator[bool]:
    """Kill a run at a random moment or at a file replacement; then whether the same command mends it."""
    n_files = len(made.files)
    for trial in range(count):
        number = SIGNALS[trial % len(SIGNALS)]
        with _fresh(made) as folder:
            if trial % 2:
                process = start(_killing(command(*RUN), rng.randrange(n_files), number), folder, RUN_CPU_S)
            else:
                process = start(command(*RUN), folder, RUN_CPU_S)
                ends = time.monotonic() + rng.uniform(0.0, made.seconds)
                wait_until(lambda ends=ends: time.monotonic() > ends, process, ENDS_S)  # type: ignore[misc]
                if process.is_alive():
                    os.kill(process.pid, number)
            process.join(ENDS_S)
            yield _mended(made, folder)


def full_disks(made: Finished, rng: random.Random, count: int) -> Iterator[bool]:
    """Fill the disk at a random write of a run: one line, and the same command mends it."""
    for _ in range(count):
        with _fresh(made) as folder:
            ended = attempt("disk", _filling(command(*RUN), rng.randrange(1, 8)), folder, RUN_CPU_S)
            yield ended.outcome == "refused" and _mended(made, folder)


def two_at_once(made: Finished) -> bool:
    """Two runs in one directory: one does the work, the other is refused in one line or finds it done."""
    with _fresh(made) as folder:
        first = start(command(*RUN), folder, RUN_CPU_S)
        wait_until((folder / "run" / "campaign.json").exists, first, ENDS_S)
        other = folder / "other"
        other.mkdir()
        second = attempt(
            "second", command("run", "../small.toml", *RUN[2:3], "../run", *RUN[4:]), other, RUN_CPU_S
        )
        first.join(ENDS_S)
        return second.outcome == "refused" and "another run" in second.line and tree(folder / "run") == made.files


def _mended(made: Finished, folder: Path) -> bool:
    again = attempt("again", command(*RUN), folder, RUN_CPU_S)
    return again.outcome == "accepted" and tree(folder / "run") == made.files


class _Folder:
    """A working copy beside the finished run, removed at the end."""

    def __init__(self, made: Finished, *, with_run: bool) -> None:
        self.made, self.path, self.with_run = made, made.folder.parent / "copy" / "work", with_run

    def __enter__(self) -> Path:
        shutil.rmtree(self.path.parent, ignore_errors=True)
        self.path.mkdir(parents=True)
        for name in INPUTS:
            shutil.copy(self.made.folder / name, self.path / name)
        if self.with_run:
            shutil.copytree(self.made.folder / "run", self.path / "run")
        return self.path

    def __exit__(self, *error: object) -> None:
        shutil.rmtree(self.path.parent, ignore_errors=True)


def _copy(made: Finished) -> _Folder:
    return _Folder(made, with_run=True)


def _fresh(made: Finished) -> _Folder:
    return _Folder(made, with_run=False)


def _killing(run: Callable[[], None], at: int, number: int) -> Callable[[], None]:
    """A command that gets a signal at one of its file replacements, before it or after it."""
    replace, seen = os.replace, []

    def counted(source: Any, target: Any) -> None:
        seen.append(target)
        if len(seen) == at + 1 and at % 2:
            os.kill(os.getpid(), number)
        replace(source, target)
        if len(seen) == at + 1:
            os.kill(os.getpid(), number)

    def killed() -> None:
        with mock.patch("os.replace", counted):
            run()

    return killed


def _filling(run: Callable[[], None], at: int) -> Callable[[], None]:
    """A command whose disk is full at one of its writes, when half of the bytes are there."""
    write, seen = Path.write_bytes, []

    def full(self: Path, content: bytes) -> int:
        seen.append(self)
        if len(seen) >= at:
            write(self, bytes(content)[: len(content) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self))
        return write(self, content)

    def filled() -> None:
        with mock.patch.object(Path, "write_bytes", full):
            run()

    return filled


def expect(ended: Trial) -> None:
    """Raise `RuntimeError` where a command that is not attacked does not end well."""
    if ended.outcome != "accepted":
        raise RuntimeError(f"the run that is attacked did not end: {ended.line}")
