"""SLAM over a whole campaign: every stop alone, all stops together, or stop by stop during the walk."""

from collections.abc import Sequence

from estimation.channel.record import ChannelEstimate
from estimation.slam.config import MappingConfig, SnapshotConfig, TrajectoryConfig
from estimation.slam.level import KnownHeights, solved_from_above
from estimation.slam.mapped_solutions import collect_and_map
from estimation.slam.record import IncidencePoints, PoseEstimates
from estimation.slam.snapshot.solution import collect_poses
from estimation.slam.snapshot.solve import solve_snapshot
from estimation.slam.space.problem import is_spatial
from estimation.slam.space.snapshot import solve_spatial
from estimation.slam.space.trajectory import run_spatial_trajectory
from estimation.slam.walk.filter import run_filter
from estimation.slam.walk.trajectory import run_trajectory
from scenes.pose import Pose


def locate_and_map(
    estimates: Sequence[ChannelEstimate],
    tx_pose: Pose,
    slam: SnapshotConfig,
    trajectory: TrajectoryConfig | None,
    mapping: MappingConfig,
    heights: KnownHeights | None = None,
) -> tuple[PoseEstimates, IncidencePoints]:
    """Poses and incidence points: every stop alone without `trajectory`, else by `trajectory.method`.

    `auto` is `smooth` here: whether the stops follow one another is not known here.

    In space where elevations were estimated and `slam.use_elevation` is true, else in the plane, with paths seen
    from above where `heights` are known. With `slam.method` "reference", the published algorithm, in the plane and
    without heights.
    """
    if heights is None or slam.method == "reference" or not heights.matter(estimates):
        return _located(estimates, tx_pose, slam, trajectory, mapping)
    return solved_from_above(
        estimates,
        heights,
        solve=lambda seen: _located(seen, tx_pose, slam, trajectory, mapping),
        alone=lambda seen: collect_poses([solve_snapshot(estimate, tx_pose, slam) for estimate in seen]),
    )


def _located(
    estimates: Sequence[ChannelEstimate],
    tx_pose: Pose,
    slam: SnapshotConfig,
    trajectory: TrajectoryConfig | None,
    mapping: MappingConfig,
) -> tuple[PoseEstimates, IncidencePoints]:
    if trajectory is None or trajectory.method == "single":
        return run_slam(estimates, tx_pose, slam, mapping)
    if trajectory.method == "filter":
        return run_filter(estimates, tx_pose, slam, trajectory, mapping)
    spatial = is_spatial(estimates, use_elevation=slam.solves_in_space)
    smooth = run_spatial_trajectory if spatial else run_trajectory
    poses, points, _ = smooth(estimates, tx_pose, slam, trajectory, mapping)
    return poses, points


def published_poses(estimates: Sequence[ChannelEstimate], tx_pose: Pose, slam: SnapshotConfig) -> PoseEstimates:
    """Poses by the published algorithm, every stop alone, with fixed noise: what ours are compared with."""
    noise = slam.noise.model_copy(update={"source": "fixed"})
    published = slam.model_copy(update={"method": "reference", "refine": False, "noise": noise})
    return collect_poses([solve_snapshot(estimate, tx_pose, published) for estimate in estimates])


def run_slam(
    estimates: Sequence[ChannelEstimate], tx_pose: Pose, config: SnapshotConfig, mapping_config: MappingConfig
) -> tuple[PoseEstimates, IncidencePoints]:
    """Solve every stop alone, then map the IPs of the solved stops; in space or in the plane as `locate_and_map`.

    An IP is an inlier where both SLAM and the gate of mapping accept its path as a single bounce. The covariance
    of the state is part of that of the IPs.
    """
    spatial = is_spatial(estimates, use_elevation=config.solves_in_space)
    solve = solve_spatial if spatial else solve_snapshot
    solutions = [solve(estimate, tx_pose, config) for estimate in estimates]
    return collect_and_map(estimates, solutions, tx_pose, mapping_config, spatial=spatial)
