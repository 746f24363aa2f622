"""SLAM over a whole campaign: every stop alone, all stops together, or stop by stop during the walk."""

from collections.abc import Sequence

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.laws.raised import PathHeights
from estimation.slam.config import MappingConfig, SnapshotConfig, TrajectoryConfig
from estimation.slam.influence import stop_influence, with_influence
from estimation.slam.level import KnownHeights, solved_from_above
from estimation.slam.mapped_solutions import collect_and_map
from estimation.slam.record import IncidencePoints, PoseEstimates
from estimation.slam.snapshot.solution import collect_poses
from estimation.slam.snapshot.solve import solve_snapshot
from estimation.slam.space.problem import is_spatial
from estimation.slam.space.snapshot import solve_spatial
from estimation.slam.space.trajectory import run_spatial_trajectory
from estimation.slam.transmitters import AnyTx, Transmitters, of_tx, transmitters_of
from estimation.slam.walk.filter import run_filter
from estimation.slam.walk.trajectory import run_trajectory
from estimation.steps import steps


def locate_and_map(
    estimates: Sequence[ChannelEstimate],
    tx_pose: AnyTx,
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
    poses = transmitters_of(tx_pose).poses
    _refuse_for_several(len(poses), estimates, slam, trajectory)
    if heights is None or slam.method == "reference":
        return _located(estimates, tx_pose, slam, trajectory, mapping)
    ends = heights.of_paths(estimates)
    if not heights.matter(estimates):
        return _located(estimates, tx_pose, slam, trajectory, mapping, ends)
    return solved_from_above(
        estimates,
        heights,
        solve=lambda seen: _located(seen, tx_pose, slam, trajectory, mapping, ends),
        alone=lambda seen, tx: collect_poses([solve_snapshot(each, poses[tx], slam) for each in seen]),
    )


def _refuse_for_several(
    n_tx: int, estimates: Sequence[ChannelEstimate], slam: SnapshotConfig, trajectory: TrajectoryConfig | None
) -> None:
    """`ValueError` where a method that knows one TX only is asked for several."""
    if n_tx == 1:
        return
    if slam.method == "reference":
        raise ValueError("slam.method = 'reference': is of one TX, with several only 'statistical' is allowed")
    if trajectory is not None and trajectory.method == "filter":
        raise ValueError("trajectory.method = 'filter': is of one TX; several need 'smooth', 'single' or 'auto'")
    if is_spatial(estimates, use_elevation=slam.solves_in_space):
        raise ValueError("slam.use_elevation = true: SLAM with several TX works in the plane, false is allowed")


def _located(
    estimates: Sequence[ChannelEstimate],
    tx_pose: AnyTx,
    slam: SnapshotConfig,
    trajectory: TrajectoryConfig | None,
    mapping: MappingConfig,
    ends: Sequence[PathHeights] | None = None,
) -> tuple[PoseEstimates, IncidencePoints]:
    if trajectory is None or trajectory.method == "single":
        return run_slam(estimates, tx_pose, slam, mapping)
    if trajectory.method == "filter":
        return run_filter(estimates, transmitters_of(tx_pose).poses[0], slam, trajectory, mapping)
    spatial = is_spatial(estimates, use_elevation=slam.solves_in_space)
    if spatial:
        first = transmitters_of(tx_pose).poses[0]
        poses, points, _ = run_spatial_trajectory(estimates, first, slam, trajectory, mapping)
    else:
        poses, points, _ = run_trajectory(estimates, tx_pose, slam, trajectory, mapping, ends)
    return poses, points


def published_poses(estimates: Sequence[ChannelEstimate], tx_pose: AnyTx, slam: SnapshotConfig) -> PoseEstimates:
    """Poses by the published algorithm, every stop alone, with fixed noise: what ours are compared with.

    It knows one TX: of several it gets the paths of the first.
    """
    if isinstance(tx_pose, Transmitters):
        estimates, tx_pose = of_tx(estimates, 0), tx_pose.poses[0]
    noise = slam.noise.model_copy(update={"source": "fixed"})
    published = slam.model_copy(update={"method": "reference", "refine": False, "noise": noise})
    return collect_poses([solve_snapshot(estimate, tx_pose, published) for estimate in steps(estimates, "stop")])


def run_slam(
    estimates: Sequence[ChannelEstimate], tx_pose: AnyTx, config: SnapshotConfig, mapping_config: MappingConfig
) -> tuple[PoseEstimates, IncidencePoints]:
    """Solve every stop alone, then map the IPs of the solved stops; in space or in the plane as `locate_and_map`.

    An IP is an inlier where both SLAM and the gate of mapping accept its path as a single bounce. The covariance
    of the state is part of that of the IPs. The influence of paths is that of the statistical method in the plane.
    """
    spatial = is_spatial(estimates, use_elevation=config.solves_in_space)
    if spatial:
        first = transmitters_of(tx_pose).poses[0]
        solutions = [solve_spatial(estimate, first, config) for estimate in steps(estimates, "stop")]
        return collect_and_map(estimates, solutions, tx_pose, mapping_config, spatial=True)
    solutions = [solve_snapshot(estimate, tx_pose, config) for estimate in steps(estimates, "stop")]
    mapped = collect_and_map(estimates, solutions, tx_pose, mapping_config, spatial=False)
    if config.method == "reference":
        return mapped
    pairs = zip(estimates, solutions, strict=True)
    influence_m = [stop_influence(estimate, tx_pose, solution, config) for estimate, solution in pairs]
    return with_influence(*mapped, estimates, np.concatenate([np.zeros(0), *influence_m]))
