"""Incidence points (IPs) with their normals: a circle by generalised least squares on p = c + R n.

The normal of a specular point bisects the angle between its rays to TX and RX. It is computed at the IP, so
point and normal have one joint covariance. To first order the pair carries the same information as delays and
angles. R is the slope of the points against their normals.
"""

from dataclasses import dataclass

import numpy as np

from estimation.laws import plane as plane_law
from estimation.laws.support import CIRCLE, contour_points, normal_std_m
from estimation.shape.config import ReflectionConfig
from estimation.shape.fit import OK, ShapeFit, failed_fit
from estimation.shape.record import N_CONTOUR_SAMPLES
from estimation.shape.reflection.reflections import Reflections, ray_points
from estimation.slam.mapping.point_fit import fit_points
from scenes.record import FloatArray

_ROUNDS = 20
_CONVERGED_M = 1e-6
_DEGREES_OF_FREEDOM = 4.0  # of the Student t weights, which are small for ghosts


@dataclass(frozen=True)
class OrientedPoints:
    """IPs with the normals that bisect their rays."""

    position_m: FloatArray  # (path, xy)
    covariance_m2: FloatArray  # (path, xy, xy)
    normal_rad: FloatArray  # (path,) azimuth of the outward normal
    normal_slope_rad_m: FloatArray  # (path, xy) derivative of the normal by the position


def oriented_points(data: Reflections) -> OrientedPoints:
    """Most likely IP of every path (equation (4) of the paper) and its normal, pose errors in the covariance."""
    start, _ = ray_points(data)
    by_rx = plane_law.bounce_jacobian_rx(data.tx, data.rx_state, start)
    total = data.covariance_with_poses(by_rx)
    position, _ = fit_points(plane_law, data.tx, data.rx_state, data.measured, total)
    by_point = plane_law.bounce_jacobian_point(data.tx, data.rx_state, position)
    information = np.swapaxes(by_point, 1, 2) @ np.linalg.solve(total, by_point)
    floor = 1e-9 * np.einsum("nii->n", information)
    covariance = np.linalg.inv(information + floor[:, None, None] * np.eye(2))
    normal, slope = plane_law.lit_normals(position, data.tx, data.rx_state[:, :2])
    return OrientedPoints(position, covariance, normal, slope)


def residual_covariance(points: OrientedPoints, radius_m: float) -> FloatArray:
    """Covariance (path, xy, xy) of p - c - R n: that of D p with D = I - R e (slope of the normal)'."""
    tangent = np.column_stack([-np.sin(points.normal_rad), np.cos(points.normal_rad)])
    spread = np.eye(2) - radius_m * np.einsum("ni,nj->nij", tangent, points.normal_slope_rad_m)
    return np.asarray(spread @ points.covariance_m2 @ np.swapaxes(spread, 1, 2))


def circle_design(normal_rad: FloatArray) -> FloatArray:
    """Derivative (path, xy, 3) of c + R n by [x, y, R]."""
    design = np.zeros((len(normal_rad), 2, 3))
    design[:, 0, 0], design[:, 1, 1] = 1.0, 1.0
    design[:, :, 2] = np.column_stack([np.cos(normal_rad), np.sin(normal_rad)])
    return design


def fit_normals(data: Reflections, config: ReflectionConfig) -> ShapeFit:
    """A circle through IPs with normals; the radius has a Gaussian prior as wide as the log-normal one.

    The covariance of the residuals depends on R, so the weights are updated until R converges. `parameter` is
    [x, y, R] in m.
    """
    if len(data) == 0:
        return failed_fit("circle", "no paths")
    points = oriented_points(data)
    design = circle_design(points.normal_rad)
    median, std = config.radius_median_m, config.radius_median_m * config.radius_log_std
    prior = np.diag([0.0, 0.0, std**-2])
    circle = np.array([*np.median(points.position_m - median * design[:, :, 2], axis=0), median])
    for _ in range(_ROUNDS):
        inverse = np.linalg.inv(residual_covariance(points, circle[2]))
        residual = points.position_m - design @ circle
        square = np.einsum("ni,nij,nj->n", residual, inverse, residual)
        weight = inverse * ((_DEGREES_OF_FREEDOM + 2) / (_DEGREES_OF_FREEDOM + square))[:, None, None]
        information = np.einsum("nki,nkl,nlj->ij", design, weight, design) + prior
        right = np.einsum("nki,nkl,nl->i", design, weight, points.position_m) + prior[:, 2] * median
        before, circle = circle, np.linalg.solve(information, right)
        circle[2] = max(circle[2], 0.01)
        if np.max(np.abs(circle - before)) < _CONVERGED_M:
            break
    return _shape(circle, np.linalg.inv(information))


def _shape(circle: FloatArray, covariance: FloatArray) -> ShapeFit:
    to_log = np.array([1.0, 1.0, 1 / circle[2]])
    logged = np.array([*circle[:2], np.log(circle[2])])
    psi = np.linspace(-np.pi, np.pi, N_CONTOUR_SAMPLES, False)
    return ShapeFit(
        kind="circle",
        status=OK,
        is_closed=True,
        contour_m=contour_points(CIRCLE, logged, psi),
        std_m=normal_std_m(CIRCLE, logged, covariance * np.outer(to_log, to_log), psi),
        log_evidence=np.nan,
        parameter=circle,
        parameter_covariance=covariance,
        parameter_name=np.array(["center_x_m", "center_y_m", "radius_m"]),
        extent_m=float(circle[2]),
        extent_std_m=float(np.sqrt(covariance[2, 2])),
    )
