"""Walls of a walk from points and normals, and stops that landmarks place again."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.laws.contour import predict_circle
from estimation.laws.plane import predict_los
from estimation.laws.wall import predict_walls
from estimation.slam.config import Consider, PathLoss, TrajectoryConfig
from estimation.slam.snapshot.evidence import power_law
from estimation.slam.walk.mirrors import find_walls
from estimation.slam.walk.motion import add_motion, course_of
from estimation.slam.walk.relocate import DoubtfulStops, Powers, placed, wall_spans
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState, spare_equations
from scenes.pose import Pose

TX = Pose(np.array([1.0, 2.0, 1.5]), 0.3)
WALLS = np.array([[np.pi / 2, 9.0], [0.05, 14.0]])  # their normals point away from the TX
OBJECTS = np.array([[6.0, 4.0, 0.3], [9.0, 7.0, 0.2]])
CONFIG = TrajectoryConfig()
STD = np.array([0.02, 0.003, 0.003])


def normals(azimuth):
    return np.column_stack([np.cos(azimuth), np.sin(azimuth)])


def test_far_points_of_a_wall_are_one_wall_and_lines_at_random_are_none():
    rng = np.random.default_rng(1)
    along, on = rng.uniform(-9, 9, 12), np.repeat([0, 1], 6)
    normal = normals(WALLS[on, 0])
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    point = WALLS[on, 1, None] * normal + along[:, None] * tangent + 0.02 * rng.normal(size=(12, 2))
    azimuth = WALLS[on, 0] + 0.01 * rng.normal(size=12)
    stray, turn = rng.uniform(-15, 15, (60, 2)), rng.uniform(-np.pi, np.pi, 60)
    points, azimuths = np.concatenate([stray, point]), np.concatenate([turn, azimuth])
    walls, spans, is_free = find_walls(points, normals(azimuths), np.full(72, 0.01), 5)
    order = np.argsort(-walls[:, 0])
    np.testing.assert_allclose(walls[order], WALLS, atol=0.03)
    for wall, span in zip(order, (along[:6], along[6:]), strict=True):
        np.testing.assert_allclose(spans[wall], [span.min(), span.max()], atol=0.1)
    assert not is_free[60:].any()
    assert np.count_nonzero(~is_free[:60]) <= 2


@pytest.mark.parametrize("seed", range(5))
def test_points_at_random_make_no_wall(seed):
    rng = np.random.default_rng(seed)
    point, azimuth = rng.uniform(-10, 10, (80, 2)), rng.uniform(-np.pi, np.pi, 80)
    walls, _, is_free = find_walls(point, normals(azimuth), np.full(80, 0.01), 5)
    assert not len(walls)
    assert is_free.all()


def test_a_short_row_of_points_is_no_wall():
    point = np.column_stack([np.linspace(0, 0.8, 8), np.full(8, 3.0)])
    walls, _, is_free = find_walls(point, normals(np.full(8, np.pi / 2)), np.full(8, 0.02), 5)
    assert not len(walls)
    assert is_free.all()


def walk(has_los):
    """A walk whose stops see both walls and both objects, with errors, and its association."""
    rng = np.random.default_rng(4)
    n = 6
    state = np.column_stack([np.linspace(3, 8, n), np.linspace(1, 0, n), np.full(n, 0.4), np.full(n, 5.0)])
    kinds = [PathClass.WALL, PathClass.WALL, PathClass.OBJECT, PathClass.OBJECT]
    marks = [0, 1, 0, 1]
    if has_los:
        kinds, marks = [PathClass.LOS, *kinds], [-1, *marks]
    measured = []
    for one in state:
        paths = [predict_los(TX, one)] if has_los else []
        paths += [predict_walls(TX, one, WALLS[[w]]).value for w in (0, 1)]
        paths += [predict_circle(TX, one, circle).value for circle in OBJECTS]
        measured += [path + STD * rng.normal(size=3) for path in paths]
    row = np.repeat(np.arange(n), len(kinds))
    covariance = np.tile(np.diag(STD**2), (len(row), 1, 1))
    seen = Observations(TX, n, row, np.array(measured), covariance, np.zeros((3, 3)))
    landmark = np.column_stack([np.tile(marks, n), np.full(len(row), -1)])
    session = np.zeros(n, dtype=np.int64)
    now = TrajectoryState(state, np.zeros(1), WALLS, OBJECTS, session, 0, course_of(state))
    return seen, Association(np.tile(kinds, n).astype(np.int64), landmark), now


def place_stop(seen, link, now, los_dbm=0.0):
    """Stop 2 placed; the first path is `los_dbm` stronger than a line of sight of its length."""
    loss = PathLoss()
    level = loss.expected_dbm(seen.measured[seen.row == 2, 0] - 5.0) - loss.reflection_loss_db
    level[0] += loss.reflection_loss_db + los_dbm
    doubtful = DoubtfulStops(np.ones(6, bool), [np.empty((0, 4))] * 6, [Powers(level, power_law(loss))] * 6, 90.0)
    return placed(seen, now, wall_spans(seen, link, now), 2, np.ones(6, bool), doubtful, CONFIG)


@pytest.mark.parametrize("has_los", [True, False])
def test_landmarks_place_a_stop_that_is_far_off(has_los):
    seen, link, now = walk(has_los)
    truth = now.state[2]
    lost = now.state.copy()
    lost[2] += [2.5, -1.5, 0.6, -3.0]
    place = place_stop(seen, link, replace(now, state=lost))
    assert place.is_new
    np.testing.assert_allclose(place.state, truth, atol=0.1)
    assert place.is_los.any() == has_los
    assert place.evidence > 10
    assert place.position_std_m < 0.2
    assert 0 <= place.los_probability <= 1


def test_a_stop_that_is_right_stays_and_one_that_nothing_explains_has_no_evidence():
    seen, link, now = walk(True)
    place = place_stop(seen, link, now)
    assert not place.is_new
    np.testing.assert_allclose(place.state, now.state[2], atol=0.05)
    rng = np.random.default_rng(7)
    noise = np.column_stack([rng.uniform(30, 60, len(seen.row)), rng.uniform(-3, 3, (len(seen.row), 2))])
    measured = np.where((seen.row == 2)[:, None], noise, seen.measured)
    assert place_stop(replace(seen, measured=measured), link, now).evidence < 6


@pytest.mark.parametrize(("los_dbm", "has_los"), [(0.0, True), (-30.0, False)])
def test_a_path_far_too_weak_is_no_line_of_sight(los_dbm, has_los):
    seen, link, now = walk(True)
    seen = replace(seen, covariance=100 * seen.covariance)
    assert place_stop(seen, link, now, los_dbm).is_los.any() == has_los


def test_points_on_a_line_by_chance_are_no_wall():
    """Points along a line, of which few face as it does: normals this uncertain agree by chance."""
    rng = np.random.default_rng(3)
    n = 60
    point = np.column_stack([np.linspace(0, 6, n), 3 + 0.05 * rng.normal(size=n)])
    azimuth, std = rng.uniform(0, np.pi, n), np.full(n, np.deg2rad(1.0))
    walls, _, _ = find_walls(point, normals(azimuth), std, 5)
    assert not len(walls)
    azimuth[::2] = np.pi / 2
    walls, _, _ = find_walls(point, normals(azimuth), std, 5)
    assert len(walls) == 1


def test_spare_equations_are_those_beyond_the_four_unknowns():
    seen, link, _ = walk(True)
    np.testing.assert_array_equal(spare_equations(seen, link), 11)
    kind = np.where(link.kind == PathClass.LOS, PathClass.LOS, PathClass.UNUSED)
    np.testing.assert_array_equal(spare_equations(seen, Association(kind, link.landmark)), -1)


def test_a_covariance_counts_on_no_more_than_the_law_of_the_motion():
    state = np.column_stack([np.arange(6.0), np.zeros(6), np.zeros(6), np.zeros(6)])
    parts = []
    for as_expected in (False, True):
        diagonal, gradient = np.zeros((6, 4, 4)), np.zeros((6, 4))
        add_motion(state, course_of(state), CONFIG, diagonal, gradient, as_expected=as_expected)
        parts.append(diagonal)
    # Student-t with 2 degrees of freedom, in one and in two dimensions: at 0 against the mean of the curvature
    np.testing.assert_allclose(parts[1][:, 2, 2] / parts[0][:, 2, 2], (3 / 5) / (3 / 2))
    np.testing.assert_allclose(parts[1][:, 0, 0] / parts[0][:, 0, 0], (4 / 6) / (4 / 2))


def test_set_up_errors_turn_about_the_transmitter():
    offset = np.array([3.0, 4.0])
    added = Consider(pointing_std_deg=2.0).covariance(offset)
    assert added[0, 0] + added[1, 1] == pytest.approx((5 * np.deg2rad(2.0)) ** 2)
    assert offset @ added[:2, :2] @ offset == pytest.approx(0, abs=1e-12)


def test_few_sharp_reflections_show_a_wall_that_scattered_paths_hide():
    """Five reflections off a wall of a few stops, and thirty paths scattered by places on and about it."""
    rng = np.random.default_rng(8)
    sharp = np.column_stack([[2.0, 3.5, 5.0, 6.5, 8.0], np.full(5, 3.0)])
    blurred = np.column_stack([rng.uniform(1, 9, 30), rng.normal(3.0, 0.15, 30)])
    azimuth = np.concatenate([np.full(5, np.pi / 2), rng.uniform(0.2, np.pi - 0.2, 30)])
    std = np.concatenate([np.full(5, 0.002), rng.uniform(0.01, 0.03, 30)])
    walls, spans, is_free = find_walls(np.concatenate([sharp, blurred]), normals(azimuth), std, 3)
    assert walls[0] == pytest.approx([np.pi / 2, 3.0], abs=0.01)
    assert len(walls) == 1
    assert spans[0] == pytest.approx([-8.0, -2.0])
    assert not is_free[:5].any()
    alone, _, _ = find_walls(blurred, normals(azimuth[5:]), std[5:], 3)
    assert not len(alone)
