from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.coherent.paths import fit_coherent
from sim.config import ArrayConfig
from tests.estimation.channel.plain_sweeps import (
    CHI2_95,
    places,
    plain_bounds,
    plain_link,
    plain_paths,
    plain_sweep,
)

SMALL = plain_link()


def test_snr_and_amplitude_are_in_the_units_of_the_record() -> None:
    noise_mw = 4e-9
    paths = plain_paths(SMALL, 85.0, 10.0, -20.0, 30.0, noise_mw=noise_mw)
    fit = fit_coherent(plain_sweep(SMALL, paths, np.random.default_rng(1), noise_mw))
    assert np.isclose(fit.snr_db[0], 30.0, atol=0.7)
    assert np.isclose(fit.amplitude[0], abs(paths.amplitude[0]), rtol=0.08)


def test_errors_reach_the_bound_and_covariances_are_honest() -> None:
    """Three separate paths, 80 stops: 240 errors hold RMSE / CRB to 5 % and NEES / 3 to 5 % (one sigma)."""
    rng = np.random.default_rng(2)
    scaled, nees = [], []
    for _ in range(80):
        paths = plain_paths(
            SMALL, [30.0, 130.0, 260.0], rng.uniform(-45, 45, 3), rng.uniform(-45, 45, 3),
            rng.uniform(15, 35, 3), phase=rng.uniform(0, 6.28, 3),
        )  # fmt: skip
        fit = fit_coherent(plain_sweep(SMALL, paths, rng))
        assert len(fit) == 3
        error = places(fit) - places(paths)
        scaled.append(error / plain_bounds(SMALL, paths).std)
        nees.append(np.einsum("pa,pab,pb->p", error, np.linalg.inv(fit.covariance), error))
    ratio = np.sqrt((np.concatenate(scaled) ** 2).mean(axis=0))
    assert ratio.max() < 1.15
    assert ratio.mean() < 1.08
    assert abs(np.mean(nees) / 3 - 1) < 0.18
    assert 0.91 < (np.concatenate(nees) < CHI2_95).mean() < 0.985


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_two_equal_paths_half_a_cell_apart_are_two(axis: int) -> None:
    """Cells of 1 / bandwidth and 2 / 8 in the sine of an angle."""
    cell = [1e9 / (288 * 120e3), 2 / 8, 2 / 8][axis]
    offset = np.array([-0.25, 0.25]) * cell
    places = [np.full(2, 150.0), np.zeros(2), np.zeros(2)]
    places[axis] = places[axis] + (offset if axis == 0 else np.rad2deg(np.arcsin(offset)))
    rng = np.random.default_rng(4 + axis)
    counts = []
    for phase in np.linspace(0, 2 * np.pi, 12, endpoint=False):
        paths = plain_paths(SMALL, *places, 30.0, phase=[0.0, phase])
        counts.append(len(fit_coherent(plain_sweep(SMALL, paths, rng))))
    assert np.mean(np.array(counts) == 2) >= 0.9


def test_a_weak_second_path_is_found_at_its_place() -> None:
    """A path 18 dB below one two thirds of a cell away: found near the truth, not in a side maximum."""
    rng = np.random.default_rng(5)
    found = 0
    for _ in range(15):
        phase = rng.uniform(0, 6.28, 2)
        paths = plain_paths(SMALL, [150.0, 163.0], [5.0, 12.0], [0.0, -3.0], [38.0, 20.0], phase=phase)
        fit = fit_coherent(plain_sweep(SMALL, paths, rng))
        error = places(fit)[:, None] - places(paths)
        std = np.sqrt(np.einsum("paa->pa", plain_bounds(SMALL, paths).covariance))
        found += len(fit) == 2 and bool((np.abs(error / std) < 5).all(axis=2).any(axis=0).all())
    assert found >= 14


