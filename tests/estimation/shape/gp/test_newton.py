"""Small clusters together: the compiled search against the exact likelihood, one by one, and L-BFGS-B."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.shape.gp.exact import chord, log_marginal_likelihood
from estimation.shape.gp.newton import likelihood_terms
from estimation.shape.gp.radial import (
    RadialData,
    _data_starts,
    _maximise_likelihood,
    _search_bounds,
    fit_radial_gp,
    fit_radial_gps,
)
from isac_arena.validation.shape.gp_study import SHAPES, draw_points

AT = np.linspace(-np.pi, np.pi, 60)


def clusters(seed, sizes):
    rng = np.random.default_rng(seed)
    return [draw_points(list(SHAPES)[k % 4], n, rng) for k, n in enumerate(sizes)]


@given(
    seed=st.integers(0, 10_000),
    n=st.integers(1, 25),
    std=st.tuples(st.floats(0.05, 2), st.floats(0.2, 4), st.floats(0.05, 1)),
)
@settings(max_examples=60, deadline=None)
def test_likelihood_and_its_derivatives(seed, n, std):
    ((angle, radius),) = clusters(seed, [n])
    chords, log_beta = chord(angle, angle), 2 * np.log(std)
    value, gradient, hessian = likelihood_terms(chords, radius, log_beta)
    exact = log_marginal_likelihood(chords, radius, np.exp(log_beta))
    assert value == pytest.approx(exact.value, rel=1e-9, abs=1e-9)
    scale = 1 + np.max(np.abs(exact.gradient[1:] * np.exp(log_beta)))
    np.testing.assert_allclose(gradient, exact.gradient[1:] * np.exp(log_beta), atol=1e-8 * scale)
    for k, step in enumerate(1e-4 * np.eye(3)):
        above, below = (likelihood_terms(chords, radius, log_beta + s * step)[1] for s in (1, -1))
        np.testing.assert_allclose(hessian[k], (above - below) / 2e-4, atol=1e-6 * (scale + np.abs(hessian).max()))


def test_a_batch_is_its_clusters_one_by_one():
    batch = clusters(1, [16, 5, 1, 40, 32, 33, 2, 16, 100])
    floors = [0.0, 0.1, 0.0, 0.1, 0.05, 0.0, 0.2, 0.1, 0.0]
    together = fit_radial_gps(batch, noise_floor_std_m=floors)
    for (angle, radius), floor, found in zip(batch, floors, together, strict=True):
        alone = fit_radial_gp(angle, radius, noise_floor_std_m=floor)
        assert found.log_likelihood == pytest.approx(alone.log_likelihood, abs=1e-6)
        np.testing.assert_allclose(found.predict(AT), alone.predict(AT), atol=1e-4)
    assert fit_radial_gps([]) == []


def by_l_bfgs_b(data):
    """Most likely beta of the same starts by another search."""
    starts, bounds = _data_starts(data.angle_rad, data.radius_m), _search_bounds(data.radius_m, 0.0)
    ends = [_maximise_likelihood(data, start, bounds, 1e-3) for start in starts]
    return max(ends, key=lambda beta: data.log_marginal_likelihood(beta).value)


def test_the_compiled_search_ends_where_l_bfgs_b_does():
    gain, difference = gains_over_l_bfgs_b(clusters(2, [4, 8, 12, 16, 16, 20, 24, 32] * 5))
    assert np.sum(gain < -1e-6) <= 2  # of 40: from the same starts the two may climb different hills
    same = np.abs(gain) < 1e-6
    assert same.sum() >= 25
    assert np.median(difference[same]) < 1e-4


def test_large_clusters_end_there_too():
    gain, difference = gains_over_l_bfgs_b(clusters(3, [48, 64, 100, 300] * 5))
    assert np.sum(gain < -1e-2) <= 1  # of 20; without a signal the likelihood is flat over all length scales
    assert np.median(np.abs(gain)) < 1e-5
    assert np.median(difference) < 1e-4


def gains_over_l_bfgs_b(batch):
    """Gain in likelihood (cluster,) and largest difference of the radii in m."""
    gain, difference = [], []
    for (angle, radius), found in zip(batch, fit_radial_gps(batch), strict=True):
        data = RadialData(angle, radius)
        beta = by_l_bfgs_b(data)
        likelihood = data.log_marginal_likelihood(beta)
        gain.append(found.log_likelihood - likelihood.value)
        slow = likelihood.mu + data.posterior(beta, likelihood.mu).predict(AT)[0]
        difference.append(np.max(np.abs(found.predict(AT)[0] - slow)))
    return np.array(gain), np.array(difference)


def test_a_batch_names_a_bad_cluster():
    with pytest.raises(ValueError, match="2 angles and 3 radii"):
        fit_radial_gps([(np.zeros(3), np.ones(3)), (np.zeros(2), np.ones(3))])
