"""Cramer-Rao bounds in space: receiver state and incidence points (IPs) of one stop with elevations.

As `estimation.slam.bounds`, with states [x, y, z, heading, bias] in m, m, m, rad, m and the measurements of
`estimation.laws.space`. Where devices and IPs are in one horizontal plane, the bounds of x, y, heading and bias
are those of the plane: elevations then inform the height only.
"""

from dataclasses import dataclass

import numpy as np

from estimation.laws import space as space_law
from estimation.slam.bounds import state_covariance
from estimation.slam.mapping.point_fit import point_bound, state_information
from scenes.pose import Pose
from scenes.record import FloatArray


@dataclass(frozen=True)
class SpatialBound:
    """Bounds on the standard deviation of unbiased estimates; infinite where unobservable."""

    position_m: float  # root of the summed variances of x, y and z: the PEB
    plan_m: float  # of x and y
    height_m: float
    heading_rad: float
    clock_m: float


@dataclass(frozen=True)
class SpatialPaths:
    """The paths of one stop that are informative of its receiver."""

    point_m: FloatArray  # (path, xyz) IPs of the single bounces
    covariance: FloatArray  # (path, 5, 5) in (m, rad, ...)^2
    los_covariance: FloatArray | None = None  # (5, 5); None without a line of sight


def spatial_information(tx: Pose, state: FloatArray, paths: SpatialPaths) -> FloatArray:
    """Fisher information (5, 5) of one receiver state (5,), the IPs marginalised."""
    covariance, los_covariance = paths.covariance, paths.los_covariance
    return state_information(space_law, tx, state, paths.point_m, covariance, los_covariance)


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
    return bound, point_bound(space_law, tx, state, paths.point_m, paths.covariance, covariance)
