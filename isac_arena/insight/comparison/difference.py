"""Paired differences of one quantity in two runs: mean, interval and test."""

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
# With five groups the p-value of the exact two-sided signed-rank test is at least 1/16: no decision at 95 %.
MIN_GROUPS = 6


@dataclass(frozen=True)
class PairedValues:
    """One quantity in both runs. The items of one group, a stop or an object, are not independent."""

    key: str
    unit: str
    direction: Direction
    group: IntArray  # (item,)
    first: FloatArray  # (item,) NaN where the run has no value
    second: FloatArray  # (item,)


@dataclass(frozen=True)
class PairedDifference:
    """Mean of second minus first over all pairs, its 95 % interval, and a signed-rank test of no difference.

    `first` and `second` are means over the pairs, or over all values of a run where there is no pair. `n_first`
    and `n_second` are the numbers of values of the runs. The interval is NaN where the pairs come from fewer than
    `MIN_GROUPS` stops or objects.
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
        """Verdict on the second run, B: better, worse, different, undecided, same, too few.

        Without pairs it is: only in A, only in B, no pair, or empty where neither run has a value. A difference is
        significant where the interval excludes zero and the test rejects as well. The interval alone is too short
        for few groups with outliers; the test alone ignores a few large differences beside many small ones.
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

    The bootstrap draws whole groups, because the errors of the paths of one stop are dependent. The test is
    Wilcoxon's signed-rank test on the mean differences of the groups, exact where possible. Items without a value
    in one of the runs make no pair.
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
        (total, count), lambda total, count, axis: total.sum(axis=axis) / count.sum(axis=axis), paired=True,
        n_resamples=RESAMPLES, vectorized=True, confidence_level=LEVEL, method="BCa",
        rng=np.random.default_rng(SEED),
    ).confidence_interval  # fmt: skip
    return float(interval.low), float(interval.high), p_value


def _unpaired(n_first: int, n_second: int) -> str:
    if n_first and n_second:
        return "no pair"
    return "only in A" if n_first else "only in B" if n_second else ""


def _mean(values: Any) -> float:
    return float(np.mean(values)) if len(values) else math.nan
