import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

from isac_arena.scoring.metrics.consistency import (
    gaussian_crps,
    normalised_nees,
    region_coverage,
    share_with_interval,
)

COVARIANCE = np.array([[4e-18, 1e-10], [1e-10, 9e-2]])


def drawn(count, scale=1.0, seed=3):
    return scale * np.random.default_rng(seed).multivariate_normal(np.zeros(2), COVARIANCE, count)


def test_consistent_errors_are_found_consistent_and_others_not():
    covariance = np.tile(COVARIANCE, (4000, 1, 1))
    nees = normalised_nees(drawn(4000), covariance)
    assert nees.low < nees.value < nees.high
    assert region_coverage(drawn(4000), covariance).value == pytest.approx(0.95, abs=0.015)
    proud = normalised_nees(drawn(4000, 2.0), covariance)
    assert proud.value == pytest.approx(4 * nees.value)
    assert proud.value > proud.high
    assert region_coverage(drawn(4000, 2.0), covariance).high < 0.9


def test_nothing_to_judge_is_not_a_number():
    nothing = normalised_nees(np.zeros((0, 2)), np.zeros((0, 2, 2)))
    assert np.isnan([nothing.value, nothing.low, nothing.high, share_with_interval(np.zeros(0, bool)).value]).all()


def test_share_has_the_wilson_interval():
    found = share_with_interval(np.arange(20) < 18)
    z, p, n = norm.ppf(0.975), 0.9, 20
    middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    assert (found.value, found.low, found.high) == pytest.approx((0.9, middle - half, middle + half))


@given(st.floats(-3, 3), st.floats(-2, 2), st.floats(0.1, 2))
def test_crps_is_the_integral_of_its_definition(truth, mean, std):
    below, _ = quad(lambda x: norm.cdf(x, mean, std) ** 2, -20, truth, points=[mean], limit=200)
    above, _ = quad(lambda x: norm.sf(x, mean, std) ** 2, truth, 20, points=[mean], limit=200)
    assert gaussian_crps(np.array(truth), np.array(mean), np.array(std)) == pytest.approx(below + above, abs=1e-6)


def test_crps_of_a_certain_prediction_is_its_distance():
    np.testing.assert_allclose(gaussian_crps(np.array([1.0, 2.0]), np.array(0.5), np.array(0.0)), [0.5, 1.5])
    with pytest.raises(ValueError, match="std"):
        gaussian_crps(np.zeros(1), np.zeros(1), np.array([-1.0]))
