"""Trajectory SLAM on simulated walks past walls and pillars: exactness, robustness, sessions, derivatives."""

import numpy as np
import pytest

from estimation.channel.record import ChannelEstimate
from estimation.laws.contour import predict_circle
from estimation.laws.plane import predict_los
from estimation.laws.wall import predict_walls
from estimation.slam.config import MappingConfig, PathNoise, SnapshotConfig, TrajectoryConfig
from estimation.slam.record import SolveStatus
from estimation.slam.walk.filter import run_filter
from estimation.slam.walk.residuals import PathClass
from estimation.slam.walk.sessions import segment_offsets
from estimation.slam.walk.trajectory import run_trajectory
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle

TX = Pose(np.array([2.25, 2.5, 1.8]), -1.6)
WALLS = np.array([[[0.0, -7.5]], [[0.03, 8.0]], [[1.55, -9.0]]])
PILLARS = np.array([[2.9, -4.4, 0.2], [0.3, -6.3, 0.2], [-3.5, -7.0, 0.25], [5.5, -6.5, 0.2]])
STD = np.array([0.15, np.deg2rad(0.6), np.deg2rad(0.6)])
FIXED = PathNoise(source="fixed", delay_std_ns=0.5, angle_std_deg=0.6)
SNAPSHOT = SnapshotConfig(method="statistical", noise=FIXED)
MAPPING = MappingConfig(noise=FIXED)


def walk(n: int) -> np.ndarray:
    """States [x, y, heading, bias] along an L-shaped walk."""
    s = np.linspace(0, 1, n)
    corner = 0.65
    x = np.where(s < corner, -4.5 + 9 * s / corner, 4.5)
    y = np.where(s < corner, -2.3, -2.3 - 2.5 * (s - corner) / (1 - corner))
    return np.column_stack([x, y, 0.05 * np.sin(9 * s), 10 + np.sin(5 * s)])


def campaign(rng, n=24, *, noise=1.0, clutter=0.3, los_share=0.6, jump_rad=0.0, jump_stop=10):
    """True states and channel estimates; clutter is a share of all paths."""
    truth, estimates = walk(n), []
    for k, state in enumerate(truth):
        paths = [predict_walls(TX, state, wall).value for wall in WALLS]
        paths += [predict_circle(TX, state, pillar).value for pillar in PILLARS]
        kept = [p for p in paths if abs(p[1]) < 1.7]
        direct = predict_los(TX, state)
        ghosts = rng.uniform(
            [direct[0] + 1, -1.5, -np.pi], [direct[0] + 25, 1.5, np.pi], (rng.binomial(9, clutter), 3)
        )
        has_los = rng.random() < los_share
        measured = np.array([*([direct] if has_los else []), *kept, *ghosts])
        measured = measured + noise * rng.normal(size=measured.shape) * STD
        measured[:, 1] -= jump_rad * (k >= jump_stop)
        power = -30.0 - 17 * np.log10(measured[:, 0] - state[3])
        if has_los:
            power[0] += 17.0
        m = len(measured)
        estimates.append(
            ChannelEstimate(
                stop=k,
                delay_s=measured[:, 0] / SPEED_OF_LIGHT_M_S,
                aod_azimuth_rad=measured[:, 1],
                aoa_azimuth_rad=measured[:, 2],
                power_dbm=power,
                beam_loss_db=np.zeros(m),
                snr_db=np.full(m, 20.0),
                covariance=np.zeros((m, 3, 3)),
                is_los=np.arange(m) < has_los,
            )
        )
    return truth, estimates


def position_rmse(poses, truth) -> float:
    return float(np.sqrt(np.mean(np.sum((poses.position_m - truth[:, :2]) ** 2, axis=1))))


def test_noiseless_stops_are_exact_without_a_motion_prior_pulling():
    truth, estimates = campaign(np.random.default_rng(1), noise=0.0, clutter=0.0, los_share=1.0)
    sharp = PathNoise(source="fixed", delay_std_ns=0.001, angle_std_deg=0.001)
    config = TrajectoryConfig(wall_roughness_m=0.0, object_roughness_m=1e-6, use_sessions=False)
    poses, points, details = run_trajectory(
        estimates, TX, SNAPSHOT.model_copy(update={"noise": sharp}), config, MappingConfig(noise=sharp)
    )
    assert position_rmse(poses, truth) < 1e-3
    assert np.all(poses.status == SolveStatus.LOS)
    assert points.is_inlier.mean() > 0.9
    assert details.tx_offset_rad.tolist() == [0.0]


