"""Mapping: the incidence point (IP) of every non-LOS path for known RX states, equations (2) to (4)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.channel.record import ChannelEstimate
from estimation.distributions import chi_square_quantile
from estimation.laws import plane as plane_law
from estimation.slam.config import MappingConfig
from estimation.slam.mapping.point_fit import ReflectionLaw, fit_points, joint_covariance, point_covariance
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, FloatArray, IntArray

_MIN_LEG_M = 0.2  # a closer IP would be on the device itself
_TO_METRES = np.array([1.0, 1.0, 1.0, SPEED_OF_LIGHT_M_S])


@dataclass(frozen=True)
class ObservedPaths:
    """All paths of all stops, in the order of the estimates, in the units of a reflection law."""

    measured: FloatArray  # (path, m)
    covariance: FloatArray  # (path, m, m)
    is_los: BoolArray  # (path,)
    is_inlier: BoolArray  # (path,)


@dataclass(frozen=True)
class MappedPaths:
    """IPs of all paths except lines of sight, at the solved stops."""

    row: IntArray  # (ip,) row of the stop
    path: IntArray  # (ip,) index of the path in its stop
    point_m: FloatArray  # (ip, point)
    covariance: FloatArray  # (ip, point, point)
    cost: FloatArray  # (ip,)
    is_inlier: BoolArray  # (ip,)


def map_stops(
    estimates: Sequence[ChannelEstimate],
    poses: PoseEstimates,
    tx_pose: Pose,
    config: MappingConfig,
    *,
    is_los: Sequence[BoolArray] | None = None,
    is_inlier: Sequence[BoolArray] | None = None,
    state_covariance: Sequence[FloatArray] | None = None,
) -> IncidencePoints:
    """IPs of all non-LOS paths at given RX states, without stops of status FAILED.

    Parameters
    ----------
    estimates
        Channel estimates, one per row of `poses`.
    is_los
        Per stop (path,): the line of sight; by default that of the channel estimate.
    is_inlier
        Per stop (path,): single bounces by SLAM. An inlier of the result must also pass the gate of `config`.
    state_covariance
        Per stop (4, 4) of [x, y, heading, bias] in (m, m, rad, s): adds the uncertainty of the RX state to the
        IP's covariance, as in the joint estimate. By default the states are exact.

    Raises `ValueError` where `poses` does not hold the stops of `estimates` in their order.
    """
    measured = [plane_law.measurement_vectors(e.delay_s, e.aod_azimuth_rad, e.aoa_azimuth_rad) for e in estimates]
    seen = ObservedPaths(
        concatenate_stops(measured, float, (3,)),
        concatenate_stops([config.noise.covariance(e) for e in estimates], float, (3, 3)),
        *path_flags(estimates, is_los, is_inlier),
    )
    bias_m = SPEED_OF_LIGHT_M_S * poses.clock_bias_s
    state = np.column_stack([poses.position_m, poses.heading_rad, bias_m])
    joint = None
    if state_covariance is not None:
        joint = np.reshape(state_covariance, (-1, 4, 4)) * np.outer(_TO_METRES, _TO_METRES)
    mapped = map_paths(plane_law, estimates, poses, tx_pose, config, seen, state, joint)
    return IncidencePoints(
        stop=poses.stop[mapped.row],
        path=mapped.path,
        position_m=mapped.point_m,
        covariance_m2=mapped.covariance,
        cost=mapped.cost,
        is_inlier=mapped.is_inlier,
    )


def map_paths(
    law: ReflectionLaw[Pose],
    estimates: Sequence[ChannelEstimate],
    poses: PoseEstimates,
    tx_pose: Pose,
    config: MappingConfig,
    seen: ObservedPaths,
    state: FloatArray,
    state_covariance: FloatArray | None,
) -> MappedPaths:
    """IPs in the plane or in space at states (stop, state), with covariances (stop, state, state) or None.

    An inlier is one in `seen` that also passes the gate of `config`.

    Raises `ValueError` where `poses` does not hold the stops of `estimates` in their order.
    """
    if [estimate.stop for estimate in estimates] != poses.stop.tolist():
        raise ValueError(f"poses.stop = {poses.stop.tolist()}: must equal the stops of the channel estimates")
    row = np.repeat(np.arange(len(estimates)), [len(estimate) for estimate in estimates])
    use = ~seen.is_los & (poses.status[row] != SolveStatus.FAILED)
    row, measured, path_covariance = row[use], seen.measured[use], seen.covariance[use]
    point, cost = fit_points(law, tx_pose, state[row], measured, path_covariance)
    conditional, sensitivity = point_covariance(law, tx_pose, state[row], point, path_covariance)
    covariance = conditional
    if state_covariance is not None:
        covariance = joint_covariance(conditional, sensitivity, state_covariance[row])
    freedom = measured.shape[-1] - point.shape[-1]
    passed = cost <= chi_square_quantile(config.gate_probability, freedom)
    passed &= _is_possible(tx_pose, state[row], point, conditional, config)
    path = concatenate_stops([np.arange(len(e)) for e in estimates], int, ())[use]
    return MappedPaths(row, path, point, covariance, cost, seen.is_inlier[use] & passed)


def path_flags(
    estimates: Sequence[ChannelEstimate], is_los: Sequence[BoolArray] | None, is_inlier: Sequence[BoolArray] | None
) -> tuple[BoolArray, BoolArray]:
    """Flags (path,) of all paths; by default the lines of sight of the estimates, and all paths as inliers."""
    los = [e.is_los for e in estimates] if is_los is None else is_los
    inlier = [np.ones(len(e), bool) for e in estimates] if is_inlier is None else is_inlier
    return concatenate_stops(los, bool, ()), concatenate_stops(inlier, bool, ())


def _is_possible(
    tx_pose: Pose, state: FloatArray, point: FloatArray, covariance: FloatArray, config: MappingConfig
) -> BoolArray:
    """Whether IPs are off both devices and certain enough in plan; heights may be uncertain."""
    axes = point.shape[-1]
    legs = [np.linalg.norm(point - end, axis=1) for end in (tx_pose.position_m[:axes], state[:, :axes])]
    largest = np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1]
    return np.asarray((np.minimum(*legs) >= _MIN_LEG_M) & (largest <= config.max_position_std_m**2))


def concatenate_stops(parts: Sequence[NDArray[Any]], dtype: type, shape: tuple[int, ...]) -> NDArray[Any]:
    """Concatenate per-stop arrays along the path axis; an empty sequence gives no paths."""
    return np.concatenate([np.empty((0, *shape), dtype), *parts]).astype(dtype)
