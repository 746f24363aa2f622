"""SLAM over a campaign: covariances, modes and flags of the poses of every method, in the plane and in space."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.slam.config import Consider, TrajectoryConfig
from estimation.slam.record import SolveStatus
from estimation.slam.snapshot.problem import Fit
from estimation.slam.snapshot.solve import solve_snapshot
from estimation.slam.space.snapshot import solve_spatial
from estimation.slam.stops import locate_and_map, run_slam
from estimation.slam.walk.filter import advance_hypotheses, run_filter
from estimation.slam.walk.modes import rival_modes
from isac_arena.validation.scenarios.halls import ScenarioConfig
from isac_arena.validation.scenarios.stops import draw_stop, draw_trajectory
from isac_arena.validation.slam.trials import MAPPING, OURS
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle

METHODS = [None, TrajectoryConfig(), TrajectoryConfig(method="filter")]


def pose_error(poses, truth: np.ndarray) -> np.ndarray:
    """Errors (stop, 4) in (m, m, rad, s) against states (stop, 4) in (m, m, rad, m)."""
    bias_s = truth[:, 3] / SPEED_OF_LIGHT_M_S
    error = np.column_stack([poses.position_m, poses.heading_rad, poses.clock_bias_s])
    error -= np.column_stack([truth[:, :3], bias_s])
    error[:, 2] = wrap_angle(error[:, 2])
    return error


@pytest.mark.parametrize("trajectory", METHODS, ids=["alone", "smooth", "filter"])
def test_covariances_of_the_poses_match_their_errors(trajectory):
    nees = []
    for seed in range(2):
        walk = draw_trajectory(np.random.default_rng([seed, 5]), ScenarioConfig(n_paths=9), 16)
        estimates = [scenario.estimate for scenario in walk]
        poses, _ = locate_and_map(estimates, walk[0].tx, OURS, trajectory, MAPPING)
        error = pose_error(poses, np.array([scenario.state for scenario in walk]))
        solved = poses.status != SolveStatus.FAILED
        solved &= ~poses.is_ambiguous
        inverse = np.linalg.inv(poses.covariance[solved])
        nees.append(np.einsum("ni,nij,nj->n", error[solved], inverse, error[solved]))
        assert np.all((poses.los_probability[solved] >= 0) & (poses.los_probability[solved] <= 1))
        expected = np.sqrt(poses.covariance[:, 0, 0] + poses.covariance[:, 1, 1])
        assert np.all(poses.position_std_m[solved] >= expected[solved] * (1 - 1e-12))
    # 3.36 is the median of chi-square with 4 degrees of freedom.
    assert 0.5 * 3.36 < np.median(np.concatenate(nees)) < 2 * 3.36


def test_poses_of_single_stops_contain_their_modes():
    rng = np.random.default_rng(3)
    cluttered = ScenarioConfig(outlier_share=0.5, has_los=False)
    stops = [draw_stop(rng, cluttered, stop) for stop in range(6)]
    for stop in stops:
        solution = solve_snapshot(stop.estimate, stop.tx, OURS)
        poses, _ = run_slam([stop.estimate], stop.tx, OURS, MAPPING)
        np.testing.assert_array_equal(poses.covariance[0], solution.covariance)
        assert bool(poses.is_ambiguous[0]) == solution.is_ambiguous
        if len(solution.mode_state) > 1:
            np.testing.assert_array_equal(poses.alternative[0], solution.mode_state[1])
            assert poses.evidence_gap[0] == pytest.approx(-np.diff(solution.mode_log_evidence)[0])
        else:
            assert np.isnan(poses.alternative).all()


def test_set_up_errors_widen_the_covariance_of_every_method():
    consider = Consider(pointing_std_deg=1.0, survey_std_m=0.2, heading_std_deg=1.0)
    walk = draw_trajectory(np.random.default_rng(1), ScenarioConfig(n_paths=9), 6)
    estimates, tx = [scenario.estimate for scenario in walk], walk[0].tx
    for trajectory in METHODS:
        exact, _ = locate_and_map(estimates, tx, OURS, trajectory, MAPPING)
        wide, _ = locate_and_map(
            estimates, tx, OURS.model_copy(update={"consider": consider}), trajectory, MAPPING
        )
        scale = np.append(np.ones(3), 1 / SPEED_OF_LIGHT_M_S)
        added = consider.covariance(exact.position_m - tx.position_m[:2]) * np.outer(scale, scale)
        np.testing.assert_allclose(wide.covariance - exact.covariance, added, atol=1e-12)


def test_in_space_the_height_has_a_covariance_with_the_rest():
    walk = draw_trajectory(np.random.default_rng(2), ScenarioConfig(n_paths=10, in_space=True), 6)
    estimates, tx = [scenario.estimate for scenario in walk], walk[0].tx
    alone = [solve_spatial(estimate, tx, OURS) for estimate in estimates]
    for trajectory in METHODS:
        poses, points = locate_and_map(estimates, tx, OURS, trajectory, MAPPING)
        assert np.abs(poses.height_m - 1.5).max() < 0.5
        assert np.isfinite(points.height_m).all()
        whole = np.zeros((len(walk), 5, 5))
        whole[:, :4, :4] = poses.covariance
        whole[:, 4, :4] = whole[:, :4, 4] = poses.height_covariance
        whole[:, 4, 4] = poses.height_std_m**2
        assert np.linalg.eigvalsh(whole * 1e6).min() > -1e-6
        if trajectory is None:
            np.testing.assert_array_equal(poses.covariance[0, 2, 3], alone[0].covariance[3, 4])
            np.testing.assert_array_equal(poses.height_covariance[0, 0], alone[0].covariance[2, 0])


def mode(x: float, cost: float, *, is_los: bool = False) -> Fit:
    flags = np.array([is_los, False])
    return Fit(np.array([x, 0.0, 0.0, 0.0]), flags, flags, cost, 0.01 * np.eye(4))


def test_neighbours_weight_the_modes_of_a_stop():
    modes = [[mode(0, 0.0)], [mode(4.0, 0.0), mode(1.0, 0.5, is_los=True)], [mode(2.0, 0.0)]]
    config = TrajectoryConfig(spacing_m=1.0)
    rivals = rival_modes(modes, np.array([0, 1, 0]), config)
    assert rivals.gap[1] > 0.5
    assert np.isnan(rivals.gap[[0, 2]]).all()
    assert rivals.state[1, 0] == 4.0
    assert rivals.los_probability[1] > 0.6
    assert rivals.los_probability[[0, 2]].tolist() == [0.0, 0.0]
    wrong = rival_modes(modes, np.array([0, 0, 0]), config)
    assert wrong.gap[1] == pytest.approx(-rivals.gap[1])


def test_the_filter_predicts_stops_without_a_mode():
    config = TrajectoryConfig()
    hypotheses = []
    for x in (0.0, 0.5, 1.0, 1.5):
        hypotheses = advance_hypotheses(hypotheses, [mode(x, -20.0)], config)
    best = advance_hypotheses(hypotheses, [], config)[0]
    assert best.mode is None
    assert best.mean[0] == pytest.approx(2.0, abs=0.1)
    walk = draw_trajectory(np.random.default_rng(4), ScenarioConfig(n_paths=9), 8)
    estimates = [scenario.estimate for scenario in walk]
    estimates[5] = replace(estimates[5].take("path", np.arange(len(estimates[5])) < 1), stop=5)
    poses, points = run_filter(estimates, walk[0].tx, OURS, config, MAPPING)
    assert poses.status[5] == SolveStatus.FAILED
    assert np.hypot(*(poses.position_m[5] - walk[5].state[:2])) < 0.5
    assert 5 not in points.stop
