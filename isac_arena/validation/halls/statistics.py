"""Statistics of the channel estimates of rooms: counts, and errors of detected paths beside what was reported."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

from isac_arena.scoring.config import DEFAULT_SEPARABILITY
from isac_arena.scoring.metrics.statistics import mean
from isac_arena.scoring.record import PathKind, PathStatus
from isac_arena.scoring.stages.channel_metrics import detected_paths
from isac_arena.validation.halls.run import HallResult
from scenes.record import BoolArray, FloatArray, IntArray, TextArray

COUNTS = ("n_stops", "n_false", "n_weak")
PARAMETERS = ("delay", "aod", "aoa")
KEPT_SHARE = 0.95  # of the errors over the bound, the smallest ones: coverage and NEES count the others
MEDIAN_OF_NORMAL = float(norm.ppf(0.75))  # median magnitude of a standard normal variable


@dataclass(frozen=True)
class HallPaths:
    """Significant paths and estimates of one room or of several."""

    n_stops: int
    n_false: int
    n_weak: int
    is_detected: BoolArray  # (true,) of the significant paths
    is_separable: BoolArray  # (true,)
    cause: TextArray  # (true,) why it was missed
    kind: IntArray  # (path,) PathKind of the detected paths
    error: FloatArray  # (path, 3) of delay in s, AoD and AoA in rad
    std: FloatArray  # (path, 3) reported
    bound: FloatArray  # (path, 3) joint bound with diffuse power as noise
    thermal_bound: FloatArray  # (path, 3) joint bound with thermal noise alone
    nees: FloatArray  # (path,)
    is_efficient: (
        BoolArray  # (path,) separable from all others, and its room has ideal hardware, as the bound assumes
    )

    @property
    def detection(self) -> float:
        """Share of the significant separable paths with an estimate."""
        return mean(self.is_detected[self.is_separable])

    @property
    def false_per_stop(self) -> float:
        """Estimates that no true path explains."""
        return self.n_false / self.n_stops

    def coverage(self, kind: PathKind | None = None) -> float:
        """Share of the detected paths of a kind, or of all, inside their 95 % region."""
        chosen = self._chosen(kind)
        return mean(self.nees[chosen] <= chi2.ppf(0.95, 3))

    @property
    def normalised_nees(self) -> float:
        """Mean NEES over its 3 degrees of freedom."""
        return mean(self.nees) / 3

    def error_over_bound(self, parameter: int, *, thermal: bool = False) -> float:
        """RMS error over the joint bound, of separable paths of ideal hardware; 1 for an efficient estimator.

        The bound has the diffuse power of the stop as noise, or thermal noise alone: no estimator reaches that one
        in a room that scatters.

        Of the ratios of all paths the largest 5 % are left out, and the RMS of the others is scaled to 1 for
        Gaussian errors. So one gross error, which coverage and NEES count, does not hide the accuracy of the rest.
        """
        bound = self.thermal_bound if thermal else self.bound
        return trimmed_rms(np.abs(self.error / bound)[self.is_efficient, parameter])

    def std_over_error(self, kind: PathKind, parameter: int) -> float:
        """Median reported standard deviation over the median error, scaled to the deviation of a Gaussian."""
        chosen = self._chosen(kind)
        if not chosen.any():
            return np.nan
        actual = np.median(np.abs(self.error[chosen, parameter])) / MEDIAN_OF_NORMAL
        return float(np.median(self.std[chosen, parameter]) / actual)

    def n_of(self, kind: PathKind) -> int:
        """Number of detected paths of a kind."""
        return int(self._chosen(kind).sum())

    def _chosen(self, kind: PathKind | None) -> BoolArray:
        return np.ones(len(self.kind), bool) if kind is None else np.asarray(self.kind == kind)


def trimmed_rms(ratio: FloatArray) -> float:
    """RMS of the smallest 95 % of magnitudes, scaled to 1 for standard normal ones; NaN for none.

    The mean square of a standard normal variable within +-q is 1 - 2 q pdf(q) / P(|z| < q).
    """
    known = np.sort(ratio[np.isfinite(ratio)])
    kept = known[: int(np.ceil(KEPT_SHARE * len(known)))]
    edge = float(norm.ppf(0.5 + KEPT_SHARE / 2))
    within = 1 - 2 * edge * float(norm.pdf(edge)) / KEPT_SHARE
    return float(np.sqrt(np.mean(np.square(kept)) / within)) if len(kept) else np.nan


def hall_paths(result: HallResult) -> HallPaths:
    """The paths of one room."""
    tables = result.tables
    paths, true = detected_paths(tables.paths, tables.significant)
    thermal_bound = np.stack([true.delay_bound_s, true.aod_bound_rad, true.aoa_bound_rad], axis=1)
    return HallPaths(
        n_stops=len(tables.stops.stop),
        n_false=int((tables.paths.status == PathStatus.FALSE).sum()),
        n_weak=int((tables.paths.status == PathStatus.WEAK).sum()),
        is_detected=tables.significant.is_detected,
        is_separable=tables.significant.is_separable,
        cause=tables.significant.cause,
        kind=paths.kind,
        error=np.stack([paths.delay_error_s, paths.aod_error_rad, paths.aoa_error_rad], axis=1),
        std=np.stack([paths.delay_std_s, paths.aod_std_rad, paths.aoa_std_rad], axis=1),
        bound=np.stack(
            [true.delay_scattered_bound_s, true.aod_scattered_bound_rad, true.aoa_scattered_bound_rad], axis=1
        ),
        thermal_bound=thermal_bound,
        nees=paths.nees,
        is_efficient=(true.share_of_cell <= DEFAULT_SEPARABILITY.share_of_cell) & (not result.hall.has_hardware),
    )


def height_error_m(result: HallResult) -> float:
    """The larger error of the heights of receiver and ceiling as a room was read; infinite if it was not."""
    scene, stops = tomllib.loads(result.hall.scene_text), result.tables.stops
    errors = stops.rx_height_m - scene["walk"]["height_m"], stops.ceiling_m - scene["ceiling"]["z_m"]
    return float(np.nan_to_num(np.abs(errors), nan=np.inf).max(initial=0.0))


def pooled(parts: Sequence[HallPaths]) -> HallPaths:
    """The paths of several rooms together."""
    counts: dict[str, Any] = {name: sum(getattr(part, name) for part in parts) for name in COUNTS}
    others = [field.name for field in fields(HallPaths) if field.name not in COUNTS]
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in others}
    return HallPaths(**counts, **columns)
