"""Two runs over the same stops compared pair by pair: stop by stop, true path by true path, object by object."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import bootstrap, wilcoxon

from estimation.scoring.metric import Direction
from estimation.scoring.record import ClusterScores, ContourScores, MapScores, ScoreTables
from scenes.record import BoolArray, FloatArray, IntArray

SAME_PLACE_M = 1e-6
SAME_DIRECTION_RAD = 1e-9
LEVEL = 0.95
RESAMPLES = 4999
SEED = 1
# With five pairs the exact two-sided signed-rank test cannot fall below 1/16: nothing can be told at 95 %.
MIN_GROUPS = 6
PATHS_PER_STOP = 1_000_000  # stop and path in one number


@dataclass(frozen=True)
class Pairs:
    """One quantity in both runs; pairs of one group, a stop or an object, are not independent."""

    key: str
    unit: str
    direction: Direction
    group: IntArray  # (pair,)
    first: FloatArray  # (pair,)
    second: FloatArray  # (pair,)


@dataclass(frozen=True)
class PairedDifference:
    """Mean of second minus first over all pairs, its 95 % interval, and a signed-rank test of no difference.

    The interval is NaN where the pairs come from fewer than `MIN_GROUPS` stops or objects.
    """

    key: str
    unit: str
    direction: Direction
    n_pairs: int
    n_groups: int
    first: float
    second: float
    difference: float
    low: float
    high: float
    p_value: float

    @property
    def verdict(self) -> str:
        """What is said of the second run: better, worse, different, undecided, same, too few.

        A difference is told where the interval leaves out zero and the test agrees: of few groups with outliers
        the interval alone is too short, of many small shifts beside a few large ones the test sees only the first.
        """
        if self.n_pairs and self.difference == self.low == self.high == 0:
            return "same"
        if math.isnan(self.low):
            return "too few"
        if self.low <= 0 <= self.high or not self.p_value <= 1 - LEVEL:
            return "undecided"
        if self.direction == "info":
            return "different"
        return "better" if (self.difference > 0) == (self.direction == "higher") else "worse"


@dataclass(frozen=True)
class Comparison:
    """All paired differences of two runs, how many stops they share, and what could not be paired and why."""

    differences: tuple[PairedDifference, ...]
    n_stops: int
    notes: tuple[str, ...]


def compare_runs(first: ScoreTables, second: ScoreTables) -> Comparison:
    """Paired differences of two runs, second minus first.

    Raises
    ------
    ValueError
        Where no receiver stop is the same in both.
    """
    stops = common_stops(first, second)
    if not len(stops):
        raise ValueError("no receiver stop is the same in both; only runs over the same stops can be paired")
    notes = []
    n_stops = (len(first.poses.stop), len(second.poses.stop))
    if max(n_stops) > len(stops):
        notes.append(f"{len(stops)} stops are the same in both, of {n_stops[0]} and {n_stops[1]}")
    pairs = [*_pose_pairs(first, second, stops), *_set_pairs(first, second, stops)]
    if _same_paths(first, second, stops):
        pairs += _path_pairs(first, second, stops)
    else:
        notes.append("the true paths differ: paths are not paired")
    for name in ("mapping", "slam"):
        maps = getattr(first, name), getattr(second, name)
        pairs += [*_ip_pairs(name, *maps, stops), *_object_pairs(name, *maps)]
    return Comparison(tuple(paired_difference(one) for one in pairs), len(stops), tuple(notes))


def common_stops(first: ScoreTables, second: ScoreTables) -> IntArray:
    """Indices (stop,) of the stops that have the same true receiver position in both runs."""
    _, one, other = np.intersect1d(first.poses.stop, second.poses.stop, return_indices=True)
    apart = np.abs(first.poses.true_position_m[one] - second.poses.true_position_m[other]).max(axis=1)
    return np.asarray(first.poses.stop[one[apart <= SAME_PLACE_M]])


def paired_difference(pairs: Pairs) -> PairedDifference:
    """Mean difference with a bias-corrected and accelerated bootstrap interval over groups (Efron, 1987).

    Whole groups are drawn anew: what happens to the paths of one stop happens together. The test is Wilcoxon's
    signed-rank test on the mean differences of the groups, exact where it can be. Pairs that lack a value in one
    run are left out.
    """
    known = np.isfinite(pairs.first) & np.isfinite(pairs.second)
    _, group = np.unique(pairs.group[known], return_inverse=True)
    difference = pairs.second[known] - pairs.first[known]
    total = np.bincount(group, difference).astype(float)
    count = np.bincount(group).astype(float)
    low, high, p_value = _inference(total, count)
    return PairedDifference(
        pairs.key,
        pairs.unit,
        pairs.direction,
        n_pairs=int(known.sum()),
        n_groups=len(count),
        first=_mean(pairs.first[known]),
        second=_mean(pairs.second[known]),
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


def _pose_pairs(first: ScoreTables, second: ScoreTables, stops: IntArray) -> Iterator[Pairs]:
    one, other = (_at(run.poses.stop, stops) for run in (first, second))
    for key, unit, field, scale in (
        ("slam.position_error", "m", "position_error_m", 1.0),
        ("slam.heading_error", "deg", "heading_error_rad", float(np.rad2deg(1.0))),
        ("slam.clock_error", "ns", "clock_error_s", 1e9),
    ):
        a, b = (
            scale * np.abs(getattr(run.poses, field))[rows] for run, rows in ((first, one), (second, other))
        )
        yield Pairs(key, unit, "lower", stops, a, b)


def _set_pairs(first: ScoreTables, second: ScoreTables, stops: IntArray) -> Iterator[Pairs]:
    a, b = (run.stops.gospa[_at(run.stops.stop, stops)] for run in (first, second))
    yield Pairs("channel.gospa", "1", "lower", stops, a, b)


def _same_paths(first: ScoreTables, second: ScoreTables, stops: IntArray) -> bool:
    """Whether true paths of the same stop and index are the same, and there are any."""
    common, one, other = _common_paths(first, second, stops)
    if not len(common):
        return False
    return all(
        bool(np.all(np.abs(getattr(first.significant, name)[one] - getattr(second.significant, name)[other])
                    <= SAME_DIRECTION_RAD))
        for name in ("aod_azimuth_rad", "aoa_azimuth_rad")
    )  # fmt: skip


def _path_pairs(first: ScoreTables, second: ScoreTables, stops: IntArray) -> Iterator[Pairs]:
    """Errors of true paths that both runs detected, and detection of those that are significant in both."""
    group, one, other = _common_paths(first, second, stops)
    a, b = first.significant.is_detected[one], second.significant.is_detected[other]
    yield Pairs("channel.detected", "1", "higher", group, a.astype(float), b.astype(float))
    group, one, other = _common_keys(*(_detected_keys(run, stops) for run in (first, second)))
    degrees = float(np.rad2deg(1.0))
    for key, unit, field, scale in (
        ("channel.delay_error", "ns", "delay_error_s", 1e9),
        ("channel.aod_error", "deg", "aod_error_rad", degrees),
        ("channel.aoa_error", "deg", "aoa_error_rad", degrees),
        ("channel.power_error", "dB", "power_error_db", 1.0),
    ):
        a = scale * np.abs(getattr(first.paths, field))[one]
        b = scale * np.abs(getattr(second.paths, field))[other]
        yield Pairs(key, unit, "lower", group, a, b)


def _common_paths(
    first: ScoreTables, second: ScoreTables, stops: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Stop of the true paths that are significant in both runs, and their rows in each."""
    keys = []
    for run in (first, second):
        known = np.isin(run.significant.stop, stops)
        keys.append(_keys(run.significant.stop, run.significant.path, known))
    return _common_keys(*keys)


