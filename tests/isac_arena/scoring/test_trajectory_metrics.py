import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from isac_arena.scoring.metrics.trajectories import absolute_errors, aligned, relative_errors

turns = st.floats(-3, 3)


def walk(seed=1, stops=12):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(0, 1, (stops, 2)), axis=0), rng.uniform(-np.pi, np.pi, stops)


def moved(position, heading, turn, shift):
    c, s = np.cos(turn), np.sin(turn)
    return position @ np.array([[c, s], [-s, c]]) + shift, heading + turn


@given(turns, st.floats(-5, 5))
def test_a_rigid_motion_is_no_error_after_alignment_nor_in_steps(turn, shift):
    position, heading = walk()
    other, other_heading = moved(position, heading, turn, np.array([shift, -2 * shift]))
    error_m, error_rad = absolute_errors(other, other_heading, position, heading, align=True)
    np.testing.assert_allclose(error_m, 0, atol=1e-9)
    np.testing.assert_allclose(error_rad, 0, atol=1e-9)
    for part in relative_errors(other, other_heading, position, heading, delta=3):
        np.testing.assert_allclose(part, 0, atol=1e-9)


def test_without_alignment_the_errors_are_those_put_in():
    position, heading = walk()
    error_m, error_rad = absolute_errors(
        position + np.array([0.3, -0.4]), heading - 0.1, position, heading, align=False
    )
    np.testing.assert_allclose(error_m, 0.5)
    np.testing.assert_allclose(error_rad, -0.1)


def test_alignment_is_the_best_of_all_rigid_motions():
    truth, heading = walk()
    rng = np.random.default_rng(7)
    estimate = moved(truth, heading, 0.8, np.array([1.0, 2.0]))[0] + rng.normal(0, 0.2, truth.shape)
    found, rotation = aligned(estimate, truth)

    def cost(motion):
        return np.square(moved(estimate, heading, motion[0], motion[1:])[0] - truth).sum()

    best = minimize(cost, [rotation, 0, 0])
    assert np.square(found - truth).sum() == pytest.approx(best.fun, rel=1e-6)
    other, _ = Rotation.align_vectors(
        np.column_stack([truth - truth.mean(0), np.zeros(12)]),
        np.column_stack([estimate - estimate.mean(0), np.zeros(12)]),
    )
    assert rotation == pytest.approx(other.as_rotvec()[2], abs=1e-9)


def test_relative_errors_are_those_of_homogeneous_transforms():
    position, heading = walk(2)
    truth, true_heading = walk(3)

    def matrix(p, h):
        c, s = np.cos(h), np.sin(h)
        return np.array([[c, -s, p[0]], [s, c, p[1]], [0, 0, 1]])

    error_m, error_rad = relative_errors(position, heading, truth, true_heading, delta=2)
    for i in range(10):
        estimate = np.linalg.inv(matrix(position[i], heading[i])) @ matrix(position[i + 2], heading[i + 2])
        true = np.linalg.inv(matrix(truth[i], true_heading[i])) @ matrix(truth[i + 2], true_heading[i + 2])
        difference = np.linalg.inv(true) @ estimate
        assert error_m[i] == pytest.approx(np.hypot(*difference[:2, 2]))
        turned = np.exp(1j * error_rad[i])
        assert turned == pytest.approx(difference[0, 0] + 1j * difference[1, 0])


def test_unknown_stops_are_left_out():
    position, heading = walk()
    lost = position.copy()
    lost[4] = np.nan
    error_m, _ = absolute_errors(lost + 1.0, heading, position, heading, align=True)
    assert np.isnan(error_m[4])
    np.testing.assert_allclose(np.delete(error_m, 4), 0, atol=1e-9)
    step_m, _ = relative_errors(lost, heading, position, heading)
    assert np.isnan(step_m).sum() == 2
    nothing, rotation = aligned(np.full((3, 2), np.nan), position[:3])
    assert rotation == 0 and np.isnan(nothing).all()
    with pytest.raises(ValueError, match="delta = 0"):
        relative_errors(position, heading, position, heading, delta=0)
