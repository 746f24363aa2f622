"""Scores of estimated contours against the true outlines of the objects they show."""

from dataclasses import dataclass

import numpy as np
import shapely

from estimation.shape.record import Shapes
from isac_arena.scoring.metrics.consistency import gaussian_crps
from isac_arena.scoring.metrics.contours import (
    chamfer_m,
    extent_iou,
    hausdorff_m,
    intersection_over_union,
    modified_hausdorff_m,
)
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.metrics.statistics import mean, rms
from isac_arena.scoring.record import OutlineScores
from scenes.contours import Contour
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray
from scenes.scene import OBJECT_KINDS, Scene

BAND_SIGMAS = 2.0  # the paper's 95 % interval, section III-C: mean +- 2 standard deviations
OUTLINE_SPACING_M = 0.02
# A contour counts as seen this close to the direction of a point that it was fitted to.
SEEN_MARGIN_RAD = np.deg2rad(10.0)


@dataclass(frozen=True)
class ShapeErrors:
    """Errors of one contour, NaN where not defined; units and meaning as in `OutlineScores`."""

    iou: float = np.nan
    hausdorff_m: float = np.nan
    modified_hausdorff_m: float = np.nan
    chamfer_m: float = np.nan
    seen_rmse_m: float = np.nan
    full_rmse_m: float = np.nan
    coverage95: float = np.nan
    seen_coverage95: float = np.nan
    crps_m: float = np.nan
    extent_iou: float = np.nan


def contour_points_m(shapes: Shapes, cluster: int) -> FloatArray:
    """Points (sample, xy) of the estimated contour of one cluster."""
    unit = np.stack([np.cos(shapes.angle_rad), np.sin(shapes.angle_rad)], axis=-1)
    return np.asarray(shapes.center_m[cluster] + shapes.radius_m[cluster][:, None] * unit)


def seen_samples(angle_rad: FloatArray, training_rad: FloatArray, margin_rad: float) -> BoolArray:
    """Mask (sample,) of the polar angles within the margin of a training angle."""
    distance = np.abs(wrap_angle(angle_rad[:, None] - training_rad[None]))
    return np.asarray((distance <= margin_rad).any(axis=1))


def distance_errors(distance_m: FloatArray, back_m: FloatArray, seen: BoolArray) -> dict[str, float]:
    """Errors by name, from the distances (sample,) of a contour to the true outline and (point,) back from it.

    `seen` (sample,) marks the part of the contour that was seen.
    """
    return {
        "hausdorff_m": hausdorff_m(distance_m, back_m),
        "modified_hausdorff_m": modified_hausdorff_m(distance_m, back_m),
        "chamfer_m": chamfer_m(distance_m, back_m),
        "seen_rmse_m": rms(distance_m[seen]),
        "full_rmse_m": rms(distance_m),
    }


def shape_errors(
    shapes: Shapes, cluster: int, members_m: FloatArray, contour: Contour, lit_points_m: FloatArray
) -> ShapeErrors:
    """Errors of the contour of one cluster against the contour of its object.

    `members_m` (ip, xy) are the cluster's IPs, `lit_points_m` (point, xy) the true incidence points on the object
    over the whole campaign. The band is tested at the angles where a ray from the cluster's centre meets the true
    contour; the farthest crossing counts.
    """
    points = contour_points_m(shapes, cluster)
    offset = members_m - shapes.center_m[cluster]
    training = np.arctan2(offset[:, 1], offset[:, 0])
    seen = seen_samples(shapes.angle_rad, training, SEEN_MARGIN_RAD)
    distance = np.abs(contour.signed_distance(points))
    back = np.asarray(
        shapely.distance(shapely.LinearRing(points), shapely.points(contour.sample(OUTLINE_SPACING_M)))
    )
    true_radius = contour.radius(shapes.center_m[cluster], shapes.angle_rad)
    half_width = BAND_SIGMAS * shapes.radius_std_m[cluster]
    covered = np.abs(true_radius - shapes.radius_m[cluster]) <= half_width
    exists = np.isfinite(true_radius)
    crps = gaussian_crps(
        true_radius[exists], shapes.radius_m[cluster][exists], shapes.radius_std_m[cluster][exists]
    )
    return ShapeErrors(
        iou=intersection_over_union(points, np.asarray(contour.outline.coords)) if contour.closed else np.nan,
        **distance_errors(distance, back, seen),
        coverage95=mean(covered[exists]),
        seen_coverage95=mean(covered[exists & seen]),
        crps_m=mean(crps),
        extent_iou=extent_iou(points[seen], lit_points_m),
    )


