"""`arena validate shape`: contours from incidence points alone, on partial pillars, square columns and walls."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import shapely

from estimation.shape.baselines.peers import fit_paper_gp, fit_prior_only
from estimation.shape.baselines.recursive import fit_recursive_gp, fit_star_convex_rhm
from estimation.shape.fit import ShapeFit
from estimation.shape.points.cluster import PointCluster
from estimation.shape.points.depth_line import fit_depth_line
from estimation.shape.points.line import fit_line
from estimation.shape.points.mic import fit_mic
from isac_arena.scoring.metrics.contours import extent_iou, intersection_over_union
from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.monte_carlo import quick_bar, standard_error
from isac_arena.validation.scenarios import point_clusters
from scenes.record import FloatArray

BAND_STD = 1.96
PILLAR_DRAWS, QUICK_DRAWS = 36, 1
WALL_DRAWS, QUICK_WALL_DRAWS = 15, 1
RECESS_M = 0.3

Method = Callable[[PointCluster], ShapeFit]


class ClosedScores(NamedTuple):
    """Scores (set,) of a method on closed contours; a fit without a contour scores 0 and NaN."""

    iou: FloatArray
    rmse_m: FloatArray  # of the true contour's samples from the estimate
    visible_rmse_m: FloatArray  # of those on the arc the points come from
    coverage: FloatArray  # of the estimate's samples within 1.96 standard deviations of the truth


class WallScores(NamedTuple):
    """Scores (set,) of a method on walls."""

    perpendicular_rmse_m: FloatArray
    extent_iou: FloatArray
    coverage: FloatArray


def check_partial_pillars(seed: int, quick: bool) -> list[Measurement]:
    """Round pillars seen from one side: MIC beside prior-only and the paper's method."""
    made = point_clusters.partial_pillars(np.random.default_rng(seed), QUICK_DRAWS if quick else PILLAR_DRAWS)
    ours, prior, paper = (closed_scores(fit, made) for fit in (fit_mic, fit_prior_only, fit_paper_gp))
    recursive = [closed_scores(fit, made).iou for fit in (fit_recursive_gp, fit_star_convex_rhm)]
    row = _Rows("pillars", len(made), quick)
    row.higher("iou", ours.iou, 0.67)
    row.higher("iou_over_prior_only", ours.iou - prior.iou, 0.08)
    row.higher("iou_over_paper", ours.iou - paper.iou, 0.45)
    row.higher("iou_over_recursive_peers", ours.iou - max(recursive, key=np.mean), 0.0)
    row.lower("contour_rmse_m", ours.rmse_m, 0.135)
    row.lower("visible_rmse_m", ours.visible_rmse_m, 0.05)
    row.band("coverage", ours.coverage, 0.93, 0.97)
    return row.rows


def check_disturbed_pillars(seed: int, quick: bool) -> list[Measurement]:
    """The same with 10 % outliers, and with stated covariances four times too large or too small."""
    rng = np.random.default_rng(seed)
    made = point_clusters.partial_pillars(rng, QUICK_DRAWS if quick else PILLAR_DRAWS)
    row = _Rows("pillars", len(made), quick)
    outliers = closed_scores(fit_mic, [point_clusters.with_outliers(one, 0.1, rng) for one in made])
    row.higher("outliers.iou", outliers.iou, 0.68)
    row.higher("outliers.coverage", outliers.coverage, 0.9)
    for name, factor in (("large", 4.0), ("small", 0.25)):
        scores = closed_scores(fit_mic, [point_clusters.with_wrong_covariance(one, factor) for one in made])
        row.higher(f"covariance_too_{name}.iou", scores.iou, 0.70)
        row.higher(f"covariance_too_{name}.coverage", scores.coverage, 0.88)
    return row.rows


def check_square_columns(seed: int, quick: bool) -> list[Measurement]:
    """Square columns turned at random, seen from one side."""
    made = point_clusters.square_columns(np.random.default_rng(seed), QUICK_DRAWS if quick else PILLAR_DRAWS)
    scores = closed_scores(fit_mic, made)
    row = _Rows("columns", len(made), quick)
    row.higher("iou", scores.iou, 0.65)
    row.higher("coverage", scores.coverage, 0.92)
    return row.rows


def check_walls(seed: int, quick: bool) -> list[Measurement]:
    """Straight walls of 3-20 m by the line with its end-point posterior, recessed ones by depth along it."""
    rng = np.random.default_rng(seed)
    draws = QUICK_WALL_DRAWS if quick else WALL_DRAWS
    straight, recessed = point_clusters.walls(rng, draws), point_clusters.walls(rng, draws, recess_m=RECESS_M)
    scores = wall_scores(fit_line, straight)
    row = _Rows("walls", len(straight), quick)
    row.lower("perpendicular_rmse_m", scores.perpendicular_rmse_m, 0.036)
    row.higher("extent_iou", scores.extent_iou, 0.92)
    row.band("coverage", scores.coverage, 0.93, 0.97)
    depth = wall_scores(fit_depth_line, recessed)
    row.lower("recessed.perpendicular_rmse_m", depth.perpendicular_rmse_m, 0.09)
    row.band("recessed.coverage", depth.coverage, 0.93, 0.97)
    return row.rows