def test_shared_landmarks_and_motion_beat_independent_stops():
    truth, estimates = campaign(np.random.default_rng(3))
    smoothed, _, details = run_trajectory(estimates, TX, SNAPSHOT, TrajectoryConfig(), MAPPING)
    filtered, _ = run_filter(estimates, TX, SNAPSHOT, TrajectoryConfig(), MAPPING)
    rmse = position_rmse(smoothed, truth)
    assert rmse < 0.15
    assert rmse < 0.7 * position_rmse(filtered, truth)
    assert position_rmse(filtered, truth) < 1.0
    assert len(details.walls) + len(details.objects) >= 4
    error = np.column_stack([smoothed.position_m, wrap_angle(smoothed.heading_rad)]) - truth[:, :3]
    nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(smoothed.covariance[:, :3, :3]), error)
    assert 0.3 < np.mean(nees) / 3 < 3.0


def test_a_jump_of_the_tx_heading_is_found_where_it_is():
    jump = np.deg2rad(2.5)
    _, estimates = campaign(np.random.default_rng(5), jump_rad=jump, jump_stop=10)
    _, _, details = run_trajectory(estimates, TX, SNAPSHOT, TrajectoryConfig(), MAPPING)
    first = np.flatnonzero(np.diff(details.session)) + 1
    assert np.abs(first - 10).max() <= 1
    found = details.tx_offset_rad[details.session[-1]] - details.tx_offset_rad[details.session[0]]
    assert found == pytest.approx(jump, abs=np.deg2rad(0.5))
    _, estimates = campaign(np.random.default_rng(6))
    _, _, still = run_trajectory(estimates, TX, SNAPSHOT, TrajectoryConfig(), MAPPING)
    assert len(still.tx_offset_rad) == 1


def test_segments_of_known_receivers_show_the_offsets():
    rng = np.random.default_rng(0)
    offset = np.repeat([-0.04, 0.005], [12, 18])
    value = offset + 0.01 * rng.normal(size=30)
    value[20] = 0.4
    first, mean = segment_offsets(value, np.full(30, 0.01))
    assert np.abs(first - [0, 12]).max() <= 1
    np.testing.assert_allclose(mean, [-0.04, 0.005], atol=0.008)
    assert segment_offsets(0.01 * rng.normal(size=30), np.full(30, 0.01))[0].tolist() == [0]


@pytest.mark.parametrize("n", [1, 2, 3, 100, 129, 700])
def test_segments_of_long_campaigns_jump_at_the_same_stops(n):
    rng = np.random.default_rng(n)
    std = rng.uniform(0.005, 0.02, n)
    jumps = [] if n < 100 else [n // 3, n // 3 + n // 5]
    value = np.searchsorted(jumps, np.arange(n), side="right") * 0.2 + std * rng.normal(size=n)
    first, mean = segment_offsets(value, std)
    assert first.tolist() == [0, *jumps]
    np.testing.assert_allclose(mean, 0.2 * np.arange(len(first)), atol=0.03)


@pytest.mark.slow
def test_no_run_with_thirty_percent_clutter_is_lost():
    for seed in range(20):
        truth, estimates = campaign(np.random.default_rng([7, seed]), clutter=0.4)
        poses, _, _ = run_trajectory(estimates, TX, SNAPSHOT, TrajectoryConfig(), MAPPING)
        assert position_rmse(poses, truth) < 0.5


def test_campaigns_without_a_solved_stop_are_a_status():
    _, estimates = campaign(np.random.default_rng(2), n=3)
    bare = [e.take("path", np.arange(len(e)) < 1) for e in estimates]
    poses, points, details = run_trajectory(bare, TX, SNAPSHOT, TrajectoryConfig(), MAPPING)
    assert np.all(poses.status == SolveStatus.FAILED)
    assert len(points) == 0
    assert len(details.walls) == 0


def test_double_bounces_between_known_walls_become_information():
    truth, estimates = campaign(np.random.default_rng(4), clutter=0.0)
    chain = np.concatenate([WALLS[0], WALLS[1]])
    longer = []
    for state, estimate in zip(truth, estimates, strict=True):
        path = predict_walls(TX, state, chain).value
        delay = np.append(estimate.delay_s, path[0] / SPEED_OF_LIGHT_M_S)
        m = len(delay)
        longer.append(
            ChannelEstimate(
                stop=estimate.stop,
                delay_s=delay,
                aod_azimuth_rad=np.append(estimate.aod_azimuth_rad, path[1]),
                aoa_azimuth_rad=np.append(estimate.aoa_azimuth_rad, path[2]),
                power_dbm=np.append(estimate.power_dbm, -60.0),
                beam_loss_db=np.zeros(m),
                snr_db=np.full(m, 20.0),
                covariance=np.zeros((m, 3, 3)),
                is_los=np.append(estimate.is_los, False),
            )
        )
    last = np.cumsum([len(e) for e in longer]) - 1
    used = {}
    for use in (True, False):
        config = TrajectoryConfig(use_double_bounces=use)
        _, _, details = run_trajectory(longer, TX, SNAPSHOT, config, MAPPING)
        used[use] = np.mean(details.path_kind[last] == PathClass.DOUBLE)
    assert used[True] > 0.5
    assert used[False] == 0.0
