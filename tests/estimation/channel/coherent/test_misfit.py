"""The quadrature of the derivatives: chi-square in noise, as large as the error by an undetected neighbour."""

import numpy as np
import pytest
from scipy.stats import chi2

from estimation.channel.coherent.misfit import error_scale, quadrature_statistic
from estimation.channel.coherent.refine import Reference, Solution, marginal_covariances, refine_paths
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
    factor = np.array([error_scale(shown[k : k + 4], np.full(4, 3))[0] for k in range(0, N_TRIALS, 4)])
    assert np.mean(factor > 1) <= 0.1


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


def test_the_scales_of_a_stop_are_learned_from_all_its_paths() -> None:
    """Drawn scales: the posterior mean is nearer to them than the typical scale or the statistic of one path."""
    rng = np.random.default_rng(3)
    true = 4.0 * 6 / rng.chisquare(6, 300)
    shown, seen = true * rng.chisquare(3, 300), np.full(300, 3)
    found = error_scale(shown, seen)
    away = [np.abs(np.log(guess / true)).mean() for guess in (found, np.maximum(shown / 3, 1), np.full(300, 4.0))]
    assert away[0] < min(away[1:])
    assert np.mean(true / found) == pytest.approx(1, abs=0.2)
    assert (found[np.argsort(shown)][1:] >= found[np.argsort(shown)][:-1]).all()


def test_noise_and_unobservable_shifts_have_scale_one() -> None:
    rng = np.random.default_rng(4)
    assert (error_scale(rng.chisquare(3, 50), np.full(50, 3)) == 1).all()
    assert (error_scale(np.zeros(2), np.zeros(2, int)) == 1).all()
    assert len(error_scale(np.zeros(0), np.zeros(0, int))) == 0
