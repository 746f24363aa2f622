"""Bounds against brute force, closed forms and finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimation.laws.plane import (
    bounce_jacobian_point,
    bounce_jacobian_rx,
    los_jacobian_rx,
    predict_bounce,
    residual,
)
from estimation.laws.wall import predict_walls, wall_line
from estimation.slam.bounds import (
    StopPaths,
    state_bound,
    state_covariance,
    stop_bound,
    stop_information,
    trajectory_covariance,
)
from isac_arena.validation.scenarios.halls import ScenarioConfig
from isac_arena.validation.scenarios.stops import draw_stop, draw_trajectory

CONFIG = ScenarioConfig(n_paths=6)
R = CONFIG.covariance


def paths_of(scenario, walls=False, los=True):
    single = scenario.is_single
    wall = np.where(walls & (scenario.landmark < 4), scenario.landmark, -1)[single]
    has_los = los and scenario.is_los.any()
    n = int(single.sum())
    return StopPaths(scenario.point_m[single], np.tile(R, (n, 1, 1)), wall, R if has_los else None)


@pytest.mark.parametrize("has_los", [True, False])
def test_stop_bound_is_the_inverse_of_the_joint_information(has_los):
    scenario = draw_stop(np.random.default_rng(3), replace(CONFIG, has_los=has_los))
    paths = paths_of(scenario)
    n, tx, state = len(paths.point_m), scenario.tx, scenario.state
    joint = np.zeros((4 + 2 * n, 4 + 2 * n))
    for index, point in enumerate(paths.point_m):
        jacobian = np.zeros((3, 4 + 2 * n))
        jacobian[:, :4] = bounce_jacobian_rx(tx, state, point)
        jacobian[:, 4 + 2 * index : 6 + 2 * index] = bounce_jacobian_point(tx, state, point)
        joint += jacobian.T @ np.linalg.inv(R) @ jacobian
    if has_los:
        jacobian = los_jacobian_rx(tx, state)
        joint[:4, :4] += jacobian.T @ np.linalg.inv(R) @ jacobian
    covariance = np.linalg.inv(joint)
    bound, points = stop_bound(tx, state, paths)
    assert_allclose(bound.position_m, np.sqrt(covariance[0, 0] + covariance[1, 1]), rtol=1e-6)
    assert_allclose(bound.heading_rad, np.sqrt(covariance[2, 2]), rtol=1e-6)
    assert_allclose(bound.clock_m, np.sqrt(covariance[3, 3]), rtol=1e-6)
    variance = np.diagonal(covariance)[4:].reshape(-1, 2).sum(axis=1)
    assert_allclose(points, np.sqrt(variance), rtol=1e-5)


def test_three_single_bounces_do_not_bound_a_state_and_a_fourth_does():
    scenario = draw_stop(np.random.default_rng(5), replace(CONFIG, n_paths=4, has_los=False))
    paths = paths_of(scenario)
    few = StopPaths(paths.point_m[:3], paths.covariance[:3], paths.wall[:3])
    assert np.isinf(stop_bound(scenario.tx, scenario.state, few)[0].position_m)
    assert np.isfinite(stop_bound(scenario.tx, scenario.state, paths)[0].position_m)
    nothing = StopPaths(np.zeros((0, 2)), np.zeros((0, 3, 3)), np.zeros(0, int))
    assert np.isinf(stop_bound(scenario.tx, scenario.state, nothing)[0].clock_m)


def test_line_of_sight_and_one_bounce_bound_all_four_unknowns():
    scenario = draw_stop(np.random.default_rng(6), replace(CONFIG, n_paths=1))
    assert np.isfinite(stop_bound(scenario.tx, scenario.state, paths_of(scenario))[0].position_m)
    information = stop_information(scenario.tx, scenario.state, paths_of(scenario))
    assert np.linalg.matrix_rank(information, tol=1e-9 * np.linalg.norm(information)) == 4


def test_the_wall_of_a_specular_point_mirrors_its_path():
    rng = np.random.default_rng(7)
    for _ in range(20):
        scenario = draw_stop(rng, replace(CONFIG, n_paths=14))
        point = scenario.point_m[scenario.is_single & (scenario.landmark < 4)]
        line = wall_line(scenario.tx, scenario.state, point)
        states = np.tile(scenario.state, (len(point), 1))
        predicted = predict_walls(scenario.tx, states, line[:, None]).value
        assert_allclose(residual(predict_bounce(scenario.tx, states, point), predicted), 0, atol=1e-9)


def test_a_walk_without_prior_or_walls_has_the_bounds_of_its_stops_and_both_lower_them():
    scenarios = draw_trajectory(np.random.default_rng(9), replace(CONFIG, n_paths=9), 12)
    tx, states = scenarios[0].tx, np.array([scenario.state for scenario in scenarios])
    alone = trajectory_covariance(tx, states, [paths_of(s) for s in scenarios], None)
    for scenario, covariance in zip(scenarios, alone, strict=True):
        expected = state_covariance(stop_information(tx, scenario.state, paths_of(scenario)))
        assert_allclose(covariance, expected, rtol=1e-5, atol=1e-12)
    shared = trajectory_covariance(tx, states, [paths_of(s, walls=True) for s in scenarios], None)
    both = trajectory_covariance(tx, states, [paths_of(s, walls=True) for s in scenarios], 0.1)
    peb = [state_bound(covariance).position_m for covariance in (alone, shared, both)]
    assert np.all(peb[1] <= peb[0] * (1 + 1e-6)) and np.all(peb[2] <= peb[1] * (1 + 1e-6))
    assert np.median(peb[2]) < 0.8 * np.median(peb[0])