def check_pillar_or_wall(seed: int, quick: bool) -> list[Measurement]:
    """Class by evidence between the MIC contour and the line, on as many pillars as walls."""
    rng = np.random.default_rng(seed)
    draws = QUICK_WALL_DRAWS if quick else WALL_DRAWS
    pillars = point_clusters.partial_pillars(rng, draws)
    rows = _Rows("class", len(pillars), quick)
    pillar_right = np.array([_wall_evidence(one) < 0 for one in pillars], float)
    for name, length, bar in (("walls_3_20_m", (3.0, 20.0), 0.99), ("walls_0.8_3_m", (0.8, 3.0), 0.88)):
        drawn = point_clusters.walls(rng, draws, length)
        wall_right = np.array([_wall_evidence(one) > 0 for one in drawn], float)
        rows.higher(f"{name}.right", wall_right, bar)
    rows.higher("pillars.right", pillar_right, 0.88)
    return rows.rows


def closed_scores(fit: Method, made: Sequence[point_clusters.MadeObject]) -> ClosedScores:
    """Scores of a method on closed contours."""
    return ClosedScores(*np.array([_closed(fit(one.points), one) for one in made]).T)


def wall_scores(fit: Method, made: Sequence[point_clusters.MadeObject]) -> WallScores:
    """Scores of a method on walls: distances are perpendicular to the wall, where the estimate lies beside it."""
    return WallScores(*np.array([_wall(fit(one.points), one) for one in made]).T)


def _closed(fit: ShapeFit, made: point_clusters.MadeObject) -> tuple[float, float, float, float]:
    if not fit.is_usable:
        return 0.0, np.nan, np.nan, np.nan
    estimate, truth = shapely.LinearRing(fit.contour_m), shapely.LinearRing(made.contour_m)
    full, visible = (
        float(np.sqrt(np.mean(shapely.distance(estimate, shapely.points(of)) ** 2)))
        for of in (made.contour_m, made.lit_m)
    )
    error = shapely.distance(truth, shapely.points(fit.contour_m))
    covered = float(np.mean(error <= BAND_STD * fit.std_m)) if np.isfinite(fit.std_m).all() else np.nan
    return intersection_over_union(fit.contour_m, made.contour_m), full, visible, covered


def _wall(fit: ShapeFit, made: point_clusters.MadeObject) -> tuple[float, float, float]:
    start, end = made.contour_m[0], made.contour_m[-1]
    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    axes = np.stack([along, np.array([-along[1], along[0]])])
    place, depth = axes @ (fit.contour_m - start).T
    true_place, true_depth = axes @ (made.contour_m - start).T
    beside = (place >= 0) & (place <= length)
    if not beside.any():
        return np.nan, 0.0, 0.0
    error = (depth - np.interp(place, true_place, true_depth))[beside]
    covered = np.mean(np.abs(error) <= BAND_STD * fit.std_m[beside])
    return float(np.sqrt(np.mean(error**2))), extent_iou(fit.contour_m, made.lit_m), float(covered)


def _wall_evidence(made: point_clusters.MadeObject) -> float:
    return fit_line(made.points).log_evidence - fit_mic(made.points).log_evidence


class _Rows:
    """Rows of one kind of object: means over the sets; --quick allows three standard errors more."""

    def __init__(self, name: str, n_sets: int, quick: bool) -> None:
        self.name, self.n_sets, self.quick = name, n_sets, quick
        self.rows: list[Measurement] = []

    def higher(self, key: str, values: FloatArray, bar: float) -> None:
        self._add(key, values, bar, 1)

    def lower(self, key: str, values: FloatArray, bar: float) -> None:
        self._add(key, values, bar, -1)

    def band(self, key: str, values: FloatArray, low: float, high: float) -> None:
        self._add(f"{key}_least", values, low, 1)
        self._add(f"{key}_most", values, high, -1)

    def _add(self, key: str, values: FloatArray, bar: float, sign: int) -> None:
        allowed = round(quick_bar(bar, -sign * standard_error(values), self.quick), 4)
        reason = f"{self.n_sets} sets" + (", 3 standard errors allowed" if self.quick else "")
        row, unit = at_least if sign > 0 else at_most, "m" if key.endswith("_m") else "1"
        self.rows.append(row(f"{self.name}.{key}", np.nanmean(values), allowed, reason, unit))
