"""Attacks on sweeps: fatal cases, two in one directory, killed processes, a scheduler of another version."""

import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from isac_arena.sweep.store import is_done, read_failures, read_plan
from isac_arena.validation.robustness.attempt import Outcome, Trial
from isac_arena.workers.cluster import worker_bytes

FATAL = ("crashes", "dies", "aborts", "kills_itself", "takes_memory", "grows", "spins", "leaves", "late")
FATAL_SWEEP = """
name = "fatal"
base = "small.toml"
[[axes]]
field = "estimator"
values = {values}
"""
GROWS = """
def grows(sweep):
    held = []
    for _ in range(100):
        held.append(np.ones(2**22))
        time.sleep(0.02)
    return good(sweep)
"""
SWEEP = """
name = "powers"
base = "small.toml"
repeats = 4
[[axes]]
field = "link.tx_power_dbm"
values = [0.0, 20.0]
"""
N_CASES = 8
WORKER_BYTES = 1.2e9  # over which dask ends a worker in the fatal sweep: `grows` takes 3 GB
LONGEST_S, FATAL_S = 300.0, 1800.0
PYTHON = (sys.executable, "-m")
ARENA = (*PYTHON, "isac_arena", "sweep", "sweep.toml", "--out", "out")
SCHEDULER = ("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
WORKER = (*PYTHON, "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", "--no-dashboard")
OLD = "import distributed.versions as v, runpy; v._version_cached = lambda name: '2020.1.0'; "
OLD += "runpy.run_module('distributed.cli.dask_scheduler', run_name='__main__', alter_sys=True)"
ROLES = ("client", "worker", "scheduler")


class Processes:
    """Commands in a folder, killed at the end where they still run."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._started = folder, list[subprocess.Popen[str]]()

    def start(self, *arguments: str, **environment: str) -> subprocess.Popen[str]:
        """Start a command that imports this program."""
        path = os.pathsep.join([str(Path(__file__).resolve().parents[3]), str(self.folder)])
        with tempfile.TemporaryFile("w+") as nothing:
            process = subprocess.Popen(
                arguments, cwd=self.folder, text=True, stdout=nothing, stderr=subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": path, **environment},
            )  # fmt: skip
        self._started.append(process)
        return process

    def end(self, *arguments: str, seconds: float = LONGEST_S, **environment: str) -> tuple[int, str]:
        """The exit code of a command, -1 where it does not end, and what it wrote to stderr."""
        process = self.start(*arguments, **environment)
        with suppress(subprocess.TimeoutExpired):
            return process.wait(seconds), self.errors(process)
        return -1, ""

    def errors(self, process: subprocess.Popen[str]) -> str:
        """What a process that ended wrote to stderr."""
        return process.communicate()[1]

    def scheduler(self, *command: str) -> tuple[subprocess.Popen[str], str]:
        """A scheduler and its address."""
        file = self.folder / f"scheduler{len(self._started)}.json"
        process = self.start(*command, "--scheduler-file", str(file))
        wait_for(lambda: file.is_file() and file.read_text(encoding="utf-8").rstrip().endswith("}"), process)
        return process, str(json.loads(file.read_text(encoding="utf-8"))["address"])

    def close(self) -> None:
        """Kill what still runs."""
        for process in self._started:
            process.kill()
            process.wait()
            if process.stderr is not None:
                process.stderr.close()


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[str], seconds: float = LONGEST_S) -> None:
    """Wait for a condition while a process lives, and no longer than a time."""
    ends = time.monotonic() + seconds
    while not condition() and process.poll() is None and time.monotonic() < ends:
        time.sleep(0.02)


@contextmanager
def _sandbox(made: Path, name: str) -> Iterator[Processes]:
    """A folder with the inputs of a sweep and nothing else, removed at the end."""
    folder = made.parent / name
    folder.mkdir()
    for file in made.iterdir():
        if file.is_file():
            shutil.copy(file, folder / file.name)
    (folder / "sweep.toml").write_text(SWEEP, encoding="utf-8")
    processes = Processes(folder)
    try:
        yield processes
    finally:
        processes.close()
        shutil.rmtree(folder, ignore_errors=True)


def fatal_cases(made: Path) -> list[bool]:
    """A sweep over good and fatal estimators: whether each good case is done, and each bad one is listed."""
    values = [f"bad_lab:{name}" for name in ("good", *FATAL)]
    with _sandbox(made, "fatal") as processes:
        folder = processes.folder
        (folder / "sweep.toml").write_text(FATAL_SWEEP.format(values=values), encoding="utf-8")
        with (folder / "bad_lab.py").open("a", encoding="utf-8") as file:
            file.write(f"\nimport time\n{GROWS}")
        limits = {"DASK_DISTRIBUTED__WORKER__MEMORY__TERMINATE": f"{WORKER_BYTES / worker_bytes(2):.4f}"}
        options = ("--workers", "2", "--stop-limit", "3")
        processes.end(*ARENA, *options, seconds=FATAL_S, **limits)
        if not (folder / "out" / "plan.json").is_file():
            return [False]
        cases, failures = read_plan(folder / "out"), read_failures(folder / "out")
        return [
            is_done(folder / "out", case.key) != (case.key in failures)
            and is_done(folder / "out", case.key) == (case.values == ("bad_lab:good",))
            for case in cases
        ]


def disturbed_sweeps(made: Path, rng: random.Random, count: int) -> Iterator[Trial]:
    """Sweeps that come out as an undisturbed one, or are refused in one line where they cannot run.

    Two in one directory, a scheduler of another version, and `count` kills of client, worker and scheduler.
    """
    with _sandbox(made, "undisturbed") as processes:
        first = processes.start(*ARENA, "--workers", "1")
        wait_for((processes.folder / "out" / "plan.json").is_file, first)
        yield _refused("two sweeps", *processes.end(*ARENA, "--workers", "1"), "another run is at work")
        wanted = _tables(processes, first.wait(LONGEST_S))
    with _sandbox(made, "version") as processes:
        _, address = processes.scheduler(sys.executable, "-c", OLD, *SCHEDULER[1:])
        yield _refused("another version", *processes.end(*ARENA, "--scheduler", address), "2020.1.0")
    for trial in range(count):
        with _sandbox(made, f"kill{trial}") as processes:
            tables, told = _killed(processes, ROLES[trial % 3], rng)
            outcome: Outcome = "accepted" if tables == wanted and isinstance(tables, bytes) else "internal"
            yield Trial(f"kill {trial} of the {ROLES[trial % 3]}", outcome, told[-300:], 0.0)


def _refused(what: str, code: int, told: str, wanted: str) -> Trial:
    """Whether a command was refused in one line that holds some words."""
    is_told = code == 2 and told.count("\n") == 1 and wanted in told
    return Trial(what, "refused" if is_told else "internal", f"{code}: {told[-300:]}", 0.0)


def _killed(processes: Processes, role: str, rng: random.Random) -> tuple[bytes | str, str]:
    """The tables of a sweep after one of its processes was killed and the same command run again; how it ended."""
    cases = processes.folder / "out" / "cases"
    scheduler, address = processes.scheduler(*PYTHON, *SCHEDULER)
    workers = [processes.start(*WORKER, address) for _ in range(2)]
    client = processes.start(*ARENA, "--scheduler", address)
    n_before = rng.randrange(N_CASES)
    wait_for(lambda: len(list(cases.glob("[!.]*/scores.json"))) >= n_before, client)
    {"client": client, "worker": workers[0], "scheduler": scheduler}[role].kill()
    try:
        code, told = client.wait(LONGEST_S), processes.errors(client)
    except subprocess.TimeoutExpired:
        return "", "the client did not end"
    is_expected = {"client": True, "worker": code == 0, "scheduler": not code or "scheduler was lost" in told}
    if not is_expected[role]:
        return "", f"after the kill, {code}: {told}"
    again = ("--scheduler", address) if role == "client" else ("--workers", "1")
    code, told = processes.end(*ARENA, *again)
    found = _tables(processes, code)
    return found, f"{code}: {told}{found if isinstance(found, str) else ''}"


def _tables(processes: Processes, code: int) -> bytes | str:
    """The tables of a sweep that ended well; what is wrong where it did not, or left something behind."""
    out = processes.folder / "out"
    left = [*(out / "failures").glob("*"), *out.rglob("*.part")]
    if code != 0 or left:
        return f"exit code {code}, {len(left)} failures and parts: {', '.join(file.name for file in left[:3])}"
    return (out / "results.csv").read_bytes() + (out / "results.parquet").read_bytes()
