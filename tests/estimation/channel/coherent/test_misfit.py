"""The quadrature of the derivatives: chi-square in noise, as large as the error by an undetected neighbour."""

import numpy as np
from scipy.stats import chi2

from estimation.channel.coherent.misfit import (
    UNRESOLVED_CELLS,
    misfit_factor,
    quadrature_statistic,
    widen_covariances,
)
from estimation.channel.coherent.refine import Reference, Solution, marginal_covariances, refine_paths
from estimation.channel.model.manifold import CELL
from estimation.channel.model.path_model import PathParameters
from tests.estimation.channel.plain_sweeps import compressed, places, plain_link, plain_paths, plain_sweep

SMALL = plain_link()
N_TRIALS = 120


def _fit_one(rng: np.random.Generator, neighbour_db: float | None) -> tuple[Reference, Solution, np.ndarray]:
    """One fitted path of 40 dB, with or without a neighbour a sixth of a cell away on every axis; its error."""
    delay_ns = np.array([200.0, 205.0])
    snr_db = [40.0, 40.0 + (neighbour_db or 0.0)]
    phase = rng.uniform(0, 2 * np.pi, 2)
    paths = plain_paths(SMALL, delay_ns, [5.0, 7.4], [-9.0, -6.6], snr_db, phase=phase)
    n = 1 if neighbour_db is None else 2
    some = type(paths)(paths.delay_s[:n], paths.aod_rad[:n], paths.aoa_rad[:n], paths.amplitude[:n])
    sweep = compressed(plain_sweep(SMALL, some, rng))
    start = PathParameters(
        paths.delay_s[:1] / sweep.bin_s, paths.aod_rad[:1], paths.aoa_rad[:1], paths.amplitude[:1]
    )
    solution = refine_paths(Reference(sweep, start.take(slice(0))), start, 30)
    found = solution.paths
    error = np.concatenate([found.delay_bins * sweep.bin_s, found.aod_rad[0], found.aoa_rad[0]]) - places(paths)[0]
    error[0] /= sweep.bin_s
    return Reference(sweep, found), solution, error


def test_quadrature_in_noise_is_chi_square_and_widens_nothing() -> None:
    rng = np.random.default_rng(1)
    fits = [_fit_one(rng, None) for _ in range(N_TRIALS)]
    shown = np.array([quadrature_statistic(reference, fit)[0][0] for reference, fit, _ in fits])
    assert abs(shown.mean() - 3) < 4 * np.sqrt(6 / N_TRIALS)
    assert abs(np.mean(shown < chi2.median(3)) - 0.5) < 4 * np.sqrt(0.25 / N_TRIALS)
    factor = np.array([misfit_factor(reference, fit)[0] for reference, fit, _ in fits])
    assert np.mean(factor > 1) <= 0.02


def test_an_unresolved_neighbour_has_a_misfit_as_large_as_its_shift() -> None:
    rng = np.random.default_rng(2)
    plain, shown = [], []
    for _ in range(N_TRIALS):
        reference, fit, error = _fit_one(rng, -10.0)
        covariance = marginal_covariances(fit, reference.sweep.n_subcarriers)[0]
        plain.append(error @ np.linalg.solve(covariance, error))
        shown.append(quadrature_statistic(reference, fit)[0][0])
    assert np.mean(plain) > 30
    assert 0.5 < np.mean(shown) / np.mean(plain) < 2


def test_the_misfit_widens_by_its_factor_up_to_the_error_of_a_neighbour() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(5, 3, 3))
    rate = rng.uniform(0.5, 20.0, (5, 3))
    half = UNRESOLVED_CELLS / 2 * CELL / rate
    shape = (root @ np.swapaxes(root, 1, 2) + np.eye(3)) * half[:, :, None] * half[:, None]
    small, factor = 1e-9 * shape, np.array([1.0, 3.0, 30.0, 1e3, 1e15])
    wide = widen_covariances(small, factor, rate)
    np.testing.assert_array_equal(wide[0], small[0])
    np.testing.assert_allclose(wide[1:4], small[1:4] * factor[1:4, None, None], rtol=1e-4)
    np.testing.assert_allclose(wide[4], np.diag(half[4] ** 2), atol=1e-4 * np.outer(half[4], half[4]).max())
    own = 100 * shape[:1]
    np.testing.assert_allclose(widen_covariances(own, np.ones(1), rate[:1]), own)  # noise may be wider than a cell


def test_an_unobservable_parameter_is_widened_by_its_full_factor() -> None:
    wide = widen_covariances(np.eye(3)[None], np.array([4.0]), np.array([[1e9, 1e9, 0.0]]))
    np.testing.assert_allclose(np.diagonal(wide[0]), [1.0, 1.0, 4.0], rtol=1e-6)
