import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime
from scipy.stats import multivariate_normal

from estimation.shape.gp.exact import chord, log_marginal_likelihood
from estimation.shape.gp.radial import fit_radial_gp

NOISE_STD_M = 0.1


def rectangle(angle):
    return 1 / np.maximum(np.abs(np.cos(angle)) / 2, np.abs(np.sin(angle)) / 1.5)


SHAPES = {
    "circle": lambda angle: np.full_like(angle, 2.0),
    "ellipse": lambda angle: 1 / np.hypot(np.cos(angle) / 2.5, np.sin(angle) / 1.5),
    "rectangle": rectangle,
    "star": lambda angle: 2 + 0.4 * np.cos(5 * angle),
}


def contour_points(shape, n, rng):
    angle = rng.uniform(-np.pi, np.pi, n)
    return angle, SHAPES[shape](angle) + NOISE_STD_M * rng.standard_normal(n)


def dense_covariance(angle_a, angle_b, beta):
    """The kernel as printed, entry by entry."""
    signal_variance, length_squared, _ = beta
    return np.array(
        [
            [signal_variance * np.exp(-2 * np.sin(abs(a - b) / 2) ** 2 / length_squared) for b in angle_b]
            for a in angle_a
        ]
    )


def dense_prediction(angle, radius, beta, mean_uncertainty, test_angle):
    """The predictive equations with explicit inverses, mu by generalised least squares."""
    inverse = np.linalg.inv(dense_covariance(angle, angle, beta) + beta[2] * np.eye(len(angle)))
    ones = np.ones(len(angle))
    mu = ones @ inverse @ radius / (ones @ inverse @ ones)
    cross = dense_covariance(test_angle, angle, beta)
    mean = mu + cross @ inverse @ (radius - mu)
    variance = np.diag(dense_covariance(test_angle, test_angle, beta) - cross @ inverse @ cross.T)
    if mean_uncertainty:
        variance = variance + (1 - cross @ inverse @ ones) ** 2 / (ones @ inverse @ ones)
    return mu, mean, np.sqrt(variance)


betas = st.tuples(st.floats(0.01, 10), st.floats(0.05, 10), st.floats(0.005, 2))
seeds = st.integers(0, 2**32 - 1)


@given(seed=seeds, n=st.integers(1, 20), mu=st.floats(-3, 3), beta=betas)
@settings(max_examples=50, deadline=None)
def test_likelihood_is_the_normal_density(seed, n, mu, beta):
    angle, radius = contour_points("ellipse", n, np.random.default_rng(seed))
    found = log_marginal_likelihood(chord(angle, angle), radius, beta, mu)
    covariance = dense_covariance(angle, angle, beta) + beta[2] * np.eye(n)
    expected = multivariate_normal(np.full(n, mu), covariance).logpdf(radius)
    assert found.mu == mu
    assert found.value == pytest.approx(expected, rel=1e-8, abs=1e-8)


@given(seed=seeds, n=st.integers(1, 20), mu=st.floats(-3, 3), beta=betas)
@settings(max_examples=50, deadline=None)
def test_gradient_against_finite_differences(seed, n, mu, beta):
    angle, radius = contour_points("star", n, np.random.default_rng(seed))
    chords = chord(angle, angle)

    def value(parameters):
        return log_marginal_likelihood(chords, radius, parameters[1:], parameters[0]).value

    point = np.array([mu, *beta])
    step = 1e-6 * np.maximum(np.abs(point), 0.1)
    numerical = (approx_fprime(point, value, step) + approx_fprime(point, value, -step)) / 2
    analytic = log_marginal_likelihood(chords, radius, beta, mu).gradient
    np.testing.assert_allclose(analytic, numerical, rtol=1e-4, atol=1e-4 * np.max(np.abs(analytic)) + 1e-5)


@given(seed=seeds, n=st.integers(1, 20), beta=betas, offset=st.floats(-0.5, 0.5))
@settings(max_examples=50, deadline=None)
def test_profiled_mean_is_the_most_likely_one(seed, n, beta, offset):
    angle, radius = contour_points("star", n, np.random.default_rng(seed))
    best = log_marginal_likelihood(chord(angle, angle), radius, beta)
    other = log_marginal_likelihood(chord(angle, angle), radius, beta, best.mu + offset)
    assert other.value <= best.value + 1e-9 * abs(best.value)
    assert abs(best.gradient[0]) < 1e-8 * n / beta[2]


