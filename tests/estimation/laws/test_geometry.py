"""The reflection law against closed forms and finite differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimation.laws.plane import (
    bounce_equation,
    bounce_fraction,
    bounce_jacobian_point,
    bounce_jacobian_rx,
    los_jacobian_rx,
    measurement_vectors,
    predict_bounce,
    predict_los,
    range_covariance,
    ray_directions,
    residual,
    start_point,
)
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose

TX = Pose(np.array([2.25, 2.5, 1.8]), -1.6)


def random_paths(seed: int, n: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """RX states (n, 4) and IPs (n, 2) at least 0.5 m from both devices and 0.1 m off the line between them."""
    rng = np.random.default_rng(seed)
    state = rng.uniform([-8, -8, -np.pi, -20], [8, 0, np.pi, 20], (n, 4))
    across = rng.uniform(-10, 10, (n, 2)) + np.array([0.0, -4.0])
    leg_tx = np.hypot(*(across - TX.position_m[:2]).T)
    leg_rx = np.hypot(*(across - state[:, :2]).T)
    excess = leg_tx + leg_rx - np.hypot(*(state[:, :2] - TX.position_m[:2]).T)
    keep = (np.minimum(leg_tx, leg_rx) > 0.5) & (excess > 0.1)
    return state[keep], across[keep]


def central_difference(function, x: np.ndarray, step: float = 1e-6) -> np.ndarray:
    columns = []
    for i in range(x.shape[-1]):
        shift = step * np.eye(x.shape[-1])[i]
        columns.append(residual(function(x + shift), function(x - shift)) / (2 * step))
    return np.stack(columns, axis=-1)


@given(seed=st.integers(0, 2**32 - 1))
def test_jacobians_match_finite_differences(seed):
    state, point = random_paths(seed)
    by_point = central_difference(lambda p: predict_bounce(TX, state, p), point)
    by_state = central_difference(lambda x: predict_bounce(TX, x, point), state)
    los = central_difference(lambda x: predict_los(TX, x), state)
    np.testing.assert_allclose(bounce_jacobian_point(TX, state, point), by_point, atol=1e-7)
    np.testing.assert_allclose(bounce_jacobian_rx(TX, state, point), by_state, atol=1e-7)
    np.testing.assert_allclose(los_jacobian_rx(TX, state), los, atol=1e-7)


def test_prediction_of_a_right_angle_by_hand():
    tx = Pose(np.array([0.0, 0.0, 1.0]), np.pi / 2)
    state = np.array([3.0, 4.0, np.pi / 2, 1.0])
    np.testing.assert_allclose(predict_bounce(tx, state, np.array([0.0, 4.0])), [8.0, 0.0, np.pi / 2])
    east_of_boresight = np.arctan2(4.0, 3.0) - np.pi / 2
    behind = np.arctan2(-4.0, -3.0) - np.pi / 2 + 2 * np.pi
    np.testing.assert_allclose(predict_los(tx, state), [6.0, east_of_boresight, behind])


@given(seed=st.integers(0, 2**32 - 1))
def test_true_paths_fulfil_their_equation(seed):
    state, point = random_paths(seed)
    measured = predict_bounce(TX, state, point)
    equation = bounce_equation(TX, state[:, 2], measured)
    z = state[:, [0, 1, 3]]
    np.testing.assert_allclose(equation.residual_m(z), 0.0, atol=1e-9)
    share = bounce_fraction(TX, equation, z, measured[:, 0])
    leg_tx = np.hypot(*(point - TX.position_m[:2]).T)
    np.testing.assert_allclose(share * (measured[:, 0] - state[:, 3]), leg_tx, rtol=1e-6)


def test_start_point_is_the_incidence_point_of_noiseless_paths():
    state, point = random_paths(3)
    share = np.hypot(*(point - TX.position_m[:2]).T) / (predict_bounce(TX, state, point)[:, 0] - state[:, 3])
    inside = (share > 0.02) & (share < 0.98)
    start = start_point(TX, state, predict_bounce(TX, state, point))
    np.testing.assert_allclose(start[inside], point[inside], atol=1e-7)


def test_directions_point_at_the_incidence_point():
    state, point = random_paths(4)
    u, v = ray_directions(TX, state[:, 2], predict_bounce(TX, state, point))
    for direction, origin in ((u, TX.position_m[:2]), (v, state[:, :2])):
        to_point = point - origin
        np.testing.assert_allclose(direction, to_point / np.linalg.norm(to_point, axis=1)[:, None])


def test_parallel_rays_have_no_fraction():
    measured = np.array([[10.0, 0.3, 0.3 + np.pi]])
    equation = bounce_equation(TX, TX.heading_rad, measured)
    equation = type(equation)(equation.row, equation.right_side, np.zeros(1))
    assert np.isnan(bounce_fraction(TX, equation, np.zeros(3), measured[:, 0])).all()


def test_residual_wraps_angles_only():
    difference = residual(np.array([[7.0, 3.1, -3.1]]), np.array([[0.0, -3.1, 3.1]]))
    np.testing.assert_allclose(difference, [[7.0, 6.2 - 2 * np.pi, 2 * np.pi - 6.2]])


def test_units_of_measurement_and_covariance():
    measured = measurement_vectors(np.array([1e-8]), np.array([0.1]), np.array([0.2]))
    assert measured[0] == pytest.approx([SPEED_OF_LIGHT_M_S * 1e-8, 0.1, 0.2])
    covariance = np.diag([1e-9, 0.01, 0.02]) ** 2
    covariance[0, 1] = covariance[1, 0] = 2e-12
    scaled = range_covariance(covariance)
    assert scaled[0, 0] == pytest.approx((SPEED_OF_LIGHT_M_S * 1e-9) ** 2)
    assert scaled[0, 1] == pytest.approx(SPEED_OF_LIGHT_M_S * 2e-12)
    assert scaled[2, 2] == pytest.approx(4e-4)
