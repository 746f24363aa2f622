"""How the benchmarks take times and memory."""

import time
import tracemalloc
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from scenes.record import FloatArray

T = TypeVar("T")


def best_time(
    function: Callable[[], T], repeats: int, clock: Callable[[], float] = time.process_time
) -> tuple[float, T]:
    """Shortest time of several calls in s, after a first one that may compile, and what the last returned."""
    value, shortest = function(), np.inf
    for _ in range(repeats):
        started = clock()
        value = function()
        shortest = min(shortest, clock() - started)
    return shortest, value


def paired_ratios(
    work: Callable[[], object], beside: Callable[[], object], pairs: int
) -> tuple[FloatArray, FloatArray]:
    """Ratios (pair,) of the processor times of two works done in turns, after a first call of each; times in s.

    The times are (pair, work). What slows the machine down slows both works of a pair.
    """
    times = np.empty((pairs, 2))
    for pair in range(-1, pairs):
        for k, each in enumerate((work, beside)):
            started = time.process_time()
            each()
            times[pair, k] = time.process_time() - started
    return times[:, 0] / times[:, 1], times


def median_time_s(
    work: Callable[[T], object],
    items: Sequence[T],
    repeats: int = 1,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Median over the items of the shortest time of several calls; a first call may compile."""
    work(items[0])

    def time_s(item: T) -> float:
        started = clock()
        work(item)
        return clock() - started

    return float(np.median([min(time_s(item) for _ in range(repeats)) for item in items]))


def peak_bytes(work: Callable[[], object]) -> int:
    """Peak of the memory that a call allocates through Python and NumPy."""
    tracemalloc.start()
    work()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak
