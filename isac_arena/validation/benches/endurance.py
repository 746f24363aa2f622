"""A long sweep of small cases while workers are killed: what it holds and takes at its start and at its end."""

import random
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil

from isac_arena.sweep.engine import connect_scheduler, run_jobs
from isac_arena.sweep.job import Job
from isac_arena.validation.benches.sweep import POWER, make_jobs, sweep_of
from isac_arena.validation.measurement import Measurement, at_most
from scenes.record import FloatArray

KILL_EVERY_S = 120.0
SHARE = 0.2  # of the cases at the start, after a first part that compiles, and at the end
POWERS_DBM = [0.0, 20.0]


class Watch:
    """Samples memory, open files and times at every case that ends, and kills a worker from time to time."""

    def __init__(self, seed: int, kill_every_s: float) -> None:
        self._rng, self._every_s = random.Random(seed), kill_every_s
        self._own, self._next_s = psutil.Process(), time.monotonic() + kill_every_s
        self.n_killed, self.failed = 0, 0
        self._worked_s: dict[int, float] = {}  # processor time of every worker
        self.rows: list[tuple[float, float, float, float]] = []  # times in s, memory in MB, open files

    def __call__(self, job: Job, reason: str | None) -> None:
        """A case ended."""
        del job
        self.failed += reason is not None
        workers = _workers(self._own)
        memory = [self._own.memory_info().rss, *(_of(each, "memory_info") for each in workers)]
        files = [self._own.num_fds(), *(_of(each, "num_fds") for each in workers)]
        self._worked_s |= {each.pid: worked for each in workers if (worked := _of(each, "cpu_times"))}
        worked_s = sum(self._worked_s.values())
        self.rows.append((time.monotonic(), worked_s, max(memory) / 1e6, float(max(files))))
        if workers and time.monotonic() > self._next_s:
            self._rng.choice(workers).kill()
            self.n_killed, self._next_s = self.n_killed + 1, time.monotonic() + self._every_s


def bench_endurance(seed: int, quick: bool) -> list[Measurement]:
    """2,000 small cases on two workers, one of them killed every two minutes."""
    n_cases, every_s = (40, 10.0) if quick else (2000, KILL_EVERY_S)
    with tempfile.TemporaryDirectory() as folder, connect_scheduler(2, None) as client:
        jobs = make_jobs(Path(folder), sweep_of(POWER, POWERS_DBM, n_cases // 2), seed)
        watch = Watch(seed, every_s)
        run_jobs(client, jobs, watch)
        lost = sum(not job.is_done for job in jobs)
    table = np.array(watch.rows)
    n = max(int(SHARE * len(table)), 2)
    first, last = table[n : 2 * n], table[-n:]
    growth = np.median(last, axis=0) / np.median(first, axis=0)
    gaps = [[float(np.median(_gaps(part[:, of]))) for part in (first, last)] for of in (0, 1)]
    reason = f"{n_cases} cases, {watch.n_killed} workers killed"
    bars = (2.0, 2.0, 3.0) if quick else (1.05, 1.0, 1.05)  # a few cases tell little about times
    rows = [
        at_most("endurance.memory", growth[2], bars[0], f"{reason}; largest process", "of the start"),
        at_most("endurance.open_files", growth[3], bars[1], reason, "of the start"),
        at_most("endurance.lost_cases", lost + watch.failed, 0, reason),
    ]
    for name, (start_s, end_s) in zip(("time", "processor_time"), gaps, strict=True):
        about = f"{start_s:.3f} s, then {end_s:.3f} s; other work on the machine changes the first of both"
        rows.append(at_most(f"endurance.{name}_per_case", end_s / start_s, bars[2], about, "of the start"))
    return rows


def _gaps(times_s: FloatArray) -> FloatArray:
    """Mean time per case over runs of ten cases: cases of a task end together."""
    step = max(1, min(10, len(times_s) // 4))
    return np.diff(times_s[::step]) / step


def _workers(own: psutil.Process) -> list[psutil.Process]:
    """The processes of the workers: children that hold more than the helpers of multiprocessing."""
    return [each for each in own.children(recursive=True) if _of(each, "memory_info") > 100e6]


def _of(process: psutil.Process, name: str) -> float:
    """Resident memory, processor time or open files of a process, 0 where it has ended."""
    try:
        found = getattr(process, name)()
        if name == "cpu_times":
            return float(found.user + found.system)
        return float(found.rss if name == "memory_info" else found)
    except psutil.Error:
        return 0.0
