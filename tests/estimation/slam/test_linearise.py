"""The compiled residuals against their plain form, their derivatives against finite differences, and the normal
equations against dense products."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.laws import plane
from estimation.laws.contour import predict_circle
from estimation.laws.wall import predict_walls, wall_places
from estimation.slam.config import TrajectoryConfig
from estimation.slam.walk.assignment import assign_to_landmarks
from estimation.slam.walk.linearise import linearise
from estimation.slam.walk.motion import add_motion, course_of, motion_cost
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState
from estimation.slam.walk.smoother import normal_equations, robust_cost
from scenes.pose import Pose
from tests.estimation.slam import residual_oracle as plain

TX = Pose(np.array([2.25, 2.5, 1.8]), -1.6)
WALLS = np.array([[0.03, 8.0], [1.55, -9.0], [0.1, -7.5]])
OBJECTS = np.array([[2.9, -4.4, 0.2], [0.3, -6.3, 0.35]])
CONFIG = TrajectoryConfig()


def campaign(rng, n=8, paths=6):
    """Paths of every kind near their predictions, and unknowns near the truth."""
    m = n * paths
    kind = rng.permutation(np.arange(m) % 6)
    landmark = np.stack([rng.integers(0, 2, m), rng.integers(0, 2, m)], axis=1)
    landmark[:, 1] = np.where(landmark[:, 0] == landmark[:, 1], 2, landmark[:, 1])
    state = np.column_stack(
        [np.linspace(-4, 4, n), -2.3 + 0.1 * rng.normal(size=n), rng.normal(size=n), 8 + rng.normal(size=n)]
    )
    factor = rng.normal(size=(m, 3, 3)) * np.array([0.2, 0.01, 0.01])[:, None]
    seen = Observations(
        TX,
        n,
        np.repeat(np.arange(n), paths),
        np.column_stack([rng.uniform(15, 30, m), rng.uniform(-1.2, 1.2, m), rng.uniform(-3, 3, m)]),
        factor @ np.swapaxes(factor, 1, 2) + np.diag([0.01, 1e-4, 1e-4]),
        np.zeros((3, 3)),
    )
    now = TrajectoryState(
        state, np.array([0.0, 0.03]), WALLS, OBJECTS, np.repeat([0, 1], n // 2), 0, course_of(state)
    )
    return seen, Association(kind, landmark), now


def test_walls_and_circles_are_those_of_the_plain_form():
    rng = np.random.default_rng(1)
    state = rng.normal(size=(40, 4)) * [4, 4, 1, 5]
    walls = np.stack([rng.uniform(-3, 3, (40, 3)), rng.uniform(6, 12, (40, 3))], axis=-1)
    circle = np.column_stack([rng.normal(size=(40, 2)) * 8, rng.uniform(0.05, 0.6, 40)])
    pairs = [
        (predict_walls(TX, state, walls[:, :b]), plain.predict_walls(TX, state, walls[:, :b])) for b in (1, 2, 3)
    ]
    pairs.append((predict_circle(TX, state, circle), plain.predict_circle(TX, state, circle)))
    for ours, expected in pairs:
        for name in ("value", "by_state", "by_landmark"):
            np.testing.assert_allclose(getattr(ours, name), getattr(expected, name), rtol=1e-9, atol=1e-11)
    point = plain.wall_point(TX, state[:, :2], walls[:, 0])
    along = -np.sin(walls[:, 0, 0]) * point[:, 0] + np.cos(walls[:, 0, 0]) * point[:, 1]
    np.testing.assert_allclose(wall_places(walls[:, 0], TX, state[:, :2])[0], along, rtol=1e-9, atol=1e-11)


def test_points_and_lines_of_sight_are_those_of_the_plain_form():
    rng = np.random.default_rng(5)
    state, point = rng.normal(size=(40, 4)) * [4, 4, 1, 5], rng.normal(size=(40, 2)) * 6
    for name in ("predict_bounce", "bounce_jacobian_point", "bounce_jacobian_rx"):
        ours, expected = getattr(plane, name)(TX, state, point), getattr(plain, name)(TX, state, point)
        np.testing.assert_allclose(ours, expected, rtol=1e-12, atol=1e-13)
    for name in ("predict_los", "los_jacobian_rx"):
        ours, expected = getattr(plane, name)(TX, state), getattr(plain, name)(TX, state)
        np.testing.assert_allclose(ours, expected, rtol=1e-12, atol=1e-13)


def test_residuals_are_those_of_the_plain_form():
    seen, link, now = campaign(np.random.default_rng(2))
    ours = linearise(seen, link, now, CONFIG)
    met = np.zeros(len(seen.row), bool)
    for block in plain.residual_blocks(seen, link, now, CONFIG):
        d, p = block.value.shape[1], block.shared.shape[1]
        met[block.path] = True
        np.testing.assert_array_equal(ours.size[block.path], d)
        np.testing.assert_array_equal(ours.shared[block.path, :p], block.shared)
        np.testing.assert_array_equal(ours.shared[block.path, p:], -1)
        for name, part in (("value", np.s_[:, :d]), ("by_state", np.s_[:, :d]), ("by_shared", np.s_[:, :d, :p])):
            mine = getattr(ours, name)[block.path]
            np.testing.assert_allclose(mine[part], getattr(block, name), rtol=1e-8, atol=1e-9)
            assert np.count_nonzero(mine) == np.count_nonzero(mine[part])
    np.testing.assert_array_equal(ours.size[~met], 0)
    assert np.count_nonzero(~met) == np.count_nonzero(link.kind == PathClass.UNUSED)


def test_derivatives_of_all_residuals_match_finite_differences():
    seen, link, now = campaign(np.random.default_rng(3))
    config = TrajectoryConfig(wall_roughness_m=0.0, object_roughness_m=0.0)
    # The standard deviation of a bounce depends on the state, but the re-weighted problem keeps it fixed.
    link = replace(link, kind=np.where(link.kind == PathClass.BOUNCE, PathClass.LOS, link.kind))
    at, step = linearise(seen, link, now, config), 1e-6
    for axis in range(4):
        move = step * np.eye(4)[axis]
        ahead, behind = (linearise(seen, link, replace(now, state=now.state + s * move), config) for s in (1, -1))
        difference = (ahead.value - behind.value) / (2 * step)
        np.testing.assert_allclose(at.by_state[..., axis], difference, rtol=1e-5, atol=1e-4)
    for column in range(now.n_shared):
        shared, none = step * np.eye(now.n_shared)[column], np.zeros_like(now.state)
        ahead, behind = (linearise(seen, link, now.moved(none, s * shared), config) for s in (1, -1))
        expected = np.einsum("pdi,pi->pd", at.by_shared, (at.shared == column).astype(float))
        np.testing.assert_allclose(expected, (ahead.value - behind.value) / (2 * step), rtol=1e-5, atol=1e-4)


def test_normal_equations_are_the_sums_of_the_residuals_products():
    seen, link, now = campaign(np.random.default_rng(4))
    system, residuals = normal_equations(seen, link, now, CONFIG), linearise(seen, link, now, CONFIG)
    n, m = len(now.state), now.n_shared
    dense, gradient = np.zeros((4 * n + m, 4 * n + m)), np.zeros(4 * n + m)
    weight = residuals.weight(CONFIG.degrees_of_freedom)
    for i in range(len(seen.row)):
        row = np.zeros((3, 4 * n + m))
        row[:, 4 * seen.row[i] : 4 * seen.row[i] + 4] = residuals.by_state[i]
        used = residuals.shared[i] >= 0
        row[:, 4 * n + residuals.shared[i, used]] = residuals.by_shared[i][:, used]
        dense += weight[i] * row.T @ row
        gradient += weight[i] * row.T @ residuals.value[i]
    keep = np.arange(m) != now.anchor
    expected = dense[: 4 * n, 4 * n :].reshape(n, 4, m)[..., keep]
    np.testing.assert_allclose(system.border[..., keep], expected, rtol=1e-9, atol=1e-9)
    off = ~np.eye(m, dtype=bool) & keep & keep[:, None]
    np.testing.assert_allclose(system.corner[off], dense[4 * n :, 4 * n :][off], rtol=1e-9, atol=1e-9)
    walls = slice(2, 2 + now.walls.size)
    np.testing.assert_allclose(system.shared_gradient[walls], gradient[4 * n :][walls], rtol=1e-9, atol=1e-9)


def test_motion_prior_is_the_derivative_of_its_cost():
    rng = np.random.default_rng(5)
    state = np.column_stack([np.linspace(0, 4, 7), rng.normal(size=(7, 3))])
    course = course_of(state)
    diagonal, gradient = np.zeros((7, 4, 4)), np.zeros((7, 4))
    next1, next2 = add_motion(state, course, CONFIG, diagonal, gradient)
    step = 1e-6
    for k in range(7):
        for axis in range(4):
            move = np.zeros_like(state)
            move[k, axis] = step
            slope = (motion_cost(state + move, course, CONFIG) - motion_cost(state - move, course, CONFIG)) / (
                2 * step
            )
            assert gradient[k, axis] == pytest.approx(slope, rel=1e-5, abs=1e-5)
    # Around an even, straight walk every weight is the same, and the blocks are the exact second derivative.
    even = np.column_stack([np.linspace(0, 4, 7), np.zeros((7, 3))])
    diagonal, gradient = np.zeros((7, 4, 4)), np.zeros((7, 4))
    next1, next2 = add_motion(even, course_of(even), CONFIG, diagonal, gradient)
    difference = np.diff(np.eye(7), 2, axis=0)
    freedom = CONFIG.motion_degrees_of_freedom
    expected = (freedom + 2) / freedom * difference.T @ difference / CONFIG.cross_track_std_m**2
    np.testing.assert_allclose(diagonal[:, 1, 1], np.diag(expected), rtol=1e-9)
    np.testing.assert_allclose(next1[:, 1, 1], np.diag(expected, 1), rtol=1e-9)
    np.testing.assert_allclose(next2[:, 1, 1], np.diag(expected, 2), rtol=1e-9)


def test_paths_go_to_the_landmark_of_smallest_distance():
    """Against the distance to every landmark written out; the delay bound must not lose any."""
    rng = np.random.default_rng(6)
    seen, _, now = campaign(rng, n=20, paths=9)
    m = len(seen.row)
    exact = [predict_walls(TX, now.state, np.broadcast_to(w, (20, 1, 2))).value for w in WALLS]
    exact += [predict_circle(TX, now.state, c).value for c in OBJECTS]
    measured = np.stack(exact, axis=1)[np.arange(20)[:, None], rng.integers(0, 5, (20, 9))].reshape(m, 3)
    measured = measured + rng.normal(size=(m, 3)) * [0.3, 0.02, 0.02]
    measured[:, 1] -= now.offset_rad[now.session[seen.row]]
    seen = replace(seen, measured=measured, covariance=np.tile(np.diag([0.3, 0.02, 0.02]) ** 2, (m, 1, 1)))
    link = Association(np.zeros(m, int), np.full((m, 2), -1))
    found = assign_to_landmarks(seen, now, link, np.tile([-50.0, 50.0], (3, 1)), CONFIG)
    everything = [(PathClass.WALL, (w, -1)) for w in range(3)] + [(PathClass.OBJECT, (o, -1)) for o in range(2)]
    distance = []
    for kind, index in everything:
        as_kind = Association(np.full(m, kind), np.tile(index, (m, 1)))
        block = plain.residual_blocks(seen, as_kind, now, CONFIG)[0]
        distance.append(np.sum(block.value**2, axis=1))
    best = np.argmin(distance, axis=0)
    inside = np.min(distance, axis=0) < 14.16  # the 0.997 quantile of 3 degrees of freedom
    expected = np.array([[kind, index[0]] for kind, index in everything])[best]
    np.testing.assert_array_equal(found.kind[inside], expected[inside, 0])
    np.testing.assert_array_equal(found.landmark[inside, 0], expected[inside, 1])
    assert inside.sum() > 100
    assert np.all(np.isin(found.kind[~inside], [PathClass.UNUSED, PathClass.DOUBLE]))


def test_cost_is_student_t_over_paths_plus_the_priors():
    seen, link, now = campaign(np.random.default_rng(7))
    freedom = CONFIG.degrees_of_freedom
    total = motion_cost(now.state, now.course, CONFIG)
    for block in plain.residual_blocks(seen, link, now, CONFIG):
        square = np.sum(block.value**2, axis=1)
        total += np.sum((freedom + block.value.shape[1]) / 2 * np.log1p(square / freedom))
    total += 0.5 * np.sum(((now.objects[:, 2] - CONFIG.object_radius_m) / CONFIG.object_radius_std_m) ** 2)
    total += 0.5 * np.sum((now.offset_rad / CONFIG.offset_std_rad) ** 2)
    assert robust_cost(seen, link, now, CONFIG) == pytest.approx(total, rel=1e-9)
