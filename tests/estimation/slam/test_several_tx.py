"""Several TX in mapping and SLAM: one pose, a clock per TX, walls and objects shared."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.record import AngleKind
from estimation.laws.plane import range_covariance
from estimation.shape.reflection.reflections import Reflections, prior_states
from estimation.slam.config import SnapshotConfig, TrajectoryConfig
from estimation.slam.record import PoseEstimates, SolveStatus
from estimation.slam.stops import locate_and_map, run_slam
from estimation.slam.transmitters import joined_paths, transmitters_of
from estimation.slam.walk.trajectory import run_trajectory
from isac_arena.validation.multistatic.drawn import SharedStop, draw_shared_stop, draw_shared_walk
from isac_arena.validation.slam.trials import CLEAN, GAUSSIAN, MAPPING, OURS
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle

EXACT = replace(CLEAN, is_noisy=False, n_pillars=6)
ALONE = TrajectoryConfig(method="single")


def state_errors(poses: PoseEstimates, stops: list[SharedStop]) -> np.ndarray:
    found = np.column_stack([poses.position_m, poses.heading_rad, SPEED_OF_LIGHT_M_S * poses.tx_clock_bias_s])
    error = found - np.array([stop.state for stop in stops])
    error[:, 2] = wrap_angle(error[:, 2])
    return error


@pytest.mark.parametrize("n_tx", [2, 3])
@pytest.mark.parametrize("has_los", [True, False])
def test_exact_paths_give_the_exact_state_and_the_exact_points(n_tx: int, has_los: bool) -> None:
    tx, stop = draw_shared_stop(np.random.default_rng(n_tx), replace(EXACT, has_los=has_los), n_tx)
    poses, points = run_slam([stop.estimate], tx, OURS, MAPPING)
    assert poses.status[0] == (SolveStatus.LOS if has_los else SolveStatus.NLOS)
    np.testing.assert_allclose(state_errors(poses, [stop]), 0, atol=1e-4)
    truth = np.concatenate([part.point_m for part in stop.parts])
    single = np.concatenate([part.is_single for part in stop.parts])[points.path]
    np.testing.assert_allclose(points.position_m[single], truth[points.path][single], atol=1e-3)
    np.testing.assert_array_equal(points.tx, stop.estimate.tx[points.path])
    assert poses.covariance.shape == (1, 3 + n_tx, 3 + n_tx)


def test_a_walk_gives_the_exact_states_and_shares_walls() -> None:
    tx, stops = draw_shared_walk(np.random.default_rng(3), EXACT, 12, 2)
    poses, _, details = run_trajectory([stop.estimate for stop in stops], tx, OURS, TrajectoryConfig(), MAPPING)
    np.testing.assert_allclose(state_errors(poses, stops), 0, atol=0.01)  # the motion prior moves them by mm
    assert len(details.walls) >= 3 and details.tx_offset_rad.shape == (2,)
    np.testing.assert_allclose(details.tx_offset_rad, 0, atol=1e-3)


def test_the_mounting_offset_of_every_tx_is_found() -> None:
    """With one TX a common offset turns everything about it; two known places show the offset of each."""
    tx, stops = draw_shared_walk(np.random.default_rng(4), EXACT, 12, 2)
    offset = np.deg2rad([0.8, -0.5])
    turned = [
        replace(one, aod_azimuth_rad=one.aod_azimuth_rad - offset[one.tx]) for one in (s.estimate for s in stops)
    ]
    poses, _, details = run_trajectory(turned, tx, OURS, TrajectoryConfig(), MAPPING)
    np.testing.assert_allclose(details.tx_offset_rad, offset, atol=2e-3)
    assert np.abs(state_errors(poses, stops)[:, :2]).max() < 0.05


def test_synchronised_clocks_help_a_tx_of_few_paths() -> None:
    """One path of the second TX tells nothing while its clock is free."""
    tx, stop = draw_shared_stop(np.random.default_rng(5), GAUSSIAN, 2)
    few = stop.estimate.take("path", [*np.flatnonzero(stop.estimate.tx == 0).tolist(), len(stop.estimate) - 1])
    common = stop.state.copy()
    common[4] = common[3]
    shift_s = (common[4] - stop.state[4]) / SPEED_OF_LIGHT_M_S
    synchronised = replace(few, delay_s=few.delay_s + shift_s * (few.tx == 1))
    free, _ = run_slam([few], tx, OURS, MAPPING)
    tied, _ = run_slam([synchronised], replace(tx, sync_std_s=1e-10), OURS, MAPPING)
    gap_s = tied.tx_clock_bias_s[0, 1] - tied.tx_clock_bias_s[0, 0]
    assert abs(gap_s) < 1e-9
    assert np.trace(tied.covariance[0, :2, :2]) < np.trace(free.covariance[0, :2, :2])


def test_paths_keep_their_tx_and_must_show_the_same_angles() -> None:
    _, stop = draw_shared_stop(np.random.default_rng(6), EXACT, 2)
    first, second = (part.estimate for part in stop.parts)
    joined = joined_paths([first, second])
    assert joined.tx.tolist() == len(first) * [0] + len(second) * [1]
    assert joined_paths([first]) is first
    with pytest.raises(ValueError, match="beams of all TX must observe the same angles"):
        joined_paths([first, replace(second, aod_angle_kind=AngleKind.CONE)])


@pytest.mark.parametrize(
    ("slam", "trajectory", "message"),
    [
        (SnapshotConfig(method="reference"), ALONE, "slam.method = 'reference': is of one TX"),
        (OURS, TrajectoryConfig(method="filter"), "trajectory.method = 'filter': is of one TX"),
    ],
)
def test_methods_of_one_tx_are_refused(slam: SnapshotConfig, trajectory: TrajectoryConfig, message: str) -> None:
    tx, stop = draw_shared_stop(np.random.default_rng(7), EXACT, 2)
    with pytest.raises(ValueError, match=message):
        locate_and_map([stop.estimate], tx, slam, trajectory, MAPPING)


def test_the_pose_of_a_stop_counts_once_in_the_prior_of_contours() -> None:
    """Two TX at a stop: the joint prior has the pose information of one, and each clock given the pose."""
    rng = np.random.default_rng(8)
    tx, stop = draw_shared_stop(rng, GAUSSIAN, 2)
    root = rng.standard_normal((5, 5))
    joint = root @ root.T + 5 * np.eye(5)
    # Clocks are independent given the pose, as with free clocks.
    joint[3, 4] = joint[4, 3] = joint[3, :3] @ np.linalg.solve(joint[:3, :3], joint[:3, 4])
    at = [np.ix_([0, 1, 2, 3 + k], [0, 1, 2, 3 + k]) for k in range(2)]
    parts = [
        Reflections(
            measured=np.zeros((1, 3)),
            covariance=range_covariance(part.estimate.plane_covariance[:1]),
            tx=transmitters_of(tx).rows[k : k + 1],
            rx_state=stop.state[None, [0, 1, 2, 3 + k]],
            rx_covariance=joint[at[k]][None],
            session=np.zeros(1, int),
            stop=np.zeros(1, int),
            clock=np.full(1, k),
        )
        for k, part in enumerate(stop.parts)
    ]
    _, state, weight = prior_states(parts)
    np.testing.assert_allclose(state[0], stop.state)
    np.testing.assert_allclose(np.linalg.inv(weight[0]), joint, rtol=1e-6, atol=1e-6)


def test_a_tx_with_its_line_of_sight_alone_places_the_receiver() -> None:
    """Its two directions count, though one path alone is no snapshot."""
    tx, stop = draw_shared_stop(np.random.default_rng(8), GAUSSIAN, 2)
    estimate = stop.estimate
    kept = np.flatnonzero((estimate.tx == 0) | estimate.is_los)
    alone = np.flatnonzero(estimate.tx == 0)
    assert len(kept) == len(alone) + 1
    both, _ = run_slam([estimate.take("path", kept)], tx, OURS, MAPPING)
    one, _ = run_slam([estimate.take("path", alone)], tx, OURS, MAPPING)
    assert np.trace(both.covariance[0, :2, :2]) < 0.9 * np.trace(one.covariance[0, :2, :2])
    assert np.hypot(*state_errors(both, [stop])[0, :2]) < 0.2
