"""Peer methods for points: prior only, radial GP of the paper, convex hull, circle, random-matrix ellipse."""

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull, QhullError

from estimation.shape.fit import OK, PRIOR, ShapeFit, failed_fit
from estimation.shape.gp.clustering import to_polar
from estimation.shape.gp.radial import fit_radial_gp
from estimation.shape.points.cluster import PointCluster
from scenes.record import FloatArray

N_SAMPLES = 180
PRIOR_RADIUS_M, PRIOR_RADIUS_STD_M = 0.5, 0.2
PRIOR_BEHIND_M, PRIOR_CENTER_STD_M = 0.4, 0.2


def fit_prior_only(points: PointCluster) -> ShapeFit:
    """A circle that uses the prior only: radius 0.5 m, centre 0.4 m behind the centroid.

    Every comparison needs it: the side of the sensor and a usual radius explain much of the gain of any method.
    """
    center = points.position_m.mean(axis=0) + PRIOR_BEHIND_M * points.away
    variance = np.diag([PRIOR_CENTER_STD_M**2, PRIOR_CENTER_STD_M**2, PRIOR_RADIUS_STD_M**2])
    return circle_shape(center, PRIOR_RADIUS_M, variance, PRIOR)


def fit_paper_gp(points: PointCluster) -> ShapeFit:
    """The paper's radial Gaussian process about the centroid, sampled on the full circle, as printed."""
    center = points.position_m.mean(axis=0)
    gp = fit_radial_gp(*to_polar(points.position_m, center), start="paper", mean_uncertainty=False)
    radius, std = gp.predict(_angles())
    contour = center + radius[:, None] * _unit(_angles())
    names = ["mean_m", "signal_std_m", "length_scale", "noise_std_m"]
    values = np.array([gp.mean_m, gp.signal_std_m, gp.length_scale, gp.noise_std_m])
    return closed_shape("star_convex", contour, std, values, names, log_evidence=gp.log_likelihood)


def fit_convex_hull(points: PointCluster) -> ShapeFit:
    """Convex hull of the points, the idea of Ge et al. 2025; it gives no uncertainty."""
    try:
        hull = points.position_m[ConvexHull(points.position_m).vertices]
    except (QhullError, ValueError):
        return failed_fit("star_convex", "the points span no area")
    return closed_shape("star_convex", hull, np.full(len(hull), np.nan), np.zeros(0), [])


def fit_circle(points: PointCluster) -> ShapeFit:
    """Circle with the least sum of squared distances, each over its variance along the radius.

    It fails without three points that are not on a line.
    """
    start = _algebraic_circle(points.position_m)
    if start is None:
        return failed_fit("circle", "three points off a line are needed")

    def residual(circle: FloatArray) -> FloatArray:
        offset = points.position_m - circle[:2]
        distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-9)
        outward = offset / distance[:, None]
        std = np.sqrt(np.einsum("ij,ijk,ik->i", outward, points.covariance_m2, outward))
        return np.asarray((distance - circle[2]) / std)

    found = least_squares(residual, start, x_scale=[0.1, 0.1, 0.1], max_nfev=100)
    information = found.jac.T @ found.jac
    if not found.success or found.x[2] <= 0 or np.linalg.cond(information) > 1e12:
        return failed_fit("circle", "the points do not determine a circle")
    return circle_shape(found.x[:2], float(found.x[2]), np.linalg.inv(information))


def fit_random_matrix(points: PointCluster) -> ShapeFit:
    """Ellipse of the random-matrix model for points spread over the inside of an object.

    The extension is four times the spread of the points beyond their covariances, with half axes of at least 5
    cm. Source: Feldmann, Franken and Koch, "Tracking of extended objects and group targets using random
    matrices", IEEE TSP 2011, with the scaling factor 1/4 of a uniformly filled ellipse.
    """
    center = points.position_m.mean(axis=0)
    offset = points.position_m - center
    spread = offset.T @ offset / max(len(points) - 1, 1) - points.covariance_m2.mean(axis=0)
    value, vector = np.linalg.eigh(spread)
    half_axis = np.sqrt(np.maximum(4 * value, 0.05**2))
    contour = center + (half_axis * _unit(_angles())) @ vector.T
    if np.linalg.det(vector) < 0:
        contour = contour[::-1]
    relative_std = np.sqrt(1 / (2 * max(len(points) - 1, 1)))
    scale = np.linalg.norm(contour - center, axis=1)
    names = ["center_x_m", "center_y_m", "half_axis_minor_m", "half_axis_major_m"]
    return closed_shape("ellipse", contour, relative_std * scale, np.concatenate([center, half_axis]), names)


def circle_shape(center_m: FloatArray, radius_m: float, covariance: FloatArray, status: str = OK) -> ShapeFit:
    """A circle with the covariance (3, 3) of its centre and radius in m^2."""
    unit = _unit(_angles())
    by_parameter = np.column_stack([unit, np.ones(len(unit))])
    std = np.sqrt(np.einsum("np,pq,nq->n", by_parameter, covariance, by_parameter))
    values = np.append(center_m, radius_m)
    names = ["center_x_m", "center_y_m", "radius_m"]
    return closed_shape("circle", center_m + radius_m * unit, std, values, names, covariance, status=status)


def closed_shape(
    kind: str,
    contour_m: FloatArray,
    std_m: FloatArray,
    parameter: FloatArray,
    names: list[str],
    covariance: FloatArray | None = None,
    log_evidence: float = np.nan,
    status: str = OK,
) -> ShapeFit:
    """A closed contour; its extent is the mean distance of its samples from their mean."""
    radius = np.linalg.norm(contour_m - contour_m.mean(axis=0), axis=1)
    size = len(parameter)
    return ShapeFit(
        kind=kind,
        status=status,
        is_closed=True,
        contour_m=contour_m,
        std_m=std_m,
        log_evidence=log_evidence,
        parameter=parameter,
        parameter_covariance=np.full((size, size), np.nan) if covariance is None else covariance,
        parameter_name=np.array(names, dtype=np.str_),
        extent_m=float(radius.mean()),
        extent_std_m=float(np.mean(std_m)),
    )


def _algebraic_circle(position_m: FloatArray) -> FloatArray | None:
    """Centre and radius (3,) in m by linear least squares (Kasa 1976); None for points on a line."""
    middle = position_m.mean(axis=0)
    offset = position_m - middle
    system = np.column_stack([2 * offset, np.ones(len(offset))])
    solution, _, rank, _ = np.linalg.lstsq(system, np.sum(offset**2, axis=1), rcond=1e-9)
    square = solution[2] + solution[:2] @ solution[:2]
    if rank < 3 or square <= 0:
        return None
    return np.append(middle + solution[:2], np.sqrt(square))


def _angles() -> FloatArray:
    return np.linspace(0, 2 * np.pi, N_SAMPLES, endpoint=False)


def _unit(angle_rad: FloatArray) -> FloatArray:
    return np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)