def _detected_keys(run: ScoreTables, stops: IntArray) -> IntArray:
    """Key of the true path that each estimate is assigned to."""
    known = np.isin(run.paths.stop, stops) & (run.paths.true_path >= 0) & np.isfinite(run.paths.delay_error_s)
    return _keys(run.paths.stop, run.paths.true_path, known)


def _keys(stop: IntArray, path: IntArray, known: BoolArray) -> IntArray:
    """Stop and true path in one number (row,); what is not known has a negative one of its own."""
    return np.where(known, stop * PATHS_PER_STOP + path, -1 - np.arange(len(stop)))


def _common_keys(first: IntArray, second: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Stop of the keys that are in both, and their rows in each."""
    rows = {key: row for row, key in enumerate(first.tolist()) if key >= 0}
    both = [(rows[key], row) for row, key in enumerate(second.tolist()) if key >= 0 and key in rows]
    one, other = np.array(sorted(both), int).reshape(-1, 2).T
    return first[one] // PATHS_PER_STOP, one, other


def _ip_pairs(name: str, first: MapScores, second: MapScores, stops: IntArray) -> Iterator[Pairs]:
    """Median distance of the inlier incidence points of every stop to the nearest surface."""
    a, b = (
        np.array([_median(run.ips.surface_distance_m[run.ips.is_inlier & (run.ips.stop == stop)])
                  for stop in stops])
        for run in (first, second)
    )  # fmt: skip
    yield Pairs(f"{name}.ip_to_surface", "m", "lower", stops, a, b)


def _object_pairs(name: str, first: MapScores, second: MapScores) -> Iterator[Pairs]:
    columns: tuple[tuple[str, str, Direction], ...] = (
        ("iou", "1", "higher"),
        ("modified_hausdorff_m", "m", "lower"),
        ("seen_rmse_m", "m", "lower"),
        ("full_rmse_m", "m", "lower"),
    )
    both: tuple[tuple[str, tuple[ClusterScores | ContourScores, ClusterScores | ContourScores]], ...] = (
        ("shapes", (first.clusters, second.clusters)),
        ("contours", (first.contours, second.contours)),
    )
    for kind, tables in both:
        rows = [_best_rows(table) for table in tables]
        names = sorted(set(rows[0]) & set(rows[1]))
        one, other = ([known[item] for item in names] for known in rows)
        for field, unit, direction in columns:
            a, b = (
                getattr(table, field)[np.array(found, int)]
                for table, found in zip(tables, (one, other), strict=True)
            )
            key = f"{kind}.{name}.{field.removesuffix('_m')}"
            yield Pairs(key, unit, direction, np.arange(len(names)), a, b)


def _best_rows(items: ClusterScores | ContourScores) -> dict[str, int]:
    """Row by object: where several show one, that with the most incidence points close to it."""
    best: dict[str, int] = {}
    for row, name in enumerate(items.object.tolist()):
        if name and (name not in best or items.n_close[row] > items.n_close[best[name]]):
            best[name] = row
    return best


def _at(values: IntArray, wanted: IntArray) -> IntArray:
    """Rows (wanted,) of values that hold each of the wanted ones, all of which are there once."""
    order = np.argsort(values)
    return np.asarray(order[np.searchsorted(values, wanted, sorter=order)])


def _mean(values: Any) -> float:
    return float(np.mean(values)) if len(values) else math.nan


def _median(values: Any) -> float:
    kept = values[np.isfinite(values)]
    return float(np.median(kept)) if len(kept) else math.nan