def shape_metrics(map_name: str, scene: Scene, clusters: OutlineScores) -> list[Metric]:
    """Scores of one map's shapes of clusters."""
    return outline_metrics(f"shapes.{map_name}", scene, clusters)


def outline_metrics(prefix: str, scene: Scene, table: OutlineScores) -> list[Metric]:
    """Coverage over all objects, means per kind, and errors per object.

    Each object counts once, with its best row (`best_rows`).
    """
    best = best_rows(table)
    rows = table.take("outline", [best[item.name] for item in scene.fixtures if item.name in best])
    metrics = [Metric(f"{prefix}.coverage95", mean(rows.coverage95), "1", "info")]
    metrics.append(Metric(f"{prefix}.seen_coverage95", mean(rows.seen_coverage95), "1", "info"))
    for kind in OBJECT_KINDS:
        chosen = [best[item.name] for item in scene.fixtures if item.kind == kind and item.name in best]
        metrics += _mean_metrics(f"{prefix}.{kind}", table.take("outline", np.array(chosen, int)))
    for item in scene.fixtures:
        metrics += _object_metrics(f"{prefix}.{item.name}", table, best.get(item.name))
    return metrics


def best_rows(table: OutlineScores) -> dict[str, int]:
    """Row by object: the row with the most incidence points close to the object, the first of equal ones."""
    best: dict[str, int] = {}
    for row, name in enumerate(table.object.tolist()):
        if name and (name not in best or table.n_close[row] > table.n_close[best[name]]):
            best[name] = row
    return best


def _mean_metrics(prefix: str, rows: OutlineScores) -> list[Metric]:
    return [
        Metric(f"{prefix}.count", len(rows.object), "1", "info"),
        Metric(f"{prefix}.iou.count", np.isfinite(rows.iou).sum(), "1", "info"),
        Metric(f"{prefix}.iou.mean", mean(rows.iou), "1", "higher"),
        Metric(f"{prefix}.hausdorff.mean_m", mean(rows.hausdorff_m), "m", "lower"),
        Metric(f"{prefix}.modified_hausdorff.mean_m", mean(rows.modified_hausdorff_m), "m", "lower"),
        Metric(f"{prefix}.chamfer.mean_m", mean(rows.chamfer_m), "m", "lower"),
        Metric(f"{prefix}.crps.mean_m", mean(rows.crps_m), "m", "lower"),
        Metric(f"{prefix}.seen_rmse.mean_m", mean(rows.seen_rmse_m), "m", "lower"),
        Metric(f"{prefix}.full_rmse.mean_m", mean(rows.full_rmse_m), "m", "lower"),
        Metric(f"{prefix}.extent_iou.mean", mean(rows.extent_iou), "1", "higher"),
        Metric(f"{prefix}.coverage95.mean", mean(rows.coverage95), "1", "info"),
        Metric(f"{prefix}.seen_coverage95.mean", mean(rows.seen_coverage95), "1", "info"),
    ]


def _object_metrics(prefix: str, table: OutlineScores, row: int | None) -> list[Metric]:
    def value(name: str) -> float:
        return float(getattr(table, name)[row]) if row is not None else float("nan")

    return [
        Metric(f"{prefix}.iou", value("iou"), "1", "higher"),
        Metric(f"{prefix}.hausdorff_m", value("hausdorff_m"), "m", "lower"),
        Metric(f"{prefix}.seen_rmse_m", value("seen_rmse_m"), "m", "lower"),
        Metric(f"{prefix}.full_rmse_m", value("full_rmse_m"), "m", "lower"),
        Metric(f"{prefix}.extent_iou", value("extent_iou"), "1", "higher"),
        Metric(f"{prefix}.coverage95", value("coverage95"), "1", "info"),
    ]
