"""Cramer-Rao bounds in space: receiver state and incidence points (IPs) of one stop with elevations.

As `estimation.slam.bounds`, with states [x, y, z, heading, bias] in m, m, m, rad, m and the measurements of
`estimation.geometry_spatial`. Where devices and IPs lie in one horizontal plane, what the plane's bounds say of
x, y, heading and bias holds unchanged: elevations then inform the height alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.geometry_spatial import bounce_jacobian_point, bounce_jacobian_rx, los_jacobian_rx
from estimation.slam.bounds import state_covariance
from estimation.slam.spatial_mapping import spatial_point_covariance
from scenes.pose import Pose
from scenes.record import FloatArray


@dataclass(frozen=True)
class SpatialBound:
    """Bounds on the standard deviation of every unbiased estimate; infinite where the paths leave it free."""

    position_m: float  # root of the summed variances of x, y and z: the PEB
    plan_m: float  # of x and y
    height_m: float
    heading_rad: float
    clock_m: float


@dataclass(frozen=True)
class SpatialPaths:
    """The paths of one stop that say something of its receiver."""

    point_m: FloatArray  # (path, xyz) IPs of the single bounces
    covariance: FloatArray  # (path, 5, 5) in (m, rad, ...)^2
    los_covariance: FloatArray | None = None  # (5, 5); None without a line of sight


def spatial_information(tx: Pose, state: FloatArray, paths: SpatialPaths) -> FloatArray:
    """Fisher information (5, 5) of one receiver state (5,), the IPs marginalised."""
    information = np.zeros((5, 5))
    if len(paths.point_m):
        weight = np.linalg.inv(paths.covariance)
        by_rx = bounce_jacobian_rx(tx, state, paths.point_m)
        by_point = bounce_jacobian_point(tx, state, paths.point_m)
        cross = np.swapaxes(by_rx, 1, 2) @ weight @ by_point
        own = np.swapaxes(by_point, 1, 2) @ weight @ by_point
        lost = cross @ np.linalg.pinv(own, hermitian=True) @ np.swapaxes(cross, 1, 2)
        information += (np.swapaxes(by_rx, 1, 2) @ weight @ by_rx - lost).sum(axis=0)
    if paths.los_covariance is not None:
        by_rx = los_jacobian_rx(tx, state)
        information += by_rx.T @ np.linalg.inv(paths.los_covariance) @ by_rx
    return information


def spatial_bound(tx: Pose, state: FloatArray, paths: SpatialPaths) -> tuple[SpatialBound, FloatArray]:
    """Bounds of one stop: of its receiver state, and (path,) in m of the position of each IP."""
    covariance = state_covariance(spatial_information(tx, state, paths))
    variance = np.diagonal(covariance)
    bound = SpatialBound(
        position_m=float(np.sqrt(variance[:3].sum())),
        plan_m=float(np.sqrt(variance[:2].sum())),
        height_m=float(np.sqrt(variance[2])),
        heading_rad=float(np.sqrt(variance[3])),
        clock_m=float(np.sqrt(variance[4])),
    )
    if not len(paths.point_m):
        return bound, np.zeros(0)
    if not np.isfinite(covariance).all():
        return bound, np.full(len(paths.point_m), np.inf)
    rows = np.tile(state, (len(paths.point_m), 1))
    conditional, sensitivity = spatial_point_covariance(tx, rows, paths.point_m, paths.covariance)
    joint = conditional + sensitivity @ covariance @ np.swapaxes(sensitivity, 1, 2)
    return bound, np.sqrt(np.einsum("nii->n", joint))
