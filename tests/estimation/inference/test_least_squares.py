"""The damped Gauss-Newton loop: against scipy, on noiseless problems; the cost never increases."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from estimation.inference.least_squares import Attempt, Schedule, damped_step, minimise

AXIS = np.linspace(0, 3, 25)


def curve(parameter):
    """Decaying oscillations (..., 25) with amplitude, rate and frequency (..., 3), and their derivatives."""
    a, rate, frequency = (parameter[..., k, None] for k in range(3))
    decay, phase = np.exp(-rate * AXIS), frequency * AXIS
    by = (decay * np.cos(phase), -AXIS * a * decay * np.cos(phase), -AXIS * a * decay * np.sin(phase))
    return a * by[0], np.stack(by, axis=-1)


def attempt_to_fit(data, history=None):
    def cost(parameter):
        return 0.5 * np.sum((curve(parameter)[0] - data) ** 2, axis=-1)

    def attempt(at, damping):
        value, slope = curve(at)
        gradient = np.einsum("...na,...n->...a", slope, value - data)
        trial = at + damped_step(np.swapaxes(slope, -1, -2) @ slope, gradient, damping)
        if history is not None:
            history.append(cost(at))
        return Attempt(trial, cost(at), cost(trial))

    return attempt


def problems(seed, n, noise):
    rng = np.random.default_rng(seed)
    true = rng.uniform([1.0, 0.1, 1.0], [3.0, 1.0, 4.0], (n, 3))
    return (true, curve(true)[0] + noise * rng.normal(size=(n, len(AXIS))), true + rng.normal(size=(n, 3)) * 0.1)


@given(seed=st.integers(0, 2**32 - 1))
def test_random_problems_end_where_scipy_ends(seed):
    _, data, start = problems(seed, 4, 0.05)
    found = minimise(start, attempt_to_fit(data), Schedule(100, absolute=0.0, relative=1e-15))
    for k in range(4):
        expected = least_squares(lambda x, k=k: curve(x)[0] - data[k], start[k], method="lm", xtol=1e-13)
        np.testing.assert_allclose(found[k], expected.x, atol=1e-5)


@given(seed=st.integers(0, 2**32 - 1))
def test_noiseless_problems_return_the_truth(seed):
    true, data, start = problems(seed, 5, 0.0)
    np.testing.assert_allclose(minimise(start, attempt_to_fit(data), Schedule(100)), true, atol=1e-7)


def test_members_of_a_batch_are_independent():
    _, data, start = problems(2, 6, 0.1)
    together = minimise(start, attempt_to_fit(data), Schedule(8))
    for k in range(6):
        alone = minimise(start[k], attempt_to_fit(data[k]), Schedule(8))
        np.testing.assert_allclose(together[k], alone, rtol=1e-9)


@given(seed=st.integers(0, 2**32 - 1))
def test_the_cost_never_increases(seed):
    _, data, start = problems(seed, 3, 0.1)
    history = []
    far = start + np.array([3.0, 0.5, 6.0])
    minimise(far, attempt_to_fit(data, history), Schedule(60, first=1e-9))
    assert np.all(np.diff(np.array(history), axis=0) <= 0)


def test_a_step_to_nan_is_not_kept():
    def attempt(at, damping):
        trial = at - at / (1 + damping)
        return Attempt(trial, at, trial if damping > 0.5 else np.nan)

    assert 0 < minimise(1.0, attempt, Schedule(6)) < 1


@pytest.mark.parametrize(("share", "expected"), [(0.9, 1e-2 / 8), (0.5, 1e-2), (0.1, 8e-2), (-0.1, 8e-2)])
def test_damping_follows_the_share_of_the_expected_gain(share, expected):
    seen = []

    def attempt(at, damping):
        seen.append(float(damping))
        return Attempt(at + 1, 0.0, -share, expected=1.0)

    found = minimise(0, attempt, Schedule(2, first=1e-2, factor=8.0, good=0.7, poor=0.2))
    assert seen == pytest.approx([1e-2, expected])
    assert found == (2 if share > 0 else 0)


def test_no_attempt_ends_the_loop_and_too_much_damping_converges():
    assert minimise(3, lambda at, damping: None, Schedule(5)) == 3
    seen = []

    def worse(at, damping):
        seen.append(float(damping))
        return Attempt(at, 0.0, 1.0)

    minimise(0, worse, Schedule(50, largest=1.0))
    assert seen == pytest.approx([1e-3, 1e-2, 1e-1, 1.0, 10.0])
