"""Columns with flat faces among the points of a campaign that no other closed contour explains.

Paths that such a column mirrors are few: its corners diffract, its faces scatter. What was found of it are edges
and short walls. Points that lie close together are fitted as a column, a box, a plate or a spot; where the column
is the most probable, it takes the place of the edges and walls that were found of it.
"""

from collections.abc import Sequence

import numpy as np
import shapely

from estimation.shape.config import ContourConfig, ReflectionConfig
from estimation.shape.fit import OK, PRIOR, FoundContour, ShapeFit
from estimation.shape.gp.clustering import cluster_points
from estimation.shape.kinds.closed import PRIOR_SHARE
from estimation.shape.record import N_CONTOUR_SAMPLES
from estimation.shape.reflection.blocks.fit import BlockFit, block_models, fit_block
from estimation.shape.reflection.blocks.law import SeenPoints
from estimation.shape.reflection.normals import OrientedPoints
from estimation.shape.reflection.reflections import Reflections
from scenes.record import FloatArray, IntArray

_LONG_M = 3.0  # longer walls are no faces of columns
_BESIDE_M = 0.3  # of a device, a long wall or a closed contour: points that are its own
_LARGEST_M = 4.0  # extent of a group of points
_LEAST_POINTS = 15  # fewer do not tell two faces
_STEP = 1e-4
_LIKELY = 0.5
_SURE = 0.75  # a column, not a box of any other sides: both of its faces show


def with_columns(
    found: Sequence[FoundContour], points: OrientedPoints, data: Reflections, config: ContourConfig
) -> list[FoundContour]:
    """The contours with columns of four flat faces in place of the edges and short walls found of them."""
    found = list(found)
    seen = SeenPoints(points.position_m, points.covariance_m2, data.tx[:, :2], data.rx_state[:, :2])
    for rows in _groups(found, seen, config.eps_m, config.min_samples):
        column, probability = _column(SeenPoints(*(each[rows] for each in seen)), config.reflection)
        if column is None or probability <= _SURE:
            continue
        shape, members = column_shape(column, config.reflection), rows[column.member > _LIKELY]
        if len(members) < _LEAST_POINTS or shape.status != OK or _is_in_wall(shape, found):
            continue
        kept = [each for each in found if not _is_part(each, members)]
        other = (1 - probability) / 2
        found = [*kept, FoundContour(shape, members, [other, other, probability])]
    return found


def _column(points: SeenPoints, config: ReflectionConfig) -> tuple[BlockFit | None, float]:
    """The column through points, None where there is none, and its probability among the models."""
    models = block_models(config)
    column = fit_block(models.pop("column"), points, config)
    if column is None:
        return None, 0.0
    log_others: list[float] = []
    for model in models.values():
        if (other := fit_block(model, points, config)) is not None:
            log_others.append(other.log_evidence)
            if other.log_evidence > column.log_evidence:
                return column, 0.0
    total = np.logaddexp.reduce([column.log_evidence, *log_others])
    return column, float(np.exp(column.log_evidence - total))


def column_shape(fit: BlockFit, config: ReflectionConfig) -> ShapeFit:
    """The record of a column: its corners joined, with the deviation along the normal of every sample."""
    contour, value = _contour(fit.value), fit.value
    step = _STEP * np.eye(len(value))
    slope = np.array([(_contour(value + each) - _contour(value - each)) / (2 * _STEP) for each in step])
    normal_rad = value[3] + np.pi / 2 * np.repeat(np.arange(4), N_CONTOUR_SAMPLES // 4)
    normal = np.column_stack([np.cos(normal_rad), np.sin(normal_rad)])
    across = np.einsum("psa,sa->sp", slope, normal)
    log_std, half_m = float(np.sqrt(fit.covariance[2, 2])), float(np.exp(value[2]))
    return ShapeFit(
        kind="square",
        status=OK if log_std < PRIOR_SHARE * config.radius_log_std else PRIOR,
        is_closed=True,
        contour_m=contour,
        std_m=np.sqrt(np.einsum("sp,pq,sq->s", across, fit.covariance, across) + config.wall_relief_m**2),
        log_evidence=fit.log_evidence,
        parameter=value,
        parameter_covariance=fit.covariance,
        parameter_name=np.array(["center_x_m", "center_y_m", "log_half_width", "turn_rad"]),
        extent_m=half_m,
        extent_std_m=half_m * log_std,
    )


def _contour(value: FloatArray) -> FloatArray:
    """Samples (sample, xy) of a square [x, y, log half width, turn], as many on every face."""
    n = N_CONTOUR_SAMPLES // 4
    along, azimuth = 2 * np.arange(n) / n - 1, value[3] + np.pi / 2 * np.arange(4)
    normal = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    unit = normal[:, None] + along[:, None] * tangent[:, None]
    return np.asarray(value[:2] + np.exp(value[2]) * unit.reshape(-1, 2))


def _groups(found: Sequence[FoundContour], points: SeenPoints, eps_m: float, min_samples: int) -> list[IntArray]:
    """Rows of the points that lie close together, away from devices, long walls and closed contours."""
    is_free = np.linalg.eigvalsh(points.covariance_m2)[:, -1] <= eps_m**2
    for end in (points.tx_m, points.rx_m):
        is_free &= np.linalg.norm(points.position_m - end, axis=1) > _BESIDE_M
    for shape, rows, _ in found:
        if shape.is_closed:
            is_free[rows] = False
        if shape.is_closed or _is_long(shape):
            of = shapely.Polygon(shape.contour_m) if shape.is_closed else shapely.LineString(shape.contour_m)
            is_free &= shapely.distance(of, shapely.points(points.position_m)) > _BESIDE_M
    rest = np.flatnonzero(is_free)
    label = cluster_points(points.position_m[rest], eps_m, min_samples)
    groups = [rest[label == k] for k in range(int(label.max(initial=-1)) + 1)]
    groups = [rows for rows in groups if len(rows) >= _LEAST_POINTS]
    return [rows for rows in groups if np.ptp(points.position_m[rows], axis=0).max() <= _LARGEST_M]


def _is_long(shape: ShapeFit) -> bool:
    return not shape.is_closed and shape.extent_m > _LONG_M


def _is_part(each: FoundContour, members: IntArray) -> bool:
    """Whether most paths of an edge or a short wall are of a body with these paths."""
    is_short = not each.shape.is_closed and not _is_long(each.shape)
    return is_short and float(np.isin(each.rows, members).mean()) > 0.5


def _is_in_wall(shape: ShapeFit, found: Sequence[FoundContour]) -> bool:
    """Whether a body reaches through a long wall."""
    body = shapely.Polygon(shape.contour_m)
    return any(body.intersects(shapely.LineString(each.contour_m)) for each, *_ in found if _is_long(each))