def test_a_late_path_is_found_outside_the_window() -> None:
    link = plain_link(n_rb=132)
    paths = plain_paths(link, [20.0, 5000.0], [0.0, 20.0], [0.0, -10.0], [40.0, 25.0])
    fit = fit_coherent(plain_sweep(link, paths, np.random.default_rng(6)))
    assert np.allclose(fit.delay_s, paths.delay_s, atol=2e-9)


def test_comb_of_one_symbol_is_enough() -> None:
    link = plain_link(combine_symbols=False, comb=6)
    paths = plain_paths(link, [20.0, 120.0], [0.0, 20.0], [0.0, -10.0], [35.0, 30.0])
    fit = fit_coherent(plain_sweep(link, paths, np.random.default_rng(7)))
    assert np.allclose(fit.delay_s, paths.delay_s, atol=3e-9)


def test_noise_powers_may_differ_between_beams() -> None:
    rng = np.random.default_rng(8)
    noise_mw = np.geomspace(0.2, 5.0, 10)
    nees = []
    for _ in range(40):
        paths = plain_paths(SMALL, [80.0], [12.0], [rng.uniform(-40, 40)], [25.0])
        fit = fit_coherent(plain_sweep(SMALL, paths, rng, noise_mw))
        error = (places(fit) - places(paths))[0]
        nees.append(error @ np.linalg.inv(fit.covariance[0]) @ error)
    assert 0.65 < np.mean(nees) / 3 < 1.4


def test_with_one_beam_the_angle_is_unobservable() -> None:
    link = plain_link(ArrayConfig(columns=8, beams_per_panel=1))
    paths = plain_paths(link, [80.0, 150.0], [0.0, 0.0], [0.0, 20.0], [40.0, 35.0])
    fit = fit_coherent(plain_sweep(link, paths, np.random.default_rng(10)))
    assert np.allclose(fit.delay_s, paths.delay_s, atol=1e-9)
    assert np.allclose(fit.aoa_rad, paths.aoa_rad, atol=0.01)
    assert np.allclose(fit.covariance[:, 1, 1], np.pi**2 / 3, rtol=1e-2)
    assert (fit.covariance[:, 2, 2] < 1e-4).all()


def test_with_beams_of_rank_one_angles_are_unobservable() -> None:
    """The same beam ten times over at both ends."""
    books = [replace(b, weights=b.weights[[4] * 10]) for b in (SMALL.tx_codebook, SMALL.rx_codebook)]
    link = replace(SMALL, tx_codebook=books[0], rx_codebook=books[1])
    fit = fit_coherent(
        plain_sweep(link, plain_paths(link, [80.0], [0.0], [0.0], [40.0]), np.random.default_rng(11))
    )
    assert np.allclose(fit.delay_s, 80e-9, atol=1e-9)
    assert (fit.covariance[0, [1, 2], [1, 2]] > 3).all()


def test_few_samples_determine_few_paths() -> None:
    """One beam each and 24 subcarriers hold 48 numbers: no fit of 20 paths of 5."""
    one = ArrayConfig(columns=8, beams_per_panel=1)
    link = plain_link(one, one, combine_symbols=False, comb=12)
    rng = np.random.default_rng(13)
    paths = plain_paths(
        link, rng.uniform(0, 600, 20), np.zeros(20), np.zeros(20), 40.0, phase=rng.uniform(0, 6, 20)
    )
    fit = fit_coherent(plain_sweep(link, paths, rng))
    assert 1 <= len(fit) <= 8
    assert np.isfinite(fit.covariance).all()


def test_bad_samples_are_refused_in_one_line() -> None:
    sweep = plain_sweep(SMALL, plain_paths(SMALL, 80.0, 0.0, 0.0, 30.0))
    samples = sweep.samples.copy()
    samples[0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="samples must be finite"):
        fit_coherent(replace(sweep, samples=samples))
    with pytest.raises(ValueError, match="2 subcarriers"):
        fit_coherent(sweep.take("subcarrier", slice(0, 0)))
