"""Mapping in space: the incidence point (IP) of every non-LOS path, with its height, for known RX states."""

from collections.abc import Sequence

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.laws import space as space_law
from estimation.slam.config import MappingConfig
from estimation.slam.mapping.incidence_points import ObservedPaths, concatenate_stops, map_paths, path_flags
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.slam.space.problem import spatial_problem
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, FloatArray

_TO_METRES = np.array([1.0, 1.0, 1.0, 1.0, SPEED_OF_LIGHT_M_S])


def map_stops_spatial(
    estimates: Sequence[ChannelEstimate],
    poses: PoseEstimates,
    tx_pose: Pose,
    config: MappingConfig,
    *,
    is_los: Sequence[BoolArray] | None = None,
    is_inlier: Sequence[BoolArray] | None = None,
    state_covariance: Sequence[FloatArray] | None = None,
) -> IncidencePoints:
    """IPs with heights of all non-LOS paths at RX states of known height, without FAILED stops.

    As `estimation.slam.mapping.incidence_points.map_stops`, with elevations: five measurements of three
    unknowns, so that J at the minimum has 2 degrees of freedom. `state_covariance` (5, 5) per stop is that of
    [x, y, z, heading, bias] in (m, m, m, rad, s).

    Raises `ValueError` where `poses` does not hold the stops of `estimates` in their order, or a solved stop has
    no height.
    """
    solved = poses.status != SolveStatus.FAILED
    if not np.isfinite(poses.height_m[solved]).all():
        raise ValueError("poses.height_m = nan: mapping in space needs the height of every solved stop")
    problems = [spatial_problem(estimate, tx_pose, config.noise) for estimate in estimates]
    seen = ObservedPaths(
        concatenate_stops([p.measured for p in problems], float, (5,)),
        concatenate_stops([p.covariance for p in problems], float, (5, 5)),
        *path_flags(estimates, is_los, is_inlier),
    )
    bias_m = SPEED_OF_LIGHT_M_S * poses.clock_bias_s
    state = np.column_stack([poses.position_m, poses.height_m, poses.heading_rad, bias_m])
    joint = None
    if state_covariance is not None:
        joint = np.reshape(state_covariance, (-1, 5, 5)) * np.outer(_TO_METRES, _TO_METRES)
    mapped = map_paths(space_law, estimates, poses, tx_pose, config, seen, state, joint)
    return IncidencePoints(
        stop=poses.stop[mapped.row],
        path=mapped.path,
        position_m=mapped.point_m[:, :2],
        covariance_m2=mapped.covariance[:, :2, :2],
        cost=mapped.cost,
        is_inlier=mapped.is_inlier,
        height_m=mapped.point_m[:, 2],
        height_covariance_m2=mapped.covariance[:, 2],
    )
