"""How the benchmarks take times and memory."""

import time
import tracemalloc
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from scenes.record import FloatArray

T = TypeVar("T")
Work = Callable[[], object]


def times_in_turns(
    works: Sequence[Work],
    rounds: int,
    calls: Sequence[int] = (),
    *,
    is_warm: bool = False,
    clock: Callable[[], float] = time.process_time,
) -> FloatArray:
    """Times (round, work) in s of a call of each work, done in turns.

    What slows the machine down slows all works of a round. A first round, which may compile, is not counted; there
    is none with `is_warm`. `calls` is how often each is called in a round, 1 by default: more for short works.
    """
    counts = calls or [1] * len(works)
    times = np.empty((rounds, len(works)))
    for number in range(0 if is_warm else -1, rounds):
        for k, (work, count) in enumerate(zip(works, counts, strict=True)):
            started = clock()
            for _ in range(count):
                work()
            times[number, k] = (clock() - started) / count
    return times


def paired_ratios(
    work: Work, beside: Work, pairs: int, calls: tuple[int, int] = (1, 1), *, is_warm: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Ratios (pair,) of the processor times of two works done in turns, and the times in s.

    The times are (pair, work), of `times_in_turns`.
    """
    times = times_in_turns((work, beside), pairs, calls, is_warm=is_warm)
    return times[:, 0] / times[:, 1], times


def spread_of(ratios: FloatArray) -> str:
    """Where a median of paired ratios comes from, in words."""
    return f"median of {len(ratios)} pairs, {ratios.min():.3g} to {ratios.max():.3g}"


def on_each(work: Callable[[T], object], items: Sequence[T]) -> Work:
    """A work that calls a function with every item, and keeps no result."""

    def run() -> None:
        for item in items:
            work(item)

    return run


def peak_bytes(work: Callable[[], object]) -> int:
    """Peak of the memory that a call allocates through Python and NumPy."""
    tracemalloc.start()
    work()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak
