"""Distances between an estimated outline and the true one.

Outlines are dense points. A closed outline runs in either direction and does not repeat its first point.
Distances are those of points to the line of the other outline, so they do not depend on the spacing of that line.
"""

from collections.abc import Sequence

import numpy as np
import shapely

from isac_arena.scoring.metrics.sets import Gospa, gospa
from scenes.record import FloatArray


def intersection_over_union(points_a_m: FloatArray, points_b_m: FloatArray) -> float:
    """Area of intersection over union (Jaccard index) of two closed outlines (point, xy).

    Self-crossings are repaired. It is 0 where the union has no area, but 1 for two equal outlines.
    """
    a, b = (shapely.make_valid(shapely.Polygon(points)) for points in (points_a_m, points_b_m))
    union = a.union(b).area
    if union == 0:
        return float(np.array_equal(points_a_m, points_b_m))
    return float(a.intersection(b).area / union)


def outline_distances(
    points_a_m: FloatArray, points_b_m: FloatArray, *, a_closed: bool = True, b_closed: bool = True
) -> tuple[FloatArray, FloatArray]:
    """Distance in m of every point of a to the line through b (point_a,), and of every point of b to a
    (point_b,).
    """
    line_a, line_b = _line(points_a_m, a_closed), _line(points_b_m, b_closed)
    return (
        np.asarray(shapely.distance(line_b, shapely.points(points_a_m))),
        np.asarray(shapely.distance(line_a, shapely.points(points_b_m))),
    )


def hausdorff_m(a_to_b_m: FloatArray, b_to_a_m: FloatArray) -> float:
    """Hausdorff distance: the largest distance of any point of one outline to the other."""
    return float(max(a_to_b_m.max(), b_to_a_m.max()))


def modified_hausdorff_m(a_to_b_m: FloatArray, b_to_a_m: FloatArray) -> float:
    """Modified Hausdorff distance: the larger of the two mean distances.

    Source: Dubuisson and Jain, "A modified Hausdorff distance for object matching", ICPR 1994, distance d22.
    """
    return float(max(a_to_b_m.mean(), b_to_a_m.mean()))


def chamfer_m(a_to_b_m: FloatArray, b_to_a_m: FloatArray) -> float:
    """Chamfer distance: the mean of the two mean distances."""
    return float((a_to_b_m.mean() + b_to_a_m.mean()) / 2)


def perpendicular_rmse_m(points_m: FloatArray, start_m: FloatArray, end_m: FloatArray) -> float:
    """RMS distance of points (point, xy) to the infinite line through two points (xy,) of a wall.

    Raises `ValueError` where the two points are equal.
    """
    along = end_m - start_m
    length = float(np.hypot(*along))
    if length == 0:
        raise ValueError(f"start_m = end_m = {start_m}: two distinct points of the wall are needed")
    offset = points_m - start_m
    distance = (along[0] * offset[:, 1] - along[1] * offset[:, 0]) / length
    return float(np.sqrt(np.square(distance).mean()))


def interval_iou(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Overlap over union of two intervals (low, high); the union includes a gap between them."""
    overlap = min(a[1], b[1]) - max(a[0], b[0])
    union = max(a[1], b[1]) - min(a[0], b[0])
    return float(max(overlap, 0.0) / union) if union > 0 else 1.0


def extent_iou(points_m: FloatArray, lit_points_m: FloatArray) -> float:
    """`interval_iou` of two sets of points (point, xy) along the main direction of the lit points.

    Only the lit part of a wall is observable, so the lit points are the truth and not the ends of the wall. NaN
    where there are fewer than two distinct lit points or no points.
    """
    if len(lit_points_m) < 2 or not len(points_m):
        return float("nan")
    middle = lit_points_m.mean(axis=0)
    _, spread, axes = np.linalg.svd(lit_points_m - middle, full_matrices=False)
    if spread[0] < 1e-9:
        return float("nan")
    lit, seen = (lit_points_m - middle) @ axes[0], (points_m - middle) @ axes[0]
    return interval_iou((seen.min(), seen.max()), (lit.min(), lit.max()))


def scene_gospa(estimates_m: Sequence[FloatArray], truths_m: Sequence[FloatArray], order: float = 2.0) -> Gospa:
    """GOSPA of whole scenes: closed outlines (point, xy) with base distance 1 - IoU and cutoff 1."""
    distance = np.array(
        [[1 - intersection_over_union(estimate, truth) for truth in truths_m] for estimate in estimates_m]
    ).reshape(len(estimates_m), len(truths_m))
    return gospa(distance, 1.0, order)


def _line(points_m: FloatArray, closed: bool) -> shapely.Geometry:
    return shapely.LinearRing(points_m) if closed else shapely.LineString(points_m)
