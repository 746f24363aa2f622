"""Scores of our contours against the true outlines of the objects that their paths stem from."""

from dataclasses import replace

import numpy as np
import shapely

from estimation.shape.record import Contours
from isac_arena.campaign.results import MapResult
from isac_arena.scoring.metrics.consistency import gaussian_crps
from isac_arena.scoring.metrics.contours import extent_iou, intersection_over_union
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.metrics.statistics import mean
from isac_arena.scoring.record import ContourScores, IpScores, SignificantPaths
from isac_arena.scoring.stages.maps import found_kinds
from isac_arena.scoring.stages.outlines import outline_columns
from isac_arena.scoring.stages.shapes import (
    OUTLINE_SPACING_M,
    SEEN_MARGIN_RAD,
    ShapeErrors,
    distance_errors,
    outline_metrics,
    seen_samples,
)
from scenes.contours import Contour
from scenes.record import BoolArray, FloatArray
from scenes.scene import Scene, SceneObject

BAND_SIGMAS = 1.96  # of a Gaussian band of 95 %
CORNER_DISTANCE_M = 0.5  # an edge this close to a corner of its object counts as that corner


def score_contours(scene: Scene, result: MapResult, ips: IpScores, significant: SignificantPaths) -> ContourScores:
    """Table of the contours of one map.

    Raises `ValueError` where the contours do not have one entry for every incidence point.
    """
    contours, n = result.contours, len(result.contours)
    if len(contours.object) != len(ips.stop):
        raise ValueError(
            f"Contours.object: {len(contours.object)} values for {len(ips.stop)} incidence points, "
            "one each is needed"
        )

    def error_of(row: int, item: SceneObject, members_m: FloatArray, lit_m: FloatArray) -> ShapeErrors:
        return contour_errors(contours, row, members_m, item.contour, lit_m)

    own = replace(ips, label=contours.object)
    columns = outline_columns(scene, result, own, n, significant, error_of, lambda row: _line(contours, row))
    right = [
        float(is_class_right(contours, row, scene.object(str(name)))) if name in scene.object_names else np.nan
        for row, name in enumerate(columns["object"])
    ]
    return ContourScores(class_right=np.array(right, float), is_phantom=is_phantom(scene, contours), **columns)


def is_phantom(scene: Scene, contours: Contours) -> BoolArray:
    """Whether each contour (contour,) is closed, and no objects or meshes cover half of its area."""
    bodies = [item.contour.body() for item in scene.fixtures if item.contour.closed]
    bodies += [shapely.Polygon(outline) for mesh in scene.clutter for outline in mesh.plan_outlines_m]
    covered, found = shapely.union_all(bodies), np.zeros(len(contours), bool)
    for row in np.flatnonzero(contours.is_closed):
        area = shapely.make_valid(shapely.Polygon(contours.contour_m[row]))
        found[row] = area.difference(covered).area > area.area / 2
    return found


def contour_errors(
    contours: Contours, row: int, members_m: FloatArray, true: Contour, lit_points_m: FloatArray
) -> ShapeErrors:
    """Errors of one contour; `members_m` (ip, xy) are the IPs that it was fitted to.

    An open contour is seen everywhere. A closed contour is seen in the directions, from its centre, within the
    margin of a member. The band contains the truth where the true outline is within 1.96 standard deviations of
    a sample. An open contour, of a wall or an edge, has no area and no IoU: it is no estimate of an area.
    """
    points, std = contours.contour_m[row], contours.std_m[row]
    distance = np.abs(true.signed_distance(points))
    back = np.asarray(shapely.distance(_line(contours, row), shapely.points(true.sample(OUTLINE_SPACING_M))))
    seen = _seen(contours, row, members_m)
    known = np.isfinite(std)
    covered = distance <= BAND_SIGMAS * std
    crps = gaussian_crps(np.zeros(known.sum()), distance[known], std[known])
    iou = np.nan
    if true.closed and contours.is_closed[row]:
        iou = intersection_over_union(points, np.asarray(true.outline.coords))
    return ShapeErrors(
        iou=iou,
        **distance_errors(distance, back, seen),
        coverage95=mean(covered[known]),
        seen_coverage95=mean(covered[known & seen]),
        crps_m=mean(crps),
        extent_iou=extent_iou(points[seen], lit_points_m),
    )


def is_class_right(contours: Contours, row: int, item: SceneObject) -> bool:
    """Whether the most probable class is that of the object: pillar, or wall or edge for all other objects.

    An edge must be close to a corner of its object. Where a method gives no probabilities, closed contours count
    as pillars and open ones as walls.
    """
    probability = contours.class_probability[row]
    if np.isfinite(probability).all():
        name = str(contours.class_name[probability.argmax()])
    else:
        name = "pillar" if contours.is_closed[row] else "wall"
    if name != "edge":
        return (name == "pillar") == (item.kind == "pillar")
    ends = np.concatenate([piece.point(np.array([0.0, 1.0])) for piece in item.contour.pieces])
    nearest = np.linalg.norm(ends - contours.center_m[row], axis=1).min()
    return item.kind != "pillar" and bool(nearest <= CORNER_DISTANCE_M)


def contour_metrics(map_name: str, scene: Scene, table: ContourScores) -> list[Metric]:
    """Scores of the contours of one map: those of the paper's shapes, then ghosts, objects and classes."""
    prefix = f"contours.{map_name}"
    found = found_kinds(scene, table)
    return [
        *outline_metrics(prefix, scene, table),
        Metric(f"{prefix}.accepted", len(table.object), "1", "info"),
        Metric(f"{prefix}.ghosts", table.is_ghost.sum(), "1", "lower"),
        Metric(f"{prefix}.phantoms", table.is_phantom.sum(), "1", "lower"),
        Metric(f"{prefix}.mixed", table.is_mixed.sum(), "1", "lower"),
        Metric(f"{prefix}.false", table.is_false.sum(), "1", "lower"),
        Metric(f"{prefix}.false_on_surface", table.is_right_surface.sum(), "1", "info"),
        Metric(f"{prefix}.objects_found", len(found), "1", "higher"),
        Metric(f"{prefix}.objects_found.pillar", found.count("pillar"), "1", "higher"),
        Metric(f"{prefix}.objects_found.wall", found.count("wall"), "1", "higher"),
        Metric(f"{prefix}.class_accuracy", mean(table.class_right), "1", "higher"),
        Metric(f"{prefix}.class_mean_coverage95", _class_mean(scene, table), "1", "info"),
    ]


def _class_mean(scene: Scene, table: ContourScores) -> float:
    """Mean of two means, over pillars and over all other objects, so that pillars count as much as many walls."""
    known = scene.object_names
    kinds = np.array([scene.object(name).kind if name in known else "" for name in table.object], dtype=str)
    pillars, others = kinds == "pillar", (kinds != "pillar") & (kinds != "")
    return mean([mean(table.coverage95[pillars]), mean(table.coverage95[others])])


def _seen(contours: Contours, row: int, members_m: FloatArray) -> BoolArray:
    points = contours.contour_m[row]
    if not contours.is_closed[row]:
        return np.ones(len(points), bool)
    offset, member = points - contours.center_m[row], members_m - contours.center_m[row]
    return seen_samples(np.arctan2(*offset.T[::-1]), np.arctan2(*member.T[::-1]), SEEN_MARGIN_RAD)


def _line(contours: Contours, row: int) -> shapely.Geometry:
    points = contours.contour_m[row]
    if np.ptp(points, axis=0).max() == 0:
        return shapely.Point(points[0])
    return shapely.LinearRing(points) if contours.is_closed[row] else shapely.LineString(points)
