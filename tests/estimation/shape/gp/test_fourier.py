import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime
from scipy.special import ive

from estimation.shape.gp.exact import ExactPosterior, chord, log_marginal_likelihood
from estimation.shape.gp.fourier import FourierPosterior, FourierSums, log_marginal_likelihood_fourier
from estimation.shape.gp.harmonic_terms import (
    LIKELIHOOD_ERROR_NAT,
    harmonic_terms,
    needed_order,
    smallest_order,
    weights,
)
from estimation.shape.gp.newton import likelihood_terms
from estimation.shape.gp.radial import RadialData, fit_radial_gp


def star(n, seed, noise_std_m=0.1):
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-np.pi, np.pi, n)
    return angle, 2 + 0.4 * np.cos(5 * angle) + noise_std_m * rng.standard_normal(n)


betas = st.builds(
    lambda signal, length, noise: np.array([signal, length, noise]) ** 2,
    st.floats(1e-3, 3),
    st.floats(0.05, 10),
    st.floats(0.01, 2),
)
seeds = st.integers(0, 2**32 - 1)


@given(length_scale=st.floats(0.05, 10))
@settings(max_examples=60, deadline=None)
def test_harmonics_add_up_to_the_kernel(length_scale):
    order = needed_order(length_scale**2, 1.0)
    difference = np.linspace(0, 2 * np.pi, 97)
    found = np.cos(difference[:, None] * np.arange(order + 1)) @ weights(length_scale**2, order)[0]
    expected = np.exp(-2 * np.sin(difference / 2) ** 2 / length_scale**2)
    np.testing.assert_allclose(found, expected, atol=5e-9)
    assert order >= smallest_order(length_scale)


@given(length_scale=st.floats(0.06, 9))
@settings(max_examples=30, deadline=None)
def test_weights_are_bessel_functions_and_their_slopes_are_differences(length_scale):
    step, order = 1e-5, needed_order(length_scale**2, 1.0)
    above, (weight, slope, bend), below = (weights(length_scale**2 * np.exp(s), order) for s in (step, 0.0, -step))
    bessel = np.where(np.arange(order + 1) == 0, 1.0, 2.0) * ive(np.arange(order + 1), 1 / length_scale**2)
    np.testing.assert_allclose(weight, bessel, rtol=1e-9, atol=1e-300)
    np.testing.assert_allclose(slope, (np.log(above[0]) - np.log(below[0])) / (2 * step), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(bend, (above[1] - below[1]) / (2 * step), rtol=1e-4, atol=1e-4)


@given(seed=seeds, beta=betas, n=st.integers(60, 300))
@settings(max_examples=40, deadline=None)
def test_terms_by_harmonics_are_those_of_the_covariance_matrix(seed, beta, n):
    angle, radius = star(n, seed)
    sums, log_beta = FourierSums(angle, radius), np.log(beta)
    order = needed_order(beta[1], n * beta[0] / beta[2])
    value, shift, gradient, hessian = harmonic_terms(*sums.up_to(order), sums.square_m2, n, order, log_beta)
    exact_value, exact_gradient, exact_hessian = likelihood_terms(chord(angle, angle), radius, log_beta)
    exact = log_marginal_likelihood(chord(angle, angle), radius, beta)
    scale = 1 + np.abs(exact_hessian).max()
    assert value == pytest.approx(exact_value, abs=3 * LIKELIHOOD_ERROR_NAT * scale)  # about that by truncation
    assert sums.mean_radius_m + shift == pytest.approx(exact.mu, abs=1e-6)
    np.testing.assert_allclose(gradient, exact_gradient, atol=1e-7 * scale)
    np.testing.assert_allclose(hessian, exact_hessian, atol=1e-6 * scale)  # of the harmonics left out


def test_sums_are_the_products_of_the_features():
    angle, radius = star(40, 1)
    gram, moment = FourierSums(angle, radius).up_to(7)
    feature = np.stack([np.ones(40), *[f(k * angle) for k in range(1, 8) for f in (np.cos, np.sin)]], axis=1)
    np.testing.assert_allclose(gram, feature.T @ feature, atol=1e-11)
    np.testing.assert_allclose(moment, feature.T @ (radius - radius.mean()), atol=1e-11)


@given(seed=seeds, n=st.integers(1, 150), beta=betas)
@settings(max_examples=80, deadline=None)
def test_likelihood_and_gradient_equal_the_exact_ones(seed, n, beta):
    angle, radius = star(n, seed)
    exact = log_marginal_likelihood(chord(angle, angle), radius, beta)
    fourier = log_marginal_likelihood_fourier(FourierSums(angle, radius), beta)
    condition = 1 + n * beta[0] / beta[2]
    assert fourier.value == pytest.approx(exact.value, rel=1e-9, abs=1e-6)
    assert fourier.mu == pytest.approx(exact.mu, abs=1e-12 * condition + 1e-9)
    by_log = np.abs(exact.gradient[1:] * beta)
    np.testing.assert_allclose(
        fourier.gradient[1:] * beta, exact.gradient[1:] * beta, atol=1e-5 + 1e-6 * by_log.max(), rtol=1e-5
    )


@pytest.mark.parametrize("length_scale", [0.1, 0.3, 1.0, 4.0])
def test_gradient_against_finite_differences(length_scale):
    sums = FourierSums(*star(200, 4))
    beta = np.array([0.2, length_scale**2, 0.01])

    def value(log_beta):
        return log_marginal_likelihood_fourier(sums, np.exp(log_beta)).value

    numerical = (approx_fprime(np.log(beta), value, 1e-5) + approx_fprime(np.log(beta), value, -1e-5)) / 2
    analytic = log_marginal_likelihood_fourier(sums, beta).gradient[1:] * beta
    np.testing.assert_allclose(analytic, numerical, atol=1e-5 * np.max(np.abs(analytic)) + 1e-5)


@given(seed=seeds, n=st.integers(3, 120), length_scale=st.floats(0.1, 8), noise=st.floats(0.05, 1))
@settings(max_examples=40, deadline=None)
def test_prediction_equals_the_exact_one(seed, n, length_scale, noise):
    angle, radius = star(n, seed)
    beta = np.array([0.3, length_scale**2, noise**2])
    mu = log_marginal_likelihood(chord(angle, angle), radius, beta).mu
    at = np.linspace(-4, 4, 60)
    exact = ExactPosterior.of(angle, radius, beta, mu).predict(at)
    fourier = FourierPosterior.of(FourierSums(angle, radius), beta, mu).predict(at)
    for found, expected in zip(fourier, exact, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_the_smaller_matrix_is_chosen():
    few, many = RadialData(*star(16, 0)), RadialData(*star(17, 0))
    assert few.is_exact(np.array([1.0, 4.0, 1.0]))
    assert not many.is_exact(np.array([1.0, 4.0, 1.0]))
    assert many.is_exact(np.array([1.0, 0.3**2, 1.0]))


@pytest.mark.parametrize("start", ["paper", "data"])
def test_fit_of_many_points_ends_where_the_exact_search_does(start, monkeypatch):
    angle, radius = star(120, 3)
    fast = fit_radial_gp(angle, radius, start)
    monkeypatch.setattr(RadialData, "is_exact", lambda data, beta: True)
    exact = fit_radial_gp(angle, radius, start)
    assert fast.log_likelihood == pytest.approx(exact.log_likelihood, abs=1e-4)
    at = np.linspace(-np.pi, np.pi, 90)
    np.testing.assert_allclose(fast.predict(at), exact.predict(at), atol=2e-4)
