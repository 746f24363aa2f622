"""Walks of hundreds of stops: sessions in several places at once, and an association that is nearly constant."""

import numpy as np
import pytest

from estimation.laws.plane import predict_los
from estimation.laws.wall import predict_walls
from estimation.slam.config import TrajectoryConfig
from estimation.slam.walk.alternation import _same
from estimation.slam.walk.motion import course_of
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState
from estimation.slam.walk.sessions import split_sessions
from estimation.slam.walk.smoother import minimise_robust_cost
from scenes.pose import Pose

TX = Pose(np.array([0.0, 0.0, 1.5]), 0.2)
WALLS = np.array([[0.3, 9.0], [1.8, 8.0]])
STD = np.array([0.02, 5e-3, 5e-3])
JUMP_RAD = 0.05
CONFIG = TrajectoryConfig(wall_roughness_m=0.01)


def walk_with_jumps(n, jumps):
    """Paths of a walk by two walls and the line of sight; the TX turns at some stops, to and fro."""
    rng = np.random.default_rng(n)
    along = np.linspace(0, 1, n)
    state = np.column_stack([2 + 4 * along, -2 + 5 * along**2, 0.3 * along, np.full(n, 3.0)])
    turned = np.zeros(n)
    for number, stop in enumerate(jumps):
        turned[stop:] += JUMP_RAD * (-1) ** number
    rows = []
    for k, one in enumerate(state):
        paths = np.array([predict_los(TX, one), *(predict_walls(TX, one, wall[None]).value for wall in WALLS)])
        paths += rng.normal(size=paths.shape) * STD
        paths[:, 1] -= turned[k]
        rows.append(paths)
    measured = np.concatenate(rows)
    covariance = np.tile(np.diag(STD**2), (3 * n, 1, 1))
    seen = Observations(TX, n, np.repeat(np.arange(n), 3), measured, covariance, np.zeros((3, 3)))
    kind = np.tile([PathClass.LOS, PathClass.WALL, PathClass.WALL], n)
    landmark = np.column_stack([np.tile([-1, 0, 1], n), np.full(3 * n, -1)])
    none, session = np.empty((0, 3)), np.zeros(n, np.int64)
    now = TrajectoryState(state, np.zeros(1), WALLS, none, session, 0, course_of(state))
    link = Association(kind, landmark)
    return seen, link, minimise_robust_cost(seen, link, now, CONFIG)


def opened(now):
    return np.flatnonzero(np.diff(now.session)) + 1


def test_a_long_walk_opens_sessions_in_all_its_parts_at_once():
    jumps = [60, 190, 330]
    seen, link, now = walk_with_jumps(400, jumps)
    at_once = split_sessions(seen, link, now, CONFIG)
    np.testing.assert_allclose(opened(at_once), jumps, atol=7)  # every seventh stop or so is a candidate
    offset = at_once.offset_rad[at_once.session] - at_once.offset_rad[0]
    found = np.diff(offset[[30, 120, 260, 370]])
    np.testing.assert_allclose(found, JUMP_RAD * np.array([1, -1, 1]), atol=0.1 * JUMP_RAD)


def test_a_short_walk_opens_one_session_at_a_time():
    seen, link, now = walk_with_jumps(200, [60, 130])
    assert len(opened(split_sessions(seen, link, now, TrajectoryConfig(wall_roughness_m=0.01)))) == 1


@pytest.mark.parametrize("jumps", [[], [250]])
def test_a_long_walk_opens_no_session_where_the_tx_did_not_turn(jumps):
    seen, link, now = walk_with_jumps(400, jumps)
    while len((split := split_sessions(seen, link, now, CONFIG)).offset_rad) > len(now.offset_rad):
        now = split
    assert len(opened(now)) <= 3 * len(jumps)  # a candidate beside the jump may need a second one
    assert all(abs(stop - 250) < 20 for stop in opened(now))


@pytest.mark.parametrize(
    ("n_stops", "n_changed", "is_same"), [(45, 0, True), (255, 1, False), (256, 1, True), (600, 3, False)]
)
def test_an_association_of_a_long_walk_is_constant_though_a_few_paths_change(n_stops, n_changed, is_same):
    link = Association(np.zeros(2000, int), np.full((2000, 2), -1))
    landmark = link.landmark.copy()
    landmark[:n_changed, 0] = 1
    assert _same(link, Association(link.kind, landmark), n_stops) == is_same
