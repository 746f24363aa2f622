"""Kill -9 of client, worker and scheduler: after a resume the tables are those of an undisturbed run."""

import csv
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from isac_arena.campaign.manifest import check_files
from tests.command_line import ARENA, arena_here, environment
from tests.isac_arena.cli.sweep_files import N_CASES, results, write_sweep

pytestmark = pytest.mark.whole  # whole commands: `.ci/run` runs them after the quick tests

SCHEDULER = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
WORKER = [sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", "--no-dashboard"]
ROLES = ("client", "worker", "scheduler")


def start(command: list[str], folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        command, env=environment(), cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def kill(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.communicate()


def sweeping(folder: Path, *options: str) -> subprocess.Popen[str]:
    return start([*ARENA, "sweep", str(folder / "sweep.toml"), "--out", str(folder / "out"), *options], folder)


class Cluster:
    """A scheduler and two worker processes on the loopback."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        file = folder / f"scheduler{time.monotonic_ns()}.json"
        self.scheduler = start([*SCHEDULER, "--no-dashboard", "--scheduler-file", str(file)], folder)
        wait_for(lambda: file.is_file() and file.read_text().endswith("}"), self.scheduler)
        self.address = json.loads(file.read_text())["address"]
        self.workers = [start([*WORKER, self.address], folder) for _ in range(2)]

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            kill(process)


@contextmanager
def cluster(folder: Path) -> Iterator[Cluster]:
    made = Cluster(folder)
    try:
        yield made
    finally:
        made.close()


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[str], seconds: float = 120) -> None:
    """Wait for a condition while a process lives."""
    ends = time.monotonic() + seconds
    while not condition() and process.poll() is None:
        assert time.monotonic() < ends, "nothing happened"
        time.sleep(0.02)


def done(folder: Path) -> dict[str, int]:
    """When each finished case was written, by its name."""
    return {
        file.parent.name: file.stat().st_mtime_ns for file in (folder / "out" / "cases").glob("[!.]*/scores.json")
    }


def check_whole(folder: Path, before: dict[str, int], undisturbed: Path) -> None:
    """The tables are those of an undisturbed run, what was done stayed, each case is there once."""
    assert results(folder / "out") == results(undisturbed / "out")
    after = done(folder)
    assert len(after) == N_CASES and before.items() <= after.items()
    with (folder / "out" / "results.csv").open(newline="") as file:
        rows = [(row["case"], row["key"]) for row in csv.DictReader(file)]
    assert len(rows) == len(set(rows)) and {case for case, _ in rows} == set(after)
    assert not list((folder / "out").rglob("*.part"))
    found = check_files(folder / "out")
    assert found.problems == [] and found.unknown == ()
    assert not list((folder / "out" / "failures").glob("*"))


def test_a_lost_worker_costs_nothing(undisturbed: Path, tmp_path: Path) -> None:
    write_sweep(tmp_path, repeats=N_CASES // 2)
    with cluster(tmp_path) as dask:
        client = sweeping(tmp_path, "--scheduler", dask.address)
        wait_for(lambda: len(done(tmp_path)) >= 2, client)
        assert client.poll() is None
        before = done(tmp_path)
        kill(dask.workers[0])
        output, error = client.communicate(timeout=120)
    assert client.returncode == 0, error
    assert f"{N_CASES} of {N_CASES} cases done, 0 failed" in output
    check_whole(tmp_path, before, undisturbed)


def test_a_killed_client_leaves_what_is_done(undisturbed: Path, tmp_path: Path) -> None:
    write_sweep(tmp_path, repeats=N_CASES // 2)
    client = sweeping(tmp_path, "--workers", "1")
    wait_for(lambda: len(done(tmp_path)) >= 2, client)
    kill(client)
    before = done(tmp_path)
    assert len(before) < N_CASES and not (tmp_path / "out" / "results.csv").exists()
    resumed = arena_here("sweep", "sweep.toml", "--out", "out", "--workers", "1", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    check_whole(tmp_path, before, undisturbed)


@pytest.mark.slow
def test_a_lost_scheduler_ends_the_sweep_in_one_line(undisturbed: Path, tmp_path: Path) -> None:
    write_sweep(tmp_path, repeats=N_CASES // 2)
    with cluster(tmp_path) as dask:
        client = sweeping(tmp_path, "--scheduler", dask.address)
        wait_for(lambda: len(done(tmp_path)) >= 2, client)
        kill(dask.scheduler)
        _, error = client.communicate(timeout=120)
    assert client.returncode == 2
    assert error.strip().splitlines()[-1].startswith("arena: the scheduler was lost")
    assert "Traceback" not in error
    before = done(tmp_path)
    resumed = arena_here("sweep", "sweep.toml", "--out", "out", "--workers", "1", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    check_whole(tmp_path, before, undisturbed)


@pytest.mark.slow
@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("trial", range(10))
def test_killed_at_a_random_moment(undisturbed: Path, tmp_path: Path, role: str, trial: int) -> None:
    rng = random.Random(f"{role} {trial}")
    write_sweep(tmp_path, repeats=N_CASES // 2)
    n_before, wait_s = rng.randrange(N_CASES), rng.uniform(0.0, 0.5)
    with cluster(tmp_path) as dask:
        client = sweeping(tmp_path, "--scheduler", dask.address)
        wait_for((tmp_path / "out" / "plan.json").is_file, client)
        wait_for(lambda: len(done(tmp_path)) >= n_before, client)
        time.sleep(wait_s)
        victim = {"client": client, "worker": rng.choice(dask.workers), "scheduler": dask.scheduler}[role]
        os.kill(victim.pid, signal.SIGKILL)
        victim.wait()
        client.communicate(timeout=120)
        before = done(tmp_path)
        if role == "client":  # its cases may go on for a moment on the workers
            resumed = arena_here("sweep", "sweep.toml", "--out", "out", "--scheduler", dask.address, cwd=tmp_path)
        else:
            resumed = arena_here("sweep", "sweep.toml", "--out", "out", "--workers", "1", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    check_whole(tmp_path, before, undisturbed)