@pytest.mark.parametrize("start", ["paper", "data"])
@pytest.mark.parametrize("shape", SHAPES)
def test_fit_is_a_stationary_point(shape, start):
    angle, radius = contour_points(shape, 40, np.random.default_rng(3))
    gp = fit_radial_gp(angle, radius, start)
    beta = np.array([gp.signal_std_m, gp.length_scale, gp.noise_std_m]) ** 2
    at_fit = log_marginal_likelihood(chord(angle, angle), radius, beta, gp.mean_m)
    assert at_fit.value == pytest.approx(gp.log_likelihood)
    for j, factor in [(j, factor) for j in range(3) for factor in (0.98, 1.02)]:
        moved = np.where(np.arange(3) == j, factor * beta, beta)
        near = log_marginal_likelihood(chord(angle, angle), radius, moved)
        assert near.value < at_fit.value + 1e-4


@pytest.mark.parametrize("mean_uncertainty", [False, True])
@pytest.mark.parametrize("n", [2, 7, 40])
def test_prediction_against_dense_equations(n, mean_uncertainty):
    angle, radius = contour_points("ellipse", n, np.random.default_rng(n))
    gp = fit_radial_gp(angle, radius, mean_uncertainty=mean_uncertainty, noise_floor_std_m=0.05)
    beta = np.array([gp.signal_std_m, gp.length_scale, gp.noise_std_m]) ** 2
    test_angle = np.concatenate([angle, np.linspace(-4, 4, 50)])
    mu, mean, std = dense_prediction(angle, radius, beta, mean_uncertainty, test_angle)
    found_mean, found_std = gp.predict(test_angle)
    assert gp.mean_m == pytest.approx(mu)
    np.testing.assert_allclose(found_mean, mean, rtol=1e-7)
    np.testing.assert_allclose(found_std, std, rtol=1e-5, atol=1e-6)


def test_prediction_has_the_period_of_the_circle():
    gp = fit_radial_gp(*contour_points("rectangle", 30, np.random.default_rng(5)))
    angle = np.linspace(-np.pi, np.pi, 20)
    for turned in (angle + 2 * np.pi, angle - 4 * np.pi):
        np.testing.assert_allclose(gp.predict(turned), gp.predict(angle), rtol=1e-9)


@given(turn=st.floats(-10, 10), scale=st.floats(0.2, 5), start=st.sampled_from(["paper", "data"]))
@settings(max_examples=25, deadline=None)
def test_rotation_turns_the_contour(turn, scale, start):
    angle, radius = contour_points("ellipse", 32, np.random.default_rng(8))
    turned = np.angle(np.exp(1j * (angle + turn)))
    test_angle = np.linspace(-np.pi, np.pi, 30)
    straight = fit_radial_gp(angle, scale * radius, start).predict(test_angle)
    rotated = fit_radial_gp(turned, scale * radius, start).predict(test_angle + turn)
    np.testing.assert_allclose(rotated, straight, atol=2e-4 * scale)


def test_data_start_is_at_least_as_likely_where_the_paper_start_sticks():
    stuck = 0
    for seed in range(20):
        angle, radius = contour_points("star", 48, np.random.default_rng(seed))
        paper, data = fit_radial_gp(angle, radius, "paper"), fit_radial_gp(angle, radius, "data")
        assert data.log_likelihood >= paper.log_likelihood - 1e-6
        assert data.noise_std_m < 0.2
        stuck += paper.noise_std_m > 0.2
    assert stuck >= 12


def test_noise_floor_holds():
    angle, radius = contour_points("star", 6, np.random.default_rng(0))
    assert fit_radial_gp(angle, radius, noise_floor_std_m=0.1).noise_std_m >= 0.1 * (1 - 1e-12)
    assert fit_radial_gp(angle, radius, noise_floor_std_m=1e3).noise_std_m == pytest.approx(1e3)


@pytest.mark.parametrize(("start", "noise_floor_std_m"), [("paper", 0.0), ("data", NOISE_STD_M)])
def test_interval_covers_circles_only_with_the_uncertainty_of_the_mean(start, noise_floor_std_m):
    n_runs = 100
    covered = {True: [], False: []}
    for seed in range(n_runs):
        angle, radius = contour_points("circle", 32, np.random.default_rng(seed))
        for mean_uncertainty in (True, False):
            gp = fit_radial_gp(angle, radius, start, mean_uncertainty, noise_floor_std_m)
            mean, std = gp.predict(angle)
            covered[mean_uncertainty].append(np.mean(np.abs(mean - 2.0) <= 2 * std))
    monte_carlo = 3 * np.std(covered[True]) / np.sqrt(n_runs)
    assert 0.93 - monte_carlo < np.mean(covered[True]) < 0.96 + monte_carlo
    assert np.mean(covered[False]) < 0.5


