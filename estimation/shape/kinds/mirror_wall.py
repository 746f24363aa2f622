"""Walls as mirrors: the line n . x = d fitted to delays and angles, and its illuminated part.

Every path off a flat wall comes from the mirror image of the TX, so two parameters explain all paths. The paths
show the wall only between the first and the last specular point.
"""

import numpy as np

from estimation.laws.contour import WALL, predict_reflection
from estimation.laws.wall import wall_places
from estimation.shape.config import ReflectionConfig
from estimation.shape.fit import OK, ShapeFit
from estimation.shape.reflection.posterior import Optimum, Prior, best_start, maximise_posterior
from estimation.shape.reflection.reflections import Reflections, ray_points
from scenes.record import FloatArray

_N_STARTS = 6
_SAMPLE_SPACING_M = 0.05


def wall_shape(found: Optimum, data: Reflections, config: ReflectionConfig) -> ShapeFit:
    """The record of a fitted wall over the part that its paths illuminate.

    `parameter` is [azimuth of the normal in rad, offset in m, first and last illuminated place along the wall in
    m]. Places count from the foot of the perpendicular through the origin, along the normal turned by +90 deg.
    """
    ends, ends_slope, ends_variance = _lit_ends(found, data)
    covariance = _with_ends(found.parameter_covariance, ends_slope, ends_variance)
    return _seen_wall(np.array([*found.parameter, *ends]), covariance, found.log_evidence)


def scattering_wall(
    line: FloatArray,
    covariance: FloatArray,
    place_m: FloatArray,
    variance_m2: FloatArray,
    log_evidence: float = np.nan,
) -> ShapeFit:
    """The record of a wall seen at places (path,), of a line with its covariance; see `wall_shape`."""
    ends = [int(np.argmin(place_m)), int(np.argmax(place_m))]
    total = _with_ends(covariance, np.zeros((2, 2)), variance_m2[ends])
    return _seen_wall(np.array([*line, *place_m[ends]]), total, log_evidence)


def longer_wall(shape: ShapeFit, place_m: FloatArray, variance_m2: FloatArray) -> ShapeFit:
    """The record of a wall that is also seen at places (path,) along it; the same without a place."""
    if not len(place_m):
        return shape
    parameter, covariance = shape.parameter.copy(), shape.parameter_covariance.copy()
    for end, sign in ((2, -1), (3, 1)):
        far = int(np.argmax(sign * place_m))
        if sign * place_m[far] > sign * parameter[end]:
            parameter[end], covariance[end], covariance[:, end] = place_m[far], 0.0, 0.0
            covariance[end, end] = variance_m2[far]
    return _seen_wall(parameter, covariance, shape.log_evidence)


def _seen_wall(parameter: FloatArray, covariance: FloatArray, log_evidence: float) -> ShapeFit:
    """The record of a wall with its ends (4,) and their covariance (4, 4)."""
    azimuth, offset, *ends = parameter
    normal = np.array([np.cos(azimuth), np.sin(azimuth)])
    tangent = np.array([-normal[1], normal[0]])
    length = ends[1] - ends[0]
    along = np.linspace(ends[0], ends[1], max(int(np.ceil(length / _SAMPLE_SPACING_M)) + 1, 2))
    # A point at place s moves by (change of d) - s (change of azimuth) along the normal.
    lever = np.column_stack([-along, np.ones(len(along))])
    variance = np.einsum("pi,ij,pj->p", lever, covariance[:2, :2], lever)
    span = np.array([0.0, 0.0, -1.0, 1.0])
    return ShapeFit(
        kind="wall",
        status=OK,
        is_closed=False,
        contour_m=offset * normal + along[:, None] * tangent,
        std_m=np.sqrt(variance),
        log_evidence=log_evidence,
        parameter=parameter,
        parameter_covariance=covariance,
        parameter_name=np.array(["normal_azimuth_rad", "offset_m", "first_end_m", "last_end_m"]),
        extent_m=float(length),
        extent_std_m=float(np.sqrt(max(span @ covariance @ span, 0.0))),
    )


def fit_wall(data: Reflections, config: ReflectionConfig) -> Optimum | None:
    """The most likely [azimuth of the normal, offset]. It starts at the best of the bisectors of several paths.

    Their mean would fall between the modes where ghosts or echoes of another object are among the paths.
    """
    point, normal = ray_points(data)
    chosen = np.argsort(normal)[np.unique(np.linspace(0, len(normal) - 1, _N_STARTS).astype(int))]
    outward = np.column_stack([np.cos(normal[chosen]), np.sin(normal[chosen])])
    starts = np.column_stack([normal[chosen], np.median(outward @ point.T, axis=1)])
    prior = wall_prior(starts[0], config)
    return maximise_posterior(WALL, best_start(WALL, starts, prior, data, config), prior, data, config)


def wall_prior(start: FloatArray, config: ReflectionConfig) -> Prior:
    """Prior of [azimuth, offset]: uniform over all directions and over the width of a square of the area."""
    return Prior(np.zeros(2), np.zeros(2), np.array([2 * np.pi, np.sqrt(config.area_m2)]))


def _lit_ends(found: Optimum, data: Reflections) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Places (end,) in m of the first and last inlier along the wall, slopes (end, 2) and variances (end,).

    The slopes are by azimuth and offset; the variances are those due to the RX positions.
    """
    place, slope, by_rx = wall_places(found.parameter, data.tx, data.rx_state[:, :2])
    is_lit = predict_reflection(WALL, found.parameter, data.tx, data.rx_state).is_lit
    member = np.flatnonzero((found.inlier > 0.5) & is_lit)
    if len(member) == 0:
        member = np.arange(len(place))
    ends = member[[int(np.argmin(place[member])), int(np.argmax(place[member]))]]
    variance = np.einsum("ni,nij,nj->n", by_rx[ends], data.rx_covariance[ends][:, :2, :2], by_rx[ends])
    return place[ends], slope[ends], variance


def _with_ends(covariance: FloatArray, slope: FloatArray, variance: FloatArray) -> FloatArray:
    """Covariance (4, 4) of wall and ends."""
    spread = np.vstack([np.eye(2), slope])
    total = spread @ covariance @ spread.T
    total[2:, 2:] += np.diag(variance)
    return np.asarray(total)
