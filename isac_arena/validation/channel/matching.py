"""Scoring of synthetic stops: which estimate is which true path, and tables over many stops.

A narrow gate would cut off large errors and make the others look small. So an estimate is matched within a whole
Rayleigh cell, or five standard deviations of the bound if that is more, and errors and consistency are scored
on separated paths at 10 dB and above only. Their bounds are below a tenth of a cell, so the gate loses none.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from estimation.channel.record import ChannelEstimate
from isac_arena.scoring.metrics.statistics import mean, squared_mahalanobis
from isac_arena.validation import monte_carlo
from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.scenarios.link_bench import (
    SEPARATED_CELLS,
    ChannelStop,
    LinkBench,
    TrueBounds,
    true_bounds,
)
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray
from sim.observation import BeamSweep

Estimator = Callable[[BeamSweep], ChannelEstimate]

GATE_CELLS = 1.0
GATE_DEVIATIONS = 5.0


@dataclass(frozen=True)
class MatchedPaths:
    """All true paths of many stops with their errors, NaN for paths that were not found."""

    snr_db: FloatArray  # (path,)
    loss_db: FloatArray  # (path,) SNR lost to the other paths of the stop
    separation: FloatArray  # (path,) cells to the nearest other path
    bound: FloatArray  # (path, 3) standard deviations of delay in s, AoD and AoA in rad
    error: FloatArray  # (path, 3)
    nees: FloatArray  # (path,) squared error in units of the reported covariance
    n_false: IntArray  # (stop,) estimates that no true path explains

    @property
    def is_found(self) -> BoolArray:
        """Whether an estimate was matched to the path (path,)."""
        return np.asarray(np.isfinite(self.error).all(axis=1))

    def chosen(self, min_snr_db: float) -> BoolArray:
        """Mask (path,) of the separated paths that were found, with an SNR from `min_snr_db` on."""
        return self.is_found & (self.snr_db >= min_snr_db) & (self.separation >= SEPARATED_CELLS)

    def identifiable(self, min_snr_db: float) -> BoolArray:
        """Mask (path,) of the paths that are known as well as a lone path of at least this SNR."""
        return np.asarray(self.snr_db - self.loss_db >= min_snr_db)


def match_stop(
    bench: LinkBench, stop: ChannelStop, estimate: ChannelEstimate, bounds: TrueBounds
) -> tuple[IntArray, int]:
    """Estimate (path,) of every true path, -1 for none, and the number of false estimates.

    One to one, with the least sum of squared distances in gates. An estimate without a match is false, unless it
    lies inside the gate of a path that was not found. So a second estimate beside a found path is false.
    """
    truth, place = stop.paths.cells, estimate_places(estimate)
    std = np.sqrt(np.diagonal(bounds.covariance, axis1=1, axis2=2))
    std = std * np.column_stack([np.ones(len(std)), *np.cos(stop.paths.parameters[:, 1:]).T])
    gate = np.maximum(GATE_CELLS * bench.cell, GATE_DEVIATIONS * np.where(np.isfinite(std), std, 0.0))
    distance = np.square((place[None] - truth[:, None]) / gate[:, None]).max(axis=2)
    rows, columns = linear_sum_assignment(np.minimum(distance, 1.0))
    inside = distance[rows, columns] < 1
    found = np.full(len(truth), -1)
    found[rows[inside]] = columns[inside]
    unmatched = np.setdiff1d(np.arange(len(place)), found)
    explained = (distance[np.ix_(found < 0, unmatched)] < 1).any(axis=0)
    return found, int((~explained).sum())


def estimate_places(estimate: ChannelEstimate) -> FloatArray:
    """Delay in s and the sines of both azimuths (path, 3) of an estimate."""
    sines = np.sin(estimate.aod_azimuth_rad), np.sin(estimate.aoa_azimuth_rad)
    return np.stack([estimate.delay_s, *sines], axis=-1)


def run_stops(
    bench: LinkBench, stops: Iterable[ChannelStop], estimator: Estimator, *, coherent: bool
) -> MatchedPaths:
    """Estimate and score stops one after the other."""
    rows, n_false = [], []
    for stop in stops:
        estimate = estimator(stop.sweep)
        bounds = true_bounds(bench, stop, coherent=coherent)
        found, false = match_stop(bench, stop, estimate, bounds)
        n_false.append(false)
        rows.append(_path_rows(stop, estimate, bounds, found))
    table = np.concatenate(rows)
    columns = (table[:, 0], table[:, 1], table[:, 2], table[:, 3:6], table[:, 6:9], table[:, 9])
    return MatchedPaths(*columns, np.array(n_false))


def _path_rows(stop: ChannelStop, estimate: ChannelEstimate, bounds: TrueBounds, found: IntArray) -> FloatArray:
    n, hit = len(stop.paths), found >= 0
    error, covariance = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    error[hit] = estimate.plane_parameters[found[hit]] - stop.paths.parameters[hit]
    error[:, 1:] = wrap_angle(error[:, 1:])
    covariance[hit] = estimate.covariance[found[hit], :3, :3]
    std = np.sqrt(np.diagonal(bounds.covariance, axis1=1, axis2=2))
    nees = squared_mahalanobis(error, covariance)
    return np.column_stack([stop.paths.snr_db, bounds.loss_db, bounds.separation, std, error, nees])


def efficiency_rows(
    prefix: str, table: MatchedPaths, *, min_snr_db: float, bars: tuple[float, float], quick: bool
) -> list[Measurement]:
    """RMSE over the bound of delay, AoD and AoA and their mean, on separated paths that were found.

    `bars` are those of each and of the mean.
    """
    use = table.chosen(min_snr_db)
    n = int(use.sum())
    square = np.square(table.error[use] / table.bound[use])
    ratio = np.sqrt(np.mean(square, axis=0)) if n else np.full(3, np.nan)
    reason = f"{n} separated paths from {min_snr_db:g} dB on; the bound allows 1"
    spread = np.array([1.0, 1.0, 1.0, 1 / np.sqrt(3)]) / np.sqrt(2 * max(n, 1))
    names, values, every = ("delay", "aod", "aoa", "mean"), [*ratio, ratio.mean()], [*3 * bars[:1], bars[1]]
    return [
        at_most(f"{prefix}.rmse_over_crb.{name}", value, monte_carlo.quick_bar(bar, error, quick), reason)
        for name, value, bar, error in zip(names, values, every, spread, strict=True)
    ]


def consistency_rows(prefix: str, table: MatchedPaths, *, min_snr_db: float, quick: bool) -> list[Measurement]:
    """Coverage of the 95 % region and NEES over its dimension, as deviations from their nominal values."""
    nees = table.nees[table.chosen(min_snr_db)]
    n = max(len(nees), 1)
    cover_bar = monte_carlo.quick_bar(0.01, np.sqrt(0.95 * 0.05 / n), quick)
    nees_bar = monte_carlo.quick_bar(0.05, np.sqrt(2 / 3 / n), quick)
    return [
        monte_carlo.coverage_row(f"{prefix}.coverage95_deviation", nees, 3, cover_bar, f", {n} paths"),
        monte_carlo.nees_row(f"{prefix}.nees_deviation", nees, 3, nees_bar, f", {n} paths"),
    ]


def rate_row(key: str, hits: BoolArray, bar: float, reason: str, quick: bool) -> Measurement:
    """Share of hits, at least `bar`."""
    n = max(len(hits), 1)
    allowed = monte_carlo.fewest_by_chance(n, bar) / n if quick else bar
    return at_least(key, mean(hits), allowed, f"{reason}, {len(hits)} paths")


def false_row(key: str, n_false: IntArray, bar: float, quick: bool) -> Measurement:
    """False paths per stop, at most `bar`."""
    n = max(len(n_false), 1)
    allowed = monte_carlo.most_by_chance(bar * n) / n if quick else bar
    return at_most(key, mean(n_false), allowed, f"{int(np.sum(n_false))} in {n} stops", "per stop")
