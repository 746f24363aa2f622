"""Shared landmarks: reflection law and derivatives of walls and circles."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from estimation.laws.contour import predict_circle
from estimation.laws.plane import predict_bounce
from estimation.laws.wall import predict_walls, wall_places
from scenes.pose import Pose, wrap_angle

TX = Pose(np.array([2.25, 2.5, 1.8]), -1.6)
STATE = np.array([[-1.0, -3.0, 0.3, 4.0], [4.0, -5.0, -2.0, 7.0]])
WALLS = np.array([[[0.1, 6.0], [1.4, -9.0]], [[3.0, 5.0], [-1.5, 9.5]]])
CIRCLES = np.array([[0.3, -6.0, 0.2], [-3.0, -4.0, 1.1]])


def finite_difference(function, at: np.ndarray) -> np.ndarray:
    columns = []
    for i in range(at.shape[-1]):
        step = 1e-6 * np.eye(at.shape[-1])[i]
        difference = function(at + step) - function(at - step)
        difference[..., 1:] = wrap_angle(difference[..., 1:])
        columns.append(difference / 2e-6)
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("bounces", [1, 2])
def test_derivatives_of_wall_paths_match_finite_differences(bounces):
    walls = WALLS[:, :bounces]
    at = predict_walls(TX, STATE, walls)
    by_state = finite_difference(lambda x: predict_walls(TX, x, walls).value, STATE)
    flat = walls.reshape(2, -1)
    by_wall = finite_difference(lambda w: predict_walls(TX, STATE, w.reshape(walls.shape)).value, flat)
    np.testing.assert_allclose(at.by_state, by_state, atol=1e-7)
    np.testing.assert_allclose(at.by_landmark, by_wall, atol=1e-7)


@pytest.mark.parametrize("radius_m", [None, 1e-4, 0.0, -1e-4, -0.05])
def test_derivatives_of_circle_paths_match_finite_differences(radius_m):
    circles = CIRCLES.copy()
    if radius_m is not None:  # an estimate of a thin pillar may pass through zero
        circles[:, 2] = radius_m
    at = predict_circle(TX, STATE, circles)
    by_state = finite_difference(lambda x: predict_circle(TX, x, circles).value, STATE)
    by_circle = finite_difference(lambda c: predict_circle(TX, STATE, c).value, circles)
    np.testing.assert_allclose(at.by_state, by_state, atol=1e-7)
    np.testing.assert_allclose(at.by_landmark, by_circle, atol=1e-7)


def test_wall_path_is_the_single_bounce_at_its_specular_point():
    walls = WALLS[:, 1]
    place, _, _ = wall_places(walls, TX, STATE[:, :2])
    normal = np.column_stack([np.cos(walls[:, 0]), np.sin(walls[:, 0])])
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    point = walls[:, 1:] * normal + place[:, None] * tangent
    direct = predict_walls(TX, STATE, walls[:, None]).value
    np.testing.assert_allclose(direct, predict_bounce(TX, STATE, point), atol=1e-12)


def test_circle_path_is_the_shortest_over_the_lit_side():
    for state, circle in zip(STATE, CIRCLES, strict=True):

        def length(angle, state=state, circle=circle):
            q = circle[:2] + circle[2] * np.array([np.cos(angle), np.sin(angle)])
            return np.hypot(*(q - TX.position_m[:2])) + np.hypot(*(q - state[:2]))

        towards = np.arctan2(*(TX.position_m[:2] + state[:2] - 2 * circle[:2])[::-1])
        best = minimize_scalar(length, bounds=(towards - 1.2, towards + 1.2), method="bounded").fun
        assert predict_circle(TX, state, circle).value[0] - state[3] == pytest.approx(best, abs=1e-8)
