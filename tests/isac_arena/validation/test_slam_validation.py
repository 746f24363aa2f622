"""The Monte Carlo scenarios obey the law of reflection; the checks measure what they say."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from estimation.laws.plane import measurement_vectors, predict_bounce, predict_los, residual
from estimation.slam.snapshot.problem import snapshot_problem
from estimation.slam.snapshot.reference import solve_reference
from isac_arena.validation.benches import slam as bench_slam
from isac_arena.validation.scenarios.halls import ScenarioConfig, bounce_points, double_bounces, draw_hall
from isac_arena.validation.scenarios.stops import draw_stop, draw_trajectory
from isac_arena.validation.slam import measured as slam_measured

EXACT = ScenarioConfig(outlier_share=0.4, is_noisy=False)


def measured(scenario):
    e = scenario.estimate
    return measurement_vectors(e.delay_s, e.aod_azimuth_rad, e.aoa_azimuth_rad)


def test_single_bounces_and_line_of_sight_are_exact_and_outliers_are_as_many_as_asked():
    rng = np.random.default_rng(1)
    for _ in range(20):
        scenario = draw_stop(rng, EXACT)
        single = scenario.is_single
        assert (single.sum(), (~single & ~scenario.is_los).sum()) == (6, 4)
        predicted = predict_bounce(scenario.tx, scenario.state, scenario.point_m[single])
        assert_allclose(residual(measured(scenario)[single], predicted), 0, atol=1e-9)
        los = predict_los(scenario.tx, scenario.state)
        assert_allclose(residual(measured(scenario)[scenario.is_los], los[None]), 0, atol=1e-9)
        assert np.all(np.diff(scenario.estimate.delay_s) >= 0)


def test_bounce_points_are_where_the_path_is_stationary():
    rng = np.random.default_rng(2)
    hall = draw_hall(rng, EXACT)
    tx, rx = hall.tx.position_m[:2], 0.4 * hall.size_m
    points, landmark = bounce_points(hall, rx)

    def length(point):
        return np.hypot(*(point - tx).T) + np.hypot(*(point - rx).T)

    for point, index in zip(points, landmark, strict=True):
        step = 1e-4
        if index < 4:
            along = np.eye(2)[1 if index < 2 else 0]
            assert np.min(np.abs(np.concatenate([point, point - hall.size_m]))) < 1e-9
            ahead, behind = point + step * along, point - step * along
        else:
            arm = point - hall.pillar_m[index - 4]
            assert np.hypot(*arm) == pytest.approx(hall.radius_m)
            turn = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in (step, -step)]
            ahead, behind = (hall.pillar_m[index - 4] + rotation @ arm for rotation in turn)
        assert abs(length(ahead) - length(behind)) / (2 * step) < 1e-6


def test_double_bounces_meet_both_walls():
    hall = draw_hall(np.random.default_rng(3), EXACT)
    state = np.array([*(0.4 * hall.size_m), 0.7, 3.0])
    rows = double_bounces(hall, state)
    walls = [(0, 0.0), (0, hall.size_m[0]), (1, 0.0), (1, hall.size_m[1])]
    pairs = [(a, b) for a in walls for b in walls if a != b]
    for row, (first, second) in zip(rows, pairs, strict=True):
        azimuth = hall.tx.heading_rad + row[1]
        place, way, left = (
            hall.tx.position_m[:2].copy(),
            np.array([np.cos(azimuth), np.sin(azimuth)]),
            row[0] - 3.0,
        )
        for axis, level in (first, second):
            leg = (level - place[axis]) / way[axis]
            place, left = place + leg * way, left - leg
            way[axis] *= -1
        assert_allclose(place + left * way, state[:2], atol=1e-9)
        arrival = state[2] + row[2]
        assert_allclose(-way, [np.cos(arrival), np.sin(arrival)], atol=1e-9)


def test_walks_share_their_hall_and_repeat_bit_for_bit():
    first, second = (draw_trajectory(np.random.default_rng(4), EXACT, 12) for _ in range(2))
    assert_array_equal([s.state for s in first], [s.state for s in second])
    assert_array_equal(first[5].estimate.delay_s, second[5].estimate.delay_s)
    steps = np.hypot(*np.diff([s.state[:2] for s in first], axis=0).T)
    assert np.all(steps <= 0.51)
    assert sum(not s.is_los.any() for s in first) == 4


def test_plain_grid_is_the_reference_mode():
    rng = np.random.default_rng(5)
    for _ in range(2):
        scenario = draw_stop(rng, replace(EXACT, n_paths=7, has_los=False, is_noisy=True))
        problem = snapshot_problem(scenario.estimate, scenario.tx, bench_slam.NOISE)
        fit = solve_reference(problem, bench_slam.REFERENCE, False)
        assert_allclose(bench_slam.plain_grid(problem, bench_slam.REFERENCE), fit.state, atol=1e-7)


def test_without_the_measured_data_every_row_is_unmet_and_says_why(tmp_path, monkeypatch):
    monkeypatch.setenv("ARENA_DATA", str(tmp_path))
    checks = [f for name, f in vars(slam_measured).items() if name.startswith("check_")]
    rows = [row for check in checks for row in check(1, True)]
    assert len(rows) == 22
    assert all(np.isnan(row.value) and not row.met and "is not in" in row.reason for row in rows)


def test_distance_to_a_plan_of_segments():
    segments = np.array([[0.0, 0.0, 2.0, 0.0], [5.0, 5.0, 5.0, 5.0]])
    points = np.array([[1.0, 0.5], [-3.0, 4.0], [5.0, 4.0]])
    assert_allclose(slam_measured.plan_distance_m(segments, points), [0.5, 5.0, 1.0])


def test_the_ratio_of_thirds_held_out_is_one_for_equal_errors_and_names_the_worst_third():
    assert slam_measured.held_out_ratio(np.full(30, 0.2)) == pytest.approx(1)
    error = np.ones(30)
    error[1::3] = 2.0
    assert slam_measured.held_out_ratio(error) == pytest.approx(2)
    assert np.isinf(slam_measured.held_out_ratio(np.append(error, np.inf)))  # an unsolved stop meets no bar
