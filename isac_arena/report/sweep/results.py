"""The results of a sweep as arrays, and their means at each value of an axis."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.stats import t as student

from isac_arena.scoring.doubts import case_doubts, in_short, pose_doubts
from isac_arena.scoring.metrics.metric import is_share
from scenes.record import BoolArray, FloatArray, IntArray

LEAST_CASES = 4  # of a mean with an interval: Student's t of fewer says nothing that the cases do not
MOST_VALUES = 12  # a numeric axis with more values is divided into bins
BINS = 8

# A metric, and the metric that is its ratio to its bound: the quotient of both is the bound.
OVER_BOUND = {
    "slam.position.rmse_m": "slam.position.over_bound",
    "slam.heading.rmse_deg": "slam.heading.over_bound",
    "slam.clock.rmse_ns": "slam.clock.over_bound",
}


@dataclass(frozen=True)
class SweepAxis:
    """One axis: its name, its value at every case, and whether a range was uniform in the logarithm."""

    name: str
    values: tuple[Any, ...]
    is_log: bool = False

    @property
    def is_numeric(self) -> bool:
        """Whether all values are numbers."""
        return all(isinstance(value, int | float) and not isinstance(value, bool) for value in self.values)


@dataclass(frozen=True)
class SweepMetric:
    """One metric: its value (case,), NaN where it could not be measured."""

    key: str
    unit: str
    direction: str
    value: FloatArray


@dataclass(frozen=True)
class SweepResults:
    """All finished cases of a sweep."""

    point: IntArray  # (case,) index of the design point
    axes: tuple[SweepAxis, ...]
    metrics: Mapping[str, SweepMetric]
    keys: tuple[str, ...] = ()  # (case,) their names
    stops_alone: tuple[bool, ...] = ()  # (case,) whether SLAM takes every stop alone

    @cached_property
    def doubts(self) -> list[str]:
        """What is doubtful about every case (case,): the first doubt in words; empty without any."""
        alone = self.stops_alone or [False] * len(self.point)
        return [
            in_short(case_doubts(values, stops_alone=one)) for values, one in zip(self._values, alone, strict=True)
        ]

    @cached_property
    def is_doubtful(self) -> BoolArray:
        """Whether the poses of a case are far off (case,)."""
        return np.array([bool(pose_doubts(values)) for values in self._values], bool)

    @cached_property
    def _values(self) -> list[dict[str, float]]:
        """The scores of every case by their key."""
        columns = {key: metric.value.tolist() for key, metric in self.metrics.items()}
        return [{key: column[case] for key, column in columns.items()} for case in range(len(self.point))]

    def bound(self, key: str) -> FloatArray | None:
        """The bound (case,) of a metric, in its unit; None where it has none."""
        over = self.metrics.get(OVER_BOUND.get(key, ""))
        if over is None:
            return None
        with np.errstate(divide="ignore", invalid="ignore"):
            value = self.metrics[key].value / over.value
        return value if np.isfinite(value).any() else None


@dataclass(frozen=True)
class Group:
    """The cases that share a value of an axis, or a range of its values."""

    label: str
    place: float  # on the axis
    members: BoolArray  # (case,)


def mean_interval(values: FloatArray, confidence: float = 0.95) -> tuple[float, float, int]:
    """Mean of the finite values, half the width of its Student's t interval, and the number of finite values.

    The half width is infinite for one value; the mean is NaN without values.
    """
    known = values[np.isfinite(values)]
    n = len(known)
    if n < 2:
        return (float(known[0]) if n else np.nan), np.inf, n
    error = float(known.std(ddof=1)) / np.sqrt(n)
    return float(known.mean()), float(student.ppf((1 + confidence) / 2, n - 1) * error), n


def interval_ends(key: str, values: FloatArray) -> tuple[float, float]:
    """Ends of the 95 % interval of the mean of a metric over cases, inside the range of the metric.

    A mean cannot lie outside that range, so the part of Student's t interval inside it holds the mean as often.
    The range is 0 to 1 for a share, and 0 upwards for cases none of which is negative.
    """
    mean, half, _ = mean_interval(values)
    least = 0.0 if np.nanmin(values, initial=np.inf) >= 0 else -np.inf
    return max(mean - half, least), min(mean + half, 1.0 if is_share(key) else np.inf)


def groups(axis: SweepAxis) -> list[Group]:
    """The values of an axis in order, or bins of equal counts for a numeric axis with many values."""
    if not axis.is_numeric:
        distinct: list[Hashable] = list(dict.fromkeys(str(value) for value in axis.values))
        texts = np.array([str(value) for value in axis.values], dtype=str)
        return [Group(str(value), float(at), texts == value) for at, value in enumerate(distinct)]
    numbers = np.array(axis.values, float)
    values = np.unique(numbers)
    if len(values) <= MOST_VALUES:
        return [Group(f"{value:.4g}", float(value), numbers == value) for value in values]
    edges = np.quantile(numbers, np.linspace(0, 1, BINS + 1))
    index = np.clip(np.searchsorted(edges, numbers, side="right") - 1, 0, BINS - 1)
    made = []
    for at in range(BINS):
        members = index == at
        if members.any():
            label = f"{edges[at]:.3g} to {edges[at + 1]:.3g}"
            made.append(Group(label, float(np.median(numbers[members])), members))
    return made


def cases_text(results: SweepResults, members: BoolArray) -> str:
    """How many cases a mean is over, and of how many design points and seeds where these are several points."""
    n, points = int(members.sum()), len(np.unique(results.point[members]))
    if points < 2:
        return str(n)
    each, rest = divmod(n, points)
    seeds = f"{each} seeds" if each > 1 else "1 seed"
    return f"{n}: {points} points" if rest else f"{n}: {points} points x {seeds}"


def point_means(results: SweepResults, key: str) -> FloatArray:
    """Mean of a metric over the repeats of every design point (point,), NaN where it has none."""
    points = np.unique(results.point)
    value = results.metrics[key].value
    return np.array([mean_interval(value[results.point == point])[0] for point in points])


def nondominated(costs: FloatArray) -> BoolArray:
    """Mask (point,) of the rows of costs (point, criterion) that no other row dominates; false for rows with NaN.

    A row dominates another row if none of its costs is higher and at least one is lower.
    """
    known: BoolArray = np.asarray(np.isfinite(costs).all(axis=1))
    front: BoolArray = np.array(known, bool)
    for row in np.flatnonzero(known):
        below = (costs[known] <= costs[row]).all(axis=1) & (costs[known] < costs[row]).any(axis=1)
        front[row] = not below.any()
    return front


def varying(results: SweepResults, keys: Sequence[str]) -> list[str]:
    """The keys of the metrics that have finite values and differ between cases."""
    found = []
    for key in keys:
        metric = results.metrics.get(key)
        known = metric.value[np.isfinite(metric.value)] if metric is not None else np.zeros(0)
        if len(known) and np.ptp(known) > 0:
            found.append(key)
    return found
