"""A long sweep of small cases while workers are killed: what it holds and takes at its start and at its end."""

import random
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from isac_arena.sweep.engine import run_jobs
from isac_arena.sweep.job import Job
from isac_arena.validation.benches.sweep import POWER, make_jobs, sweep_of
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.workers.workers import Workers
from scenes.record import FloatArray

N_CASES, KILL_EVERY_S = 2000, 120.0
SHARE = 0.2  # of the cases at the start, after a first part that compiles, and at the end
POWERS_DBM = [0.0, 20.0]
WINDOW = 10  # cases, at most: cases of a task end together
WORK = np.exp(1j * np.arange(2**18))  # a fixed piece of work is its FFT, some times
WORK_TIMES = 4


class Watch:
    """Samples memory, open files and times at every case that ends, and kills a worker from time to time.

    The processor time of a case is that of all workers, the scheduler and the client. It changes with what else
    runs on the machine. So the client does a fixed piece of work after every window of cases, and a case counts in
    units of its processor time.
    """

    def __init__(self, seed: int, kill_every_s: float, window: int) -> None:
        self._rng, self._every_s, self._window = random.Random(seed), kill_every_s, window
        self._own, self._next_s = psutil.Process(), time.monotonic() + kill_every_s
        self.n_killed, self.failed = 0, 0
        self._worked_s: dict[int, float] = {}  # processor time of every process
        self._before_s = self._spent_s = 0.0
        self.rows: list[tuple[float, float]] = []  # memory in MB and open files, of every case
        self.windows: list[tuple[float, float]] = []  # processor time in s of a case and of the piece of work

    def __call__(self, job: Job, reason: str | None) -> None:
        """A case ended."""
        del job
        self.failed += reason is not None
        workers = _workers(self._own)
        memory = [self._own.memory_info().rss, *(_of(each, "memory_info") for each in workers)]
        files = [self._own.num_fds(), *(_of(each, "num_fds") for each in workers)]
        everyone = (self._own, *workers)
        self._worked_s |= {each.pid: worked for each in everyone if (worked := _of(each, "cpu_times"))}
        self.rows.append((max(memory) / 1e6, float(max(files))))
        if len(self.rows) % self._window == 0:
            worked_s, work_s = sum(self._worked_s.values()) - self._spent_s, _piece_of_work_s()
            self.windows.append(((worked_s - self._before_s) / self._window, work_s))
            self._before_s, self._spent_s = worked_s, self._spent_s + work_s
        if workers and time.monotonic() > self._next_s:
            self._rng.choice(workers).kill()
            self.n_killed, self._next_s = self.n_killed + 1, time.monotonic() + self._every_s


def bench_endurance(seed: int, quick: bool) -> list[Measurement]:
    """2,000 small cases on two workers, one of them killed every two minutes."""
    n_cases, every_s = (24, 8.0) if quick else (N_CASES, KILL_EVERY_S)
    with tempfile.TemporaryDirectory() as folder, Workers(2, None) as workers:
        jobs = make_jobs(Path(folder), sweep_of(POWER, POWERS_DBM, n_cases // 2), seed)
        watch = Watch(seed, every_s, max(1, min(WINDOW, int(SHARE * n_cases) // 4)))
        run_jobs(workers.client, jobs, watch)
        lost = sum(not job.is_done for job in jobs)
    (memory_mb, files), cost_s, work_s = np.array(watch.rows).T, *np.array(watch.windows).T
    seconds, pieces = _start_and_end(cost_s), _start_and_end(cost_s / work_s)
    fewest = _start_and_end(files, np.min)  # connections of replaced workers come and go: what is leaked stays
    reason = f"{n_cases} cases, {watch.n_killed} workers killed"
    about = f"{seconds[0]:.3f} s of processor time, then {seconds[1]:.3f} s, in units of a piece of work beside it"
    bars = (2.0, 2.0, 3.0) if quick else (1.05, 1.0, 1.05)  # a few cases tell little about times
    return [
        at_most("endurance.memory", _growth(memory_mb), bars[0], f"{reason}; largest process", "of the start"),
        at_most("endurance.open_files", fewest[1] / fewest[0], bars[1], f"{reason}; fewest", "of the start"),
        at_most("endurance.lost_cases", lost + watch.failed, 0, reason),
        at_most("endurance.time_per_case", pieces[1] / pieces[0], bars[2], about, "of the start"),
    ]


def _start_and_end(values: FloatArray, statistic: Callable[[FloatArray], Any] = np.median) -> tuple[float, float]:
    """A statistic of the start, after a first part that compiles, and of the end."""
    n = max(int(SHARE * len(values)), 2)
    return float(statistic(values[n : 2 * n])), float(statistic(values[-n:]))


def _growth(values: FloatArray) -> float:
    start, end = _start_and_end(values)
    return end / start


def _piece_of_work_s() -> float:
    """Processor time of a piece of work that is always the same."""
    started = time.thread_time()
    for _ in range(WORK_TIMES):
        np.fft.fft(WORK)
    return time.thread_time() - started


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
