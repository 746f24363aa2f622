import numpy as np
import pytest
from scipy.stats import chi2, f, norm

from estimation.distributions import chi_square_log_density, chi_square_quantile, f_log_density, normal_log_density

VALUES = np.geomspace(1e-3, 50.0, 30)


@pytest.mark.parametrize("degrees", [1, 2, 3, 7.5, 400])
def test_chi_square_as_scipy_stats(degrees):
    shares = np.array([1e-6, 0.05, 0.5, 0.95, 0.999999])
    np.testing.assert_array_equal(chi_square_quantile(shares, degrees), chi2.ppf(shares, degrees))
    np.testing.assert_allclose(chi_square_log_density(VALUES, degrees), chi2.logpdf(VALUES, degrees), rtol=1e-12)


@pytest.mark.parametrize(("above", "below"), [(1.0, 2.0), (3.0, 7.5), (60.0, 4.0)])
def test_the_ratio_of_chi_squares_as_scipy_stats(above, below):
    np.testing.assert_allclose(f_log_density(VALUES, above, below), f.logpdf(VALUES, above, below), rtol=1e-11)


def test_the_normal_density_as_scipy_stats():
    np.testing.assert_allclose(normal_log_density(VALUES, 2.0, 0.3), norm(2.0, 0.3).logpdf(VALUES), rtol=1e-12)
