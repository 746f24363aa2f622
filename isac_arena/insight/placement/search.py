"""Search for the best K of many TX, and how far from the best it can be.

Greedy search adds the TX that lowers the criterion most, then exchanges single TX while that helps (Fedorov,
"Theory of Optimal Experiments", 1972), from several first TX. The gains of errors are not submodular, so neither
the ratio 1 - 1/e of Nemhauser, Wolsey and Fisher (1978) holds, nor may old gains be kept as bounds of new ones
("lazy" greedy); the certificate is of another kind and holds always. The criterion f is convex in weights w of the
TX, so for every w

    min over K TX of f  >=  f(w) + min over v of f'(w) (v - w),   v with 0 <= v <= 1 and sum K,

and the inner minimum takes the K most negative slopes (Joshi and Boyd, "Sensor selection via convex optimization",
IEEE Trans. Signal Process. 57(2), 2009). The steps of Frank and Wolfe raise the right side.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Protocol

import numpy as np
from scipy.optimize import minimize_scalar

from scenes.record import FloatArray

MAX_SETS = 50_000  # of an exhaustive search
N_STARTS = 8
_LEAST_GAIN = 1e-9
_MAX_STEPS = 150
_TIGHT = 1e-3  # relative gap of the relaxed minimum at which the certificate ends


class Objective(Protocol):
    """A logarithm of an error: of rows, and convex with its gradient in weights of all."""

    def __call__(self, chosen: Sequence[int]) -> float:
        """Of the chosen rows."""

    def relaxed(self, weight: FloatArray) -> tuple[float, FloatArray]:
        """Of weights (row,), and the gradient (row,)."""


@dataclass(frozen=True)
class Found:
    """The rows found, in the order of their gain, and the logarithm of the error after each."""

    chosen: tuple[int, ...]
    log_error: tuple[float, ...]


def greedy(objective: Objective, rows: Sequence[int], count: int) -> Found:
    """The best set from the `N_STARTS` best first rows.

    Each gets the best next row until there are `count`; then single rows are exchanged while that helps.
    """
    firsts = sorted(rows, key=lambda row: objective([row]))[:N_STARTS]
    ends = [_exchanged(objective, rows, _grown(objective, rows, first, count)) for first in firsts]
    return _ordered(objective, min(ends, key=objective))


def _grown(objective: Objective, rows: Sequence[int], first: int, count: int) -> list[int]:
    """The first row with the best next one until there are `count`."""
    chosen = [first]
    while len(chosen) < count:
        rest = [row for row in rows if row not in chosen]
        chosen.append(min(rest, key=lambda row: objective([*chosen, row])))
    return chosen


def _exchanged(objective: Objective, rows: Sequence[int], chosen: list[int]) -> list[int]:
    """The best exchange of one row for another until none helps."""
    best = objective(chosen)
    while True:
        rest = [row for row in rows if row not in chosen]
        trials = [[*chosen[:k], row, *chosen[k + 1 :]] for k in range(len(chosen)) for row in rest]
        trial = min(trials, key=objective, default=chosen)
        if (value := objective(trial)) >= best - _LEAST_GAIN:
            return chosen
        chosen, best = trial, value


def exhaustive(
    objective: Objective,
    rows: Sequence[int],
    count: int,
    track: Callable[[Iterable[tuple[int, ...]]], Iterable[tuple[int, ...]]] = iter,
) -> Found:
    """The best of all sets of `count` rows. `ValueError` where there are too many."""
    if (n := comb(len(rows), count)) > MAX_SETS:
        raise ValueError(
            f"--exhaustive: {n} sets of {count} of {len(rows)} candidates, at most {MAX_SETS} are tried"
        )
    return _ordered(objective, min(track(list(combinations(rows, count))), key=objective))


def least_log_error(objective: Objective, rows: Sequence[int], count: int, start: Sequence[int], n: int) -> float:
    """A number that no `count` of the rows fall below; `n` is the number of all weights, `start` a good set."""
    at = np.zeros(n)
    at[list(rows)] = 0.5 * count / len(rows)
    at[list(start)] += 0.5
    least = -np.inf
    for _ in range(_MAX_STEPS):
        value, slope = objective.relaxed(at)
        corner = np.zeros(n)
        best = np.asarray(rows)[np.argsort(slope[list(rows)], kind="stable")[:count]]
        corner[best] = 1.0
        step = corner - at
        least = max(least, value + float(slope @ step))
        if value - least < _TIGHT:
            break
        found = minimize_scalar(_along, bounds=(0.0, 1.0), args=(objective, at, step), method="bounded")
        at = at + found.x * step
    return float(least)


def _along(share: float, objective: Objective, at: FloatArray, step: FloatArray) -> float:
    return objective.relaxed(at + share * step)[0]


def _ordered(objective: Objective, chosen: Sequence[int]) -> Found:
    """The same rows, each the best next one, with the logarithm of the error after each."""
    order: list[int] = []
    for _ in chosen:
        order.append(min((row for row in chosen if row not in order), key=lambda row: objective([*order, row])))
    return Found(tuple(order), tuple(objective(order[: k + 1]) for k in range(len(order))))
