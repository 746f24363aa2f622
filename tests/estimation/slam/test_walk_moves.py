"""Stops that landmarks move, what known neighbours say of a stop, and sides of walls."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.laws.plane import predict_bounce, predict_los
from estimation.laws.wall import predict_walls
from estimation.slam.config import TrajectoryConfig
from estimation.slam.walk.agreement import AGREE_RAD, _most_agreed, sight_states
from estimation.slam.walk.association import reclassify_paths
from estimation.slam.walk.linearise import linearise
from estimation.slam.walk.motion import course_of, motion_cost
from estimation.slam.walk.neighbours import between_known, motion_about, neighbour_states
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState
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
    found = sight_states(own, around, 1, 1, 4.0)
    off = found - state[1]
    off[:, 2] = wrap_angle(off[:, 2])
    assert np.abs(off).max(axis=1).min() < 1e-9
    assert np.any(found[:, 3] == 4.0)
    far = trajectory(state + np.array([30.0, 0.0, 0.0, 0.0]), np.empty((0, 2)))
    assert not len(sight_states(own, far, 1, 1, 4.0))


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


def test_votes_are_counted_as_by_all_pairs():
    rng = np.random.default_rng(3)
    path = np.sort(rng.integers(0, 6, 30))
    heading, bias, is_able = rng.normal(0, 0.1, (4, 30)), rng.normal(0, 0.3, (4, 30)), rng.random((4, 30)) < 0.5
    is_able[3] = False
    votes, one = _most_agreed(path, heading, bias, is_able, 0.5)
    for k in range(3):
        able = np.flatnonzero(is_able[k])
        apart = np.abs(bias[k, able][:, None] - bias[k, able]) / 0.5
        turned = np.abs(wrap_angle(heading[k, able][:, None] - heading[k, able])) / AGREE_RAD
        agree = np.maximum(1 - np.maximum(apart, turned) ** 2, 0.0)
        total = sum(agree[:, path[able] == own].max(axis=1) for own in np.unique(path[able]))
        assert votes[k] == pytest.approx(total.max())
        assert one[k] == able[np.argmax(total)]
    assert votes[3] == 0
