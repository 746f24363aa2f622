"""SLAM and mapping in space: the reflection law, exact solutions, and the plane as its special case."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.laws import plane as plane_law
from estimation.laws import space as space_law
from estimation.slam.bounds import StopPaths, stop_bound
from estimation.slam.config import MappingConfig, TrajectoryConfig
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.record import PoseEstimates, SolveStatus
from estimation.slam.snapshot.evidence import log_clutter, power_law, prior_of
from estimation.slam.space.bounds import SpatialPaths, spatial_bound, spatial_information
from estimation.slam.space.hypotheses import bounce_states, los_states
from estimation.slam.space.mapping import map_stops_spatial
from estimation.slam.space.problem import SpatialProblem, is_spatial, spatial_covariance, spatial_problem
from estimation.slam.space.snapshot import refine_spatial, solve_spatial
from estimation.slam.space.trajectory import run_spatial_trajectory
from estimation.slam.stops import locate_and_map, run_slam
from isac_arena.validation.scenarios.halls import ScenarioConfig
from isac_arena.validation.scenarios.stops import channel_estimate, draw_stop, draw_trajectory
from isac_arena.validation.slam import laws, trials
from isac_arena.validation.slam.snapshot import check_space_efficiency
from isac_arena.validation.slam.trials import NOISE
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle

TX = Pose(np.array([1.0, 2.0, 2.6]), 0.4)
EXACT = ScenarioConfig(is_noisy=False, in_space=True)
R = ScenarioConfig(in_space=True).covariance


def made(rng, n=6, height_std=1.0):
    state = np.array([*rng.normal(size=2) * 4, 1.5, rng.uniform(-3, 3), rng.uniform(-5, 12)])
    point = rng.normal(size=(n, 3)) * [6, 6, height_std] + [0, 0, 1.8]
    return state, point


def given_poses(states, stop=0):
    return PoseEstimates(
        stop=np.array([stop]),
        position_m=states[None, :2],
        heading_rad=states[None, 3],
        clock_bias_s=states[None, 4] / SPEED_OF_LIGHT_M_S,
        status=np.array([SolveStatus.GIVEN]),
        n_inliers=np.zeros(1, int),
        cost=np.zeros(1),
        height_m=states[None, 2],
    )


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_equations_vanish_at_the_truth_and_the_start_point_is_the_incidence_point(seed):
    state, point = made(np.random.default_rng(seed))
    measured = space_law.predict_bounce(TX, state, point)
    at = space_law.bounce_equations(TX, state, measured)
    np.testing.assert_allclose(at.value_m, 0, atol=1e-10)
    share = np.linalg.norm(point - TX.position_m, axis=1) / at.length_m
    np.testing.assert_allclose(at.fraction, share, atol=1e-9)
    kept = (share > 0.02) & (share < 0.98)
    start = space_law.start_point(TX, state, measured)
    np.testing.assert_allclose(start[kept], point[kept], atol=1e-8)


def test_derivatives_and_the_plane_pass_their_checks():
    rows = laws.check_space_jacobians(7, True) + laws.check_space_plane(7, True)
    assert all(row.met for row in rows), [(row.key, row.value) for row in rows if not row.met]


@pytest.mark.parametrize("height_std", [0.0, 1.0])
def test_four_bounces_give_the_state_in_the_plane_and_in_space(height_std):
    rng = np.random.default_rng(3)
    for _ in range(30):
        state, point = made(rng, 5, height_std)
        if height_std == 0:
            state[2] = 1.8
        tx = TX if height_std else Pose(np.array([1.0, 2.0, 1.8]), 0.4)
        problem = SpatialProblem(
            tx, space_law.predict_bounce(tx, state, point), np.tile(R, (5, 1, 1)), np.zeros(5)
        )
        found = bounce_states(problem, np.arange(5)) - state
        found[:, 3] = wrap_angle(found[:, 3])
        assert np.abs(found).max(axis=1).min() < 1e-5


def test_line_of_sight_and_one_bounce_give_the_state():
    rng = np.random.default_rng(4)
    for _ in range(30):
        state, point = made(rng, 1)
        measured = np.concatenate(
            [space_law.predict_los(TX, state[None]), space_law.predict_bounce(TX, state, point)]
        )
        problem = SpatialProblem(TX, measured, np.tile(R, (2, 1, 1)), np.zeros(2))
        found = los_states(problem, np.arange(2))[0] - state
        np.testing.assert_allclose([*found[:3], wrap_angle(found[3]), found[4]], 0, atol=1e-7)


@pytest.mark.parametrize("has_los", [True, False])
def test_noiseless_stops_are_exact_with_their_incidence_points(has_los):
    rng = np.random.default_rng(5)
    for _ in range(3):
        scenario = draw_stop(rng, replace(EXACT, has_los=has_los))
        poses, points = run_slam([scenario.estimate], scenario.tx, trials.OURS, trials.MAPPING)
        assert poses.status[0] == (SolveStatus.LOS if has_los else SolveStatus.NLOS)
        np.testing.assert_allclose([*poses.position_m[0], poses.height_m[0]], scenario.state[:3], atol=1e-6)
        truth = scenario.point_m[points.path]
        kept = points.is_inlier & scenario.is_single[points.path]
        assert kept.sum() >= 6
        found = np.column_stack([points.position_m, points.height_m])
        np.testing.assert_allclose(found[kept], truth[kept], atol=1e-5)
        assert np.isfinite(points.height_covariance_m2[kept]).all()


def test_in_the_plane_the_refined_state_is_that_of_horizontal_equations_alone():
    """The noise of the elevations does not change x, y, heading or bias."""
    rng = np.random.default_rng(6)
    tx = Pose(np.array([1.0, 2.0, 1.8]), 0.4)
    state, point = made(rng, 8, 0.0)
    state[2] = 1.8
    measured = space_law.predict_bounce(tx, state, point)
    measured[:, :3] += rng.normal(size=(8, 3)) * [0.05, 0.003, 0.003]
    results = []
    for elevation_std in (np.deg2rad(0.1), np.deg2rad(5.0)):
        covariance = np.tile(np.diag([0.05, 0.003, 0.003, elevation_std, elevation_std]) ** 2, (8, 1, 1))
        problem = SpatialProblem(tx, measured, covariance, np.zeros(8))
        refined, information, _ = refine_spatial(problem, state[None], -1, trials.MATCHED)
        assert refined[0, 2] == pytest.approx(1.8, abs=1e-9)
        results.append(
            (refined[0, [0, 1, 3, 4]], np.linalg.inv(information[0])[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])])
        )
    np.testing.assert_allclose(results[0][0], results[1][0], atol=1e-6)
    np.testing.assert_allclose(results[0][1], results[1][1], rtol=1e-4)


def test_mapping_in_the_plane_is_that_of_the_plane_and_heights_come_with_covariance():
    rng = np.random.default_rng(8)
    state, point = made(rng, 6, 0.0)
    state[2], tx, std = 1.8, Pose(np.array([1.0, 2.0, 1.8]), 0.4), [0.05, 0.003, 0.003, 0, 0]
    measured = space_law.predict_bounce(tx, state, point) + rng.normal(size=(6, 5)) * std
    measured = measured[np.argsort(measured[:, 0])]
    estimate = channel_estimate(0, measured, np.zeros(6), R, np.zeros(6, bool))
    space = map_stops_spatial([estimate], given_poses(state), tx, trials.MAPPING)
    plane = map_stops([estimate], given_poses(state), tx, trials.MAPPING)
    np.testing.assert_allclose(space.position_m, plane.position_m, atol=1e-5)
    np.testing.assert_allclose(space.covariance_m2, plane.covariance_m2, rtol=1e-3, atol=1e-8)
    np.testing.assert_allclose(space.height_m, 1.8, atol=1e-9)
    assert np.all(space.height_covariance_m2[:, 2] > 0)
    assert np.isnan(plane.height_m).all()


def test_a_missing_height_is_named():
    scenario = draw_stop(np.random.default_rng(9), EXACT)
    poses = replace(given_poses(scenario.state), height_m=np.array([np.nan]))
    with pytest.raises(ValueError, match=r"poses\.height_m = nan"):
        map_stops_spatial([scenario.estimate], poses, scenario.tx, MappingConfig())


def test_bounds_are_the_inverse_of_the_joint_information_and_of_the_plane_where_all_is_level():
    rng = np.random.default_rng(10)
    state, point = made(rng, 5)
    covariance = np.tile(R, (5, 1, 1))
    joint = np.zeros((20, 20))
    for index, one in enumerate(point):
        jacobian = np.zeros((5, 20))
        jacobian[:, :5] = space_law.bounce_jacobian_rx(TX, state, one)
        jacobian[:, 5 + 3 * index : 8 + 3 * index] = space_law.bounce_jacobian_point(TX, state, one)
        joint += jacobian.T @ np.linalg.inv(R) @ jacobian
    expected = np.linalg.inv(joint)
    bound, points = spatial_bound(TX, state, SpatialPaths(point, covariance))
    assert bound.position_m == pytest.approx(np.sqrt(np.trace(expected[:3, :3])), rel=1e-6)
    np.testing.assert_allclose(points**2, np.diagonal(expected)[5:].reshape(5, 3).sum(axis=1), rtol=1e-5)
    few, _ = spatial_bound(TX, state, SpatialPaths(point[:2], covariance[:2]))
    assert np.isinf(few.position_m)
    assert (
        np.linalg.matrix_rank(spatial_information(TX, state, SpatialPaths(point[:3], covariance[:3])), tol=1e-6)
        == 5
    )
    level = np.column_stack([point[:, :2], np.full(5, 2.6)])
    state[2] = 2.6
    space, _ = spatial_bound(TX, state, SpatialPaths(level, covariance))
    plane, _ = stop_bound(TX, state[[0, 1, 3, 4]], StopPaths(level[:, :2], covariance[:, :3, :3], np.full(5, -1)))
    assert space.plan_m == pytest.approx(float(plane.position_m), rel=1e-6)
    assert space.clock_m == pytest.approx(float(plane.clock_m), rel=1e-6)


def test_unknown_elevations_are_wide_and_known_ones_keep_their_covariance():
    scenario = draw_stop(np.random.default_rng(11), EXACT)
    estimate = scenario.estimate
    nowhere = np.full(len(estimate), np.nan)
    one_end = replace(estimate, aod_elevation_rad=nowhere)
    problem = spatial_problem(one_end, scenario.tx, NOISE)
    assert np.all(problem.measured[:, 3] == 0) and np.all(problem.covariance[:, 3, 3] > 0.1)
    np.testing.assert_allclose(problem.covariance[:, 4, 4], R[4, 4])
    assert is_spatial([one_end], use_elevation=True) and not is_spatial([one_end], use_elevation=False)
    flat = replace(one_end, aoa_elevation_rad=nowhere)
    assert not is_spatial([flat], use_elevation=True)
    both = np.ones((len(estimate), 2), bool)
    fixed = NOISE.model_copy(update={"source": "fixed"})
    np.testing.assert_allclose(np.sqrt(spatial_covariance(estimate, fixed, both)[:, 3, 3]), np.deg2rad(1.0))
    solved = solve_spatial(one_end, scenario.tx, trials.OURS)
    np.testing.assert_allclose(solved.position_m[:2], scenario.state[:2], atol=0.05)


def test_elevations_in_degrees_are_named():
    scenario = draw_stop(np.random.default_rng(15), EXACT)
    wrong = replace(scenario.estimate, aoa_elevation_rad=np.full(len(scenario.estimate), 12.0))
    with pytest.raises(ValueError, match=r"stop 0: aoa_elevation_rad\[0\] = 12: must be within"):
        solve_spatial(wrong, scenario.tx, trials.OURS)


def test_a_stop_without_enough_paths_is_a_status():
    scenario = draw_stop(np.random.default_rng(12), replace(EXACT, has_los=False, n_paths=3))
    solution = solve_spatial(scenario.estimate, scenario.tx, trials.OURS)
    assert solution.status == SolveStatus.FAILED and np.isnan(solution.position_m).all()
    poses, points = run_slam([scenario.estimate], scenario.tx, trials.OURS, trials.MAPPING)
    assert len(points) == 0 and np.isnan(poses.height_m).all()


def test_clutter_alone_is_no_solution_in_space():
    """Random paths of which one has elevations: every mode explains them better than clutter."""
    rng, config = np.random.default_rng(7), trials.OURS
    law, prior = power_law(config.path_loss), prior_of(config)
    solved = 0
    for _ in range(60):
        scenario = draw_stop(rng, replace(EXACT, n_paths=5))
        n = len(scenario.estimate)
        elevation = np.where(np.arange(n) == 0, rng.uniform(-0.5, 0.5, n), np.nan)
        clutter = replace(
            scenario.estimate,
            delay_s=np.sort(rng.uniform(5.0, 30.0, n)) / SPEED_OF_LIGHT_M_S,
            power_dbm=rng.normal(-45.0, 4.0, n),
            aod_azimuth_rad=rng.uniform(-1.5, 1.5, n),
            aoa_azimuth_rad=rng.uniform(-np.pi, np.pi, n),
            aod_elevation_rad=elevation,
            aoa_elevation_rad=elevation,
        )
        solution = solve_spatial(clutter, scenario.tx, config)
        solved += solution.status != SolveStatus.FAILED
        range_m = clutter.delay_s * SPEED_OF_LIGHT_M_S
        alone = log_clutter(range_m, clutter.power_dbm + clutter.beam_loss_db, law, prior)
        assert np.all(solution.mode_log_evidence > alone)
    assert solved <= 12


@pytest.mark.parametrize("trajectory", [None, TrajectoryConfig(), TrajectoryConfig(method="filter")])
def test_the_published_algorithm_stays_in_the_plane(trajectory):
    """With `method` "reference", elevations change nothing: states are those of `use_elevation` off."""
    walk = draw_trajectory(np.random.default_rng(13), ScenarioConfig(n_paths=9, in_space=True), 5)
    estimates, tx = [scenario.estimate for scenario in walk], walk[0].tx
    published = trials.OURS.model_copy(update={"method": "reference"})
    planar = published.model_copy(update={"use_elevation": False})
    (found, points), (expected, _) = (
        locate_and_map(estimates, tx, config, trajectory, trials.MAPPING) for config in (published, planar)
    )
    np.testing.assert_array_equal(found.position_m, expected.position_m)
    np.testing.assert_array_equal(found.cost, expected.cost)
    assert not np.isfinite(found.height_m).any() and not np.isfinite(points.height_m).any()
    assert np.isfinite(locate_and_map(estimates, tx, trials.OURS, trajectory, trials.MAPPING)[0].height_m).any()


def test_a_walk_in_space_shares_landmarks_and_finds_heights():
    walk = draw_trajectory(
        np.random.default_rng(13), ScenarioConfig(n_paths=9, outlier_share=0.2, in_space=True), 12
    )
    estimates = [scenario.estimate for scenario in walk]
    poses, points, details = run_spatial_trajectory(
        estimates, walk[0].tx, trials.OURS, TrajectoryConfig(), trials.MAPPING
    )
    truth = np.array([scenario.state[:3] for scenario in walk])
    assert np.sqrt(np.mean(np.sum((poses.position_m - truth[:, :2]) ** 2, axis=1))) < 0.3
    assert np.sqrt(np.mean((poses.height_m - truth[:, 2]) ** 2)) < 0.2
    assert len(details.walls) + len(details.objects) >= 1
    assert np.isfinite(points.height_m[points.is_inlier]).all()
    nees = ((poses.height_m - truth[:, 2]) / poses.height_std_m) ** 2
    assert 0.1 < np.mean(nees) < 5


@pytest.mark.slow
def test_the_solver_in_space_is_efficient_and_consistent():
    rows = check_space_efficiency(1, False)
    assert all(row.met for row in rows), [(row.key, row.value) for row in rows if not row.met]


def test_in_plane_predictions_agree_with_the_geometry_of_the_plane():
    rng = np.random.default_rng(14)
    tx = Pose(np.array([0.5, -1.0, 1.8]), -0.7)
    state = np.array([3.0, 2.0, 1.8, 0.6, 4.0])
    point = np.column_stack([rng.normal(size=(9, 2)) * 5, np.full(9, 1.8)])
    expected = plane_law.predict_bounce(tx, state[[0, 1, 3, 4]], point[:, :2])
    np.testing.assert_allclose(space_law.predict_bounce(tx, state, point)[:, :3], expected, atol=1e-12)