@pytest.mark.parametrize("start", ["paper", "data"])
@pytest.mark.parametrize(
    ("angle", "radius"),
    [
        ([0.0], [0.0]),
        ([1.0], [2.0]),
        ([1.0, 1.0], [2.0, 2.0]),
        ([1.0, 1.0], [2.0, 2.5]),
        ([-np.pi, np.pi], [1.0, 1.0]),
        ([-2.0, 0.5, 3.0], [1.0, 4.0, 2.0]),
        ([0.0] * 6, [0.0] * 6),
        ([0.3] * 6, [5.0] * 6),
        ([0.0, np.pi] * 20, [1e-5, 300.0] * 20),
    ],
)
def test_tiny_and_degenerate_clusters_give_finite_contours(angle, radius, start):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gp = fit_radial_gp(np.array(angle), np.array(radius), start)
        mean, std = gp.predict(np.linspace(-np.pi, np.pi, 36))
    assert np.all(np.isfinite([mean, std]))
    assert np.all(std >= 0)
    assert np.isfinite(gp.log_likelihood)


@pytest.mark.parametrize(("angle", "radius"), [([], []), ([1.0, 2.0], [1.0])])
def test_wrong_input_is_named(angle, radius):
    with pytest.raises(ValueError, match=f"{len(angle)} angles and {len(radius)} radii"):
        fit_radial_gp(np.array(angle), np.array(radius))


# Mean over the runs of the RMSE (m) at the training angles against the number of points, 1,000 runs of an
# independent implementation with noise 0.1 m, uniform angles and a known centre.
N_POINTS = (4, 8, 16, 32, 64, 128)
REFERENCE_RMSE_M = {
    ("paper", "circle"): (0.055, 0.038, 0.025, 0.017, 0.011, 0.008),
    ("paper", "ellipse"): (0.203, 0.177, 0.075, 0.055, 0.041, 0.030),
    ("paper", "rectangle"): (0.193, 0.201, 0.107, 0.074, 0.060, 0.049),
    ("paper", "star"): (0.197, 0.224, 0.235, 0.233, 0.264, 0.249),
    ("data", "circle"): (0.062, 0.057, 0.042, 0.027, 0.017, 0.010),
    ("data", "ellipse"): (0.136, 0.090, 0.073, 0.055, 0.041, 0.030),
    ("data", "rectangle"): (0.145, 0.102, 0.087, 0.073, 0.060, 0.049),
    ("data", "star"): (0.157, 0.112, 0.088, 0.071, 0.052, 0.037),
}


def check_against_reference(start, shape, n_points, n_runs):
    """Mean RMSE equals the reference within 3 standard errors and 10 %.

    The 10 % are for the searches: which of several optima a start ends in depends on the bounds and on the
    path of the optimiser, above all where the paper's start sticks in some of the runs.
    """
    rng = np.random.default_rng(2024)
    rmse = []
    for _ in range(n_runs):
        angle, radius = contour_points(shape, n_points, rng)
        mean, _ = fit_radial_gp(angle, radius, start).predict(angle)
        rmse.append(np.sqrt(np.mean((mean - SHAPES[shape](angle)) ** 2)))
    expected = REFERENCE_RMSE_M[start, shape][N_POINTS.index(n_points)]
    tolerance = 3 * np.std(rmse) / np.sqrt(n_runs) + 0.1 * expected
    assert np.mean(rmse) == pytest.approx(expected, abs=tolerance)


@pytest.mark.parametrize("n_points", [16, 64])
@pytest.mark.parametrize(("start", "shape"), REFERENCE_RMSE_M)
def test_rmse_against_reference(start, shape, n_points):
    check_against_reference(start, shape, n_points, n_runs=40)


@pytest.mark.slow
@pytest.mark.parametrize("n_points", N_POINTS)
@pytest.mark.parametrize(("start", "shape"), REFERENCE_RMSE_M)
def test_rmse_against_reference_in_full(start, shape, n_points):
    check_against_reference(start, shape, n_points, n_runs=1000)
