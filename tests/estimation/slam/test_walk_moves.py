"""Stops that landmarks move, what known neighbours say of a stop, walls of two planes, and sides of walls."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.laws.plane import predict_bounce, predict_los
from estimation.laws.wall import predict_walls
from estimation.slam.config import TrajectoryConfig
from estimation.slam.walk.agreement import sight_states
from estimation.slam.walk.association import reclassify_paths
from estimation.slam.walk.linearise import linearise
from estimation.slam.walk.motion import course_of, motion_cost
from estimation.slam.walk.neighbours import between_known, motion_about, neighbour_states
from estimation.slam.walk.planes import split_walls
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState
from estimation.slam.walk.smoother import minimise_robust_cost
from scenes.pose import Pose, wrap_angle

TX = Pose(np.array([1.0, 2.0, 1.5]), 0.3)
CONFIG = TrajectoryConfig()
STD = np.array([0.005, 0.001, 0.001])
NO_OFFSET = np.zeros(1)


def straight(n):
    return np.column_stack([np.linspace(3, 8, n), np.linspace(1, 0, n), np.full(n, 0.4), np.full(n, 5.0)])


def trajectory(state, walls):
    session = np.zeros(len(state), dtype=np.int64)
    return TrajectoryState(state, NO_OFFSET, walls, np.empty((0, 3)), session, 0, course_of(state))


def seen_paths(row, measured):
    covariance = np.tile(np.diag(STD**2), (len(row), 1, 1))
    return Observations(TX, int(row.max()) + 1, row, np.array(measured), covariance, np.zeros((3, 3)))


def test_unknown_stops_lie_between_known_ones_and_headings_go_the_short_way():
    state = straight(5)
    state[:, 2] = [3.0, 9.0, 3.2, -9.0, 3.4 - 2 * np.pi]
    state[[1, 3]] += 50.0
    is_known = np.array([True, False, True, False, True])
    filled = between_known(state, is_known)
    np.testing.assert_allclose(filled[:, :2], straight(5)[:, :2])
    np.testing.assert_allclose(filled[:, 2], [3.0, 3.1, 3.2, 3.3, 3.4])
    assert between_known(state, np.zeros(5, bool)) is state


def test_motion_about_a_stop_is_that_of_the_known_ones_only():
    state = straight(7)
    is_known = np.ones(7, bool)
    candidates = state[[3]] + np.array([[0.0] * 4, [0.5, 0.4, 0.0, 0.0], [0.0, 0.0, 0.8, 0.0]])
    whole = motion_about(state, is_known, 3, candidates, CONFIG)
    for cost, candidate in zip(whole, candidates, strict=True):
        walk = np.concatenate([state[1:3], candidate[None], state[4:6]])
        assert cost == pytest.approx(motion_cost(walk, course_of(walk), CONFIG))
    is_known[4] = False
    lost = state.copy()
    lost[4] += [9.0, -9.0, 1.0, 4.0]
    np.testing.assert_array_equal(
        motion_about(lost, is_known, 3, candidates, CONFIG), motion_about(state, is_known, 3, candidates, CONFIG)
    )


@pytest.mark.parametrize(("stop", "expected"), [(0, [1, 1]), (2, [1, 3]), (3, [2, 2])])
def test_neighbours_of_a_stop_and_the_place_between_them(stop, expected):
    state = straight(4)
    near = neighbour_states(state, stop)
    np.testing.assert_allclose(near[:2], state[expected])
    np.testing.assert_allclose(near[2], state[expected].mean(axis=0))
    assert not len(neighbour_states(state[:1], 0))


def test_a_path_through_a_wall_is_no_bounce_off_it():
    """The RX behind the wall: its image predicts a path all the same."""
    walls = np.array([[np.pi / 2, 9.0], [0.0, 5.5]])
    state = straight(6)  # the last stops are behind the second wall
    spans = np.array([[-50.0, 50.0]] * 2)
    row = np.repeat(np.arange(6), 3)
    chains = [(0,), (1,), (1, 0)]
    measured = [predict_walls(TX, one, walls[list(chain)]).value for one in state for chain in chains]
    link = reclassify_paths(seen_paths(row, measured), trajectory(state, walls), np.zeros(18, bool), spans, CONFIG)
    kind = link.kind.reshape(6, 3)
    is_behind = state[:, 0] > 5.5
    assert np.all(kind[:, 0] == PathClass.WALL)
    assert np.array_equal(kind[:, 1] == PathClass.WALL, ~is_behind)
    assert np.array_equal(kind[:, 2] == PathClass.DOUBLE, ~is_behind)


@pytest.mark.parametrize("window_m", [0.0, 0.04])
def test_a_window_before_its_wall_gets_a_plane_of_its_own(window_m):
    """Bounces between 3 and 5 m along the wall are off a window; without one the wall stays one."""
    rng = np.random.default_rng(5)
    wall, side, state = np.array([np.pi / 2, 9.0]), np.array([0.0, 14.0]), straight(16)
    at = (state[:, 0] * 7.0 + 9.0 - state[:, 1]) / (16.0 - state[:, 1])  # of the bounce off the wall
    is_window = (at > 3.0) & (at < 5.0)
    assert 4 <= is_window.sum() <= 10
    measured = []
    for one, is_front in zip(state, is_window, strict=True):
        front = wall - [0.0, window_m * is_front]
        paths = [predict_los(TX, one), *(predict_walls(TX, one, each[None]).value for each in (front, side))]
        measured += [path + STD * rng.normal(size=3) for path in paths]
    seen = seen_paths(np.repeat(np.arange(16), 3), measured)
    kind = np.tile([PathClass.LOS, PathClass.WALL, PathClass.WALL], 16).astype(np.int64)
    link = Association(kind, np.column_stack([np.tile([-1, 0, 1], 16), np.full(48, -1)]))
    quiet = CONFIG.model_copy(update={"wall_roughness_m": 0.001})
    now = minimise_robust_cost(seen, link, trajectory(state, np.array([wall, side])), quiet)
    start, split = split_walls(seen, link, now, quiet)
    if not window_m:
        assert len(start.walls) == 2
        return
    assert len(start.walls) == 3
    assert np.array_equal(split.landmark[1::3, 0] == 2, is_window)
    two = minimise_robust_cost(seen, split, start, quiet)
    assert two.walls[0, 1] - two.walls[2, 1] == pytest.approx(window_m, abs=0.01)


def test_a_walk_without_walls_is_split_nowhere():
    now = trajectory(straight(3), np.empty((0, 2)))
    seen = seen_paths(np.arange(3), np.zeros((3, 3)))
    link = Association(np.full(3, PathClass.UNUSED), np.full((3, 2), -1))
    start, same = split_walls(seen, link, now, CONFIG)
    assert len(start.walls) == 0
    assert np.array_equal(same.landmark, link.landmark)


@pytest.mark.parametrize("is_behind", [False, True])
def test_a_line_of_sight_and_one_bounce_show_the_stop_in_front_and_behind(is_behind):
    """A flat array reports the departure from behind as its mirror image."""
    state = straight(3) * [-1 if is_behind else 1, 1, 1, 1]
    los = predict_los(TX, state[1])
    if is_behind:
        los[1] = np.pi - los[1]
    bounce = predict_bounce(TX, state[1], np.array([4.0, 6.0]))
    own = seen_paths(np.zeros(2, int), [bounce, los])
    around = trajectory(state + np.array([0.2, -0.1, 0.3, 1.0]), np.empty((0, 2)))
    found = sight_states(own, around, 1, 4.0)
    off = found - state[1]
    off[:, 2] = wrap_angle(off[:, 2])
    assert np.abs(off).max(axis=1).min() < 1e-9
    assert np.any(found[:, 3] == 4.0)
    far = trajectory(state + np.array([30.0, 0.0, 0.0, 0.0]), np.empty((0, 2)))
    assert not len(sight_states(own, far, 1, 4.0))


def test_a_line_of_sight_from_behind_a_flat_array_agrees_with_its_mirror_image():
    state = straight(3) * [-1, 1, 1, 1]
    offset = 0.02
    mirrored = predict_los(TX, state) * [1, -1, 1] + [0, np.pi + offset, 0]  # pi - (departure - offset)
    now = replace(trajectory(state, np.empty((0, 2))), offset_rad=np.array([offset]))
    link = Association(np.full(3, PathClass.LOS), np.full((3, 2), -1))
    seen = replace(seen_paths(np.arange(3), mirrored), is_mirrored=True)
    lin = linearise(seen, link, now, CONFIG)
    np.testing.assert_allclose(lin.value, 0, atol=1e-9)
    assert linearise(replace(seen, is_mirrored=False), link, now, CONFIG).square().min() > 1e4
    step = 1e-6
    for column in range(4):
        moved = replace(now, state=state + step * (np.arange(4) == column))
        numeric = linearise(seen, link, moved, CONFIG).value / step
        np.testing.assert_allclose(numeric, lin.by_state[:, :, column], rtol=1e-4, atol=1e-2)
    turned = replace(now, offset_rad=now.offset_rad + step)
    numeric = linearise(seen, link, turned, CONFIG).value / step
    np.testing.assert_allclose(numeric, lin.by_shared[:, :, 0], rtol=1e-4, atol=1e-2)
