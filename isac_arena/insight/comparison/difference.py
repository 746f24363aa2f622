"""Paired differences of one quantity in two runs: mean, interval and test."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import bootstrap, wilcoxon

from isac_arena.scoring.metrics.metric import Direction
from scenes.record import FloatArray, IntArray

LEVEL = 0.95
RESAMPLES = 4999
SEED = 1
# With five pairs the exact two-sided signed-rank test cannot fall below 1/16: nothing can be told at 95 %.
MIN_GROUPS = 6


@dataclass(frozen=True)
class PairedValues:
    """One quantity in both runs; what is of one group, a stop or an object, is not independent."""

    key: str
    unit: str
    direction: Direction
    group: IntArray  # (item,)
    first: FloatArray  # (item,) NaN where the run has no value
    second: FloatArray  # (item,)


@dataclass(frozen=True)
class PairedDifference:
    """Mean of second minus first over all pairs, its 95 % interval, and a signed-rank test of no difference.

    `first` and `second` are means over the pairs; where there is no pair, over all that a run has. `n_first` and
    `n_second` count what each run has. The interval is NaN where the pairs come from fewer than `MIN_GROUPS` stops
    or objects.
    """

    key: str
    unit: str
    direction: Direction
    n_pairs: int
    n_groups: int
    n_first: int
    n_second: int
    first: float
    second: float
    difference: float
    low: float
    high: float
    p_value: float

    @property
    def verdict(self) -> str:
        """What is said of the second run, B: better, worse, different, undecided, same, too few.

        Without any pair: only in A, only in B, no pair, or nothing where neither run has a value. A difference is
        told where the interval leaves out zero and the test agrees: of few groups with outliers the interval alone
        is too short, of many small shifts beside a few large ones the test sees only the first.
        """
        if not self.n_pairs:
            return _unpaired(self.n_first, self.n_second)
        if self.difference == self.low == self.high == 0:
            return "same"
        if math.isnan(self.low):
            return "too few"
        if self.low <= 0 <= self.high or not self.p_value <= 1 - LEVEL:
            return "undecided"
        if self.direction == "info":
            return "different"
        return "better" if (self.difference > 0) == (self.direction == "higher") else "worse"


def paired_difference(pairs: PairedValues) -> PairedDifference:
    """Mean difference with a bias-corrected and accelerated bootstrap interval over groups (Efron, 1987).

    Whole groups are drawn anew: what happens to the paths of one stop happens together. The test is Wilcoxon's
    signed-rank test on the mean differences of the groups, exact where it can be. Items that lack a value in one
    run make no pair.
    """
    has = np.isfinite(pairs.first), np.isfinite(pairs.second)
    both = has[0] & has[1]
    _, group = np.unique(pairs.group[both], return_inverse=True)
    difference = pairs.second[both] - pairs.first[both]
    total = np.bincount(group, difference).astype(float)
    count = np.bincount(group).astype(float)
    low, high, p_value = _inference(total, count)
    shown = (both, both) if both.any() else has
    return PairedDifference(
        pairs.key,
        pairs.unit,
        pairs.direction,
        n_pairs=int(both.sum()),
        n_groups=len(count),
        n_first=int(has[0].sum()),
        n_second=int(has[1].sum()),
        first=_mean(pairs.first[shown[0]]),
        second=_mean(pairs.second[shown[1]]),
        difference=_mean(difference),
        low=low,
        high=high,
        p_value=p_value,
    )


def _inference(total: FloatArray, count: FloatArray) -> tuple[float, float, float]:
    """Interval of the mean and p-value from sums of differences and numbers of pairs (group,)."""
    if not len(count):
        return math.nan, math.nan, math.nan
    if not total.any():
        return 0.0, 0.0, 1.0
    if len(count) < MIN_GROUPS:
        return math.nan, math.nan, math.nan
    per_group = total / count
    p_value = float(wilcoxon(per_group).pvalue)
    if np.ptp(per_group) == 0:
        return float(per_group[0]), float(per_group[0]), p_value
    interval = bootstrap(
        (total, count),
        lambda total, count, axis: total.sum(axis=axis) / count.sum(axis=axis),
        n_resamples=RESAMPLES,
        vectorized=True,
        paired=True,
        confidence_level=LEVEL,
        method="BCa",
        rng=np.random.default_rng(SEED),
    ).confidence_interval
    return float(interval.low), float(interval.high), p_value


def _unpaired(n_first: int, n_second: int) -> str:
    if n_first and n_second:
        return "no pair"
    return "only in A" if n_first else "only in B" if n_second else ""


def _mean(values: Any) -> float:
    return float(np.mean(values)) if len(values) else math.nan
