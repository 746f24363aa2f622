"""From solved stops to results: their poses in one record, and the incidence points of their paths."""

from collections.abc import Sequence

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.config import MappingConfig
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.record import IncidencePoints, PoseEstimates
from estimation.slam.snapshot.solution import SnapshotSolution, collect_poses
from estimation.slam.space.mapping import map_stops_spatial
from estimation.slam.transmitters import AnyTx, map_each_tx


def collect_and_map(
    estimates: Sequence[ChannelEstimate],
    solutions: Sequence[SnapshotSolution],
    tx_pose: AnyTx,
    config: MappingConfig,
    *,
    spatial: bool,
) -> tuple[PoseEstimates, IncidencePoints]:
    """Poses of all stops and IPs of the solved ones, whose covariances include that of the pose."""
    poses = collect_poses(solutions)
    points = map_each_tx(
        map_stops_spatial if spatial else map_stops,
        estimates,
        poses,
        tx_pose,
        config,
        is_los=[solution.is_los for solution in solutions],
        is_inlier=[solution.is_inlier for solution in solutions],
        state_covariance=[np.nan_to_num(solution.covariance) for solution in solutions],
    )
    return poses, points
