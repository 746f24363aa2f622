"""Statistics of the chain: stops, and objects of one map, of one campaign or of several together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from estimation.slam.record import N_STATE, SolveStatus
from isac_arena.scoring.metrics.statistics import mean, ratio, rms
from isac_arena.scoring.record import MapScores, PoseScores
from isac_arena.scoring.stages.shapes import best_rows
from isac_arena.validation.chain.run import ChainResult
from scenes.record import BoolArray, FloatArray, IntArray, TextArray
from scenes.scene import Scene

KNOWN_M = 0.3  # a stop whose bound is below has the paths that determine its position
GROSS_STD, GROSS_M = 5.0, 1.0  # beyond either, a position is off
FLAGGED_STD = 3.0  # beyond it a position has to be flagged
LIT_STOPS = 5  # a pillar that single bounces show from so many stops can be fitted


class Columns:
    """Columns of arrays that campaigns share."""

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Those of several campaigns, one after the other."""
        names = [each.name for each in fields(cls)]  # type: ignore[arg-type]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True)
class ChainStops(Columns):
    """Stops of one campaign or of several: errors of SLAM, bounds, and what SLAM states."""

    error_m: FloatArray  # (stop,) NaN where SLAM has no solution
    bound_m: FloatArray  # (stop,) from the paths of the stop alone; infinite where they do not determine it
    std_m: FloatArray  # (stop,) stated, over all modes
    nees: FloatArray  # (stop,) of the state
    has_los: BoolArray  # (stop,)
    is_solved: BoolArray  # (stop,)
    is_flagged: BoolArray  # (stop,) ambiguous

    @property
    def is_known(self) -> BoolArray:
        """Stops (stop,) whose bound is below `KNOWN_M`."""
        return np.asarray(self.bound_m < KNOWN_M)

    @property
    def over_bound(self) -> float:
        """RMS error over RMS bound of the solved stops that are known."""
        chosen = self.is_known & self.is_solved
        return ratio(rms(self.error_m[chosen]), rms(self.bound_m[chosen])) if chosen.any() else np.nan

    @property
    def over_any_bound(self) -> float:
        """The same over all solved stops with a finite bound: the metric `slam.position.over_bound`."""
        chosen = np.isfinite(self.bound_m) & self.is_solved
        return ratio(rms(self.error_m[chosen]), rms(self.bound_m[chosen])) if chosen.any() else np.nan

    @property
    def normalised_nees(self) -> float:
        """Mean NEES over the degrees of freedom of a state: position, heading and clock."""
        return mean(self.nees) / N_STATE

    def solved(self, chosen: BoolArray | None = None) -> float:
        """Share of the known stops, or of those that are `chosen` as well, with a solution."""
        return mean(self.is_solved[self.is_known if chosen is None else self.is_known & chosen])

    @property
    def is_unflagged_gross(self) -> BoolArray:
        """Stops (stop,) that are off by more than 5 stated deviations, or by more than 1 m, without a flag."""
        is_off = (self.error_m > GROSS_STD * self.std_m) | (self.error_m > GROSS_M)
        return is_off & self.is_solved & ~self.is_flagged

    @property
    def far_flagged(self) -> float:
        """Share of the stops beyond 3 stated deviations that are flagged; 1 where there is none."""
        is_far = self.is_solved & (self.error_m > FLAGGED_STD * self.std_m)
        return mean(self.is_flagged[is_far]) if is_far.any() else 1.0


@dataclass(frozen=True)
class ChainObjects(Columns):
    """Objects and contours of one map, of one campaign or of several.

    An object has the values of its best contour: the one with the most incidence points close to it.
    """

    kind: TextArray  # (object,)
    radius_m: FloatArray  # (object,) of the circle of its area; NaN for an open contour
    n_lit: IntArray  # (object,) stops from which a significant single bounce meets it
    is_found: BoolArray  # (object,)
    iou: FloatArray  # (object,) 0 without a closed contour
    coverage: FloatArray  # (object,) of the band, where seen
    seen_rmse_m: FloatArray  # (object,)
    class_right: FloatArray  # (contour,) of those with an object
    is_ghost: BoolArray  # (contour,)

    def pillar_iou(self, radii_m: tuple[float, float] = (0.0, np.inf)) -> FloatArray:
        """IoU (pillar,) of the pillars with radii within the given ones that 5 stops or more can see."""
        least, most = radii_m
        chosen = (self.kind == "pillar") & (self.n_lit >= LIT_STOPS)
        return np.asarray(self.iou[chosen & (self.radius_m >= least) & (self.radius_m <= most)])

    @property
    def wall_rmse_m(self) -> float:
        """Mean over walls of the RMS distance of the seen contour to the wall."""
        return mean(self.seen_rmse_m[self.kind == "wall"])

    @property
    def n_walls(self) -> int:
        """Walls found."""
        return int(self.is_found[self.kind == "wall"].sum())


def chain_stops(poses: PoseScores) -> ChainStops:
    """The stops of one campaign."""
    return ChainStops(
        error_m=poses.position_error_m,
        bound_m=poses.position_bound_m,
        std_m=poses.position_std_m,
        nees=poses.nees,
        has_los=poses.has_los,
        is_solved=np.asarray(poses.status != SolveStatus.FAILED),
        is_flagged=poses.is_ambiguous,
    )


def mapped_objects(result: ChainResult) -> ChainObjects:
    """The objects of one campaign in the map of mapping."""
    return _objects(result, result.tables.mapping)


def slam_objects(result: ChainResult) -> ChainObjects:
    """The objects of one campaign in the map of SLAM."""
    return _objects(result, result.tables.slam)


def _objects(result: ChainResult, scores: MapScores) -> ChainObjects:
    """The objects of one campaign in one map."""
    scene, contours, significant = result.scene, scores.contours, result.tables.significant
    best = best_rows(contours)
    row = np.array([best.get(item.name, -1) for item in scene.objects], int)
    lit = [len(np.unique(significant.stop[significant.object == item.name])) for item in scene.objects]
    return ChainObjects(
        kind=np.array([item.kind for item in scene.objects], str),
        radius_m=_radii_m(scene),
        n_lit=np.array(lit, int),
        is_found=np.append(contours.is_found, False)[row],
        iou=np.append(np.nan_to_num(contours.iou), 0.0)[row],
        coverage=np.append(contours.seen_coverage95, np.nan)[row],
        seen_rmse_m=np.append(contours.seen_rmse_m, np.nan)[row],
        class_right=contours.class_right[np.isfinite(contours.class_right)],
        is_ghost=contours.is_ghost,
    )


def pooled_stops(results: Sequence[ChainResult]) -> ChainStops:
    """The stops of several campaigns together."""
    return ChainStops.joined([chain_stops(result.tables.poses) for result in results])


def pooled_objects(results: Sequence[ChainResult], of: Callable[[ChainResult], ChainObjects]) -> ChainObjects:
    """The objects of several campaigns together, in one map."""
    return ChainObjects.joined([of(result) for result in results])


def _radii_m(scene: Scene) -> FloatArray:
    areas = np.array([item.contour.area_m2() if item.contour.closed else np.nan for item in scene.objects], float)
    return np.asarray(np.sqrt(areas / np.pi))
