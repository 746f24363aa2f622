"""Walls with a window before them, and paths that low noise does not explain."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.laws.plane import predict_los
from estimation.laws.wall import predict_walls
from estimation.slam.config import TrajectoryConfig
from estimation.slam.transmitters import Transmitters
from estimation.slam.walk.motion import course_of
from estimation.slam.walk.planes import best_stretch, split_wall
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState
from estimation.slam.walk.roughness import is_rough
from estimation.slam.walk.smoother import minimise_robust_cost, robust_cost
from scenes.pose import Pose

TX = Pose(np.array([1.0, 2.0, 1.5]), 0.3)
QUIET = TrajectoryConfig().model_copy(update={"wall_roughness_m": 0.001})
STD = np.array([0.005, 0.001, 0.001])
FRONT, SIDE, SOUTH = np.array([np.pi / 2, 9.0]), np.array([0.0, 14.0]), np.array([-np.pi / 2, 3.0])


def walk(window_m, n=16, only=None, more_tx=()):
    """A walk past a wall with a window in it: lines of sight and bounces off three walls, with noise.

    Of `more_tx` the window shows nothing.
    """
    rng, poses = np.random.default_rng(5), (TX, *more_tx)
    state = np.column_stack(
        [np.linspace(3, 8, n), np.linspace(1, 0, n), np.full(n, 0.4), *np.full((len(poses), n), 5.0)]
    )
    at = (state[:, 0] * 7.0 + 9.0 - state[:, 1]) / (16.0 - state[:, 1])  # of the bounce off the wall
    is_window = np.arange(n) == only if only is not None else (at > 3.0) & (at < 5.0)
    measured = []
    for one, is_front in zip(state, is_window, strict=True):
        for tx in poses:
            front = FRONT - [0.0, window_m * (is_front and tx is TX)]
            paths = [
                predict_los(tx, one[:4]),
                *(predict_walls(tx, one[:4], each[None]).value for each in (front, SIDE, SOUTH)),
            ]
            measured += [path + STD * rng.normal(size=3) for path in paths]
    row = np.repeat(np.arange(n), len(measured) // n)
    covariance = np.tile(np.diag(STD**2), (len(row), 1, 1))
    of_tx = np.tile(np.repeat(np.arange(len(poses)), 4), n)
    tx = Transmitters(poses, np.zeros(len(poses))) if more_tx else TX
    seen = Observations(tx, n, row, np.array(measured), covariance, np.zeros((3, 3)), of_tx)
    kinds = len(poses) * ([PathClass.LOS] + 3 * [PathClass.WALL])
    landmark = len(poses) * [-1, 0, 1, 2]
    link = Association(
        np.tile(kinds, n).astype(np.int64), np.column_stack([np.tile(landmark, n), np.full(len(row), -1)])
    )
    session, none = np.zeros(n, dtype=np.int64), np.empty((0, 3))
    walls = np.array([FRONT, SIDE, SOUTH])
    start = TrajectoryState(state, np.zeros(len(poses)), walls, none, session, 0, course_of(state))
    return seen, link, minimise_robust_cost(seen, link, start, QUIET), is_window


@pytest.mark.parametrize("window_m", [0.0, 0.04])
def test_a_window_before_its_wall_gets_a_plane_of_its_own(window_m):
    seen, link, now, is_window = walk(window_m)
    assert 4 <= is_window.sum() <= 10
    found = 0
    for _ in range(12):
        start, split = split_wall(seen, link, now, QUIET)
        if np.array_equal(split.landmark, link.landmark):
            break
        found += 1
        link, now = split, minimise_robust_cost(seen, split, start, QUIET)
    if not window_m:
        assert not found
        return
    assert len(now.walls) == 4
    assert np.mean(link.landmark[1::4, 0][is_window] == 3) > 0.7
    assert not np.any(link.landmark[1::4, 0][~is_window] == 3)
    assert abs(now.walls[0, 1] - now.walls[3, 1]) == pytest.approx(window_m, abs=0.01)


def test_one_stop_that_sees_a_window_shows_it_by_its_other_paths():
    seen, link, now, _ = walk(0.12, only=6)
    start, split = split_wall(seen, link, now, QUIET)
    assert np.flatnonzero(split.landmark[:, 0] == 3).tolist() == [4 * 6 + 1]
    assert start.walls[0, 1] - start.walls[3, 1] == pytest.approx(0.12, abs=0.02)


def test_one_stop_shows_the_window_of_one_tx_beside_another():
    seen, link, now, _ = walk(0.12, only=6, more_tx=[Pose(np.array([12.0, -1.0, 1.5]), 2.8)])
    start, split = split_wall(seen, link, now, QUIET)
    assert np.flatnonzero(split.landmark[:, 0] == 3).tolist() == [8 * 6 + 1]
    assert start.state.shape == (16, 5)
    assert start.walls[0, 1] - start.walls[3, 1] == pytest.approx(0.12, abs=0.02)


def test_a_second_stop_takes_the_plane_that_is_there():
    seen, link, now, _ = walk(0.12, only=6)
    more = replace(now, walls=np.concatenate([now.walls, FRONT[None] - [0.0, 0.12]]))
    start, split = split_wall(seen, link, more, QUIET)
    assert len(start.walls) == 4
    assert np.count_nonzero(split.landmark[:, 0] == 3) == 1


def test_a_stretch_gains_what_a_new_fit_gains():
    """The score test against the cost of the walk fitted again with the plane."""
    seen, link, now, _ = walk(0.006)
    found = best_stretch(seen, link, now, QUIET)
    landmark = link.landmark.copy()
    landmark[found.path, 0] = 3
    start = now.moved(*found.step)
    start = replace(start, walls=np.concatenate([start.walls, start.walls[[found.wall]] + [0.0, found.shift_m]]))
    split = replace(link, landmark=landmark)
    costs = [robust_cost(seen, link, now, QUIET), robust_cost(seen, split, start, QUIET)]
    tried = 3 * sum(17 - n for n in range(3, 14))
    assert found.gain + np.log(tried) == pytest.approx(costs[0] - costs[1], rel=0.2)
    assert costs[0] - costs[1] > 1.0
    best = minimise_robust_cost(seen, split, start, QUIET)
    assert robust_cost(seen, split, best, QUIET) == pytest.approx(costs[1], abs=1.0)


def test_a_walk_without_walls_is_split_nowhere():
    seen, link, now, _ = walk(0.0, n=3)
    none = Association(np.where(link.kind == PathClass.LOS, link.kind, PathClass.UNUSED), np.full((12, 2), -1))
    start, same = split_wall(seen, none, replace(now, walls=np.empty((0, 2))), QUIET)
    assert len(start.walls) == 0
    assert np.array_equal(same.landmark, none.landmark)


def test_paths_that_low_noise_does_not_explain_are_rough():
    seen, link, now, _ = walk(0.0)
    wrong = np.array([5, 22, 42])
    measured = seen.measured.copy()
    measured[wrong, 0] += 12 * STD[0]
    measured[wrong, 1] += 12 * STD[1]
    seen = replace(seen, measured=measured)
    wide = replace(seen, covariance=20**2 * seen.covariance)
    same = np.ones(len(link.kind))
    assert np.flatnonzero(is_rough(seen, wide, link, same, now, QUIET)).tolist() == wrong.tolist()
