"""The marginal likelihood against its definition, its score against differences, its information against `crb`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ive

from estimation.channel.incoherent.grid_kernels import candidate_ratios, cell_amplitudes, column_maxima
from estimation.channel.incoherent.kernels import log_bessel
from estimation.channel.incoherent.likelihood import (
    LinkBeams,
    correlated_paths,
    likelihood_without,
    local_samples,
    log_likelihood_gradient,
    maximise_likelihood,
)
from estimation.channel.incoherent.second_path import _known, _probes, _score
from estimation.channel.incoherent.spectrum import delay_spectrum, delay_waves
from estimation.channel.model.crb import path_information
from estimation.channel.model.manifold import Manifold
from sim.config import ArrayConfig
from tests.estimation.channel.plain_sweeps import PlainPaths, plain_link, plain_sweep

K = 48
SPACING_HZ = 120e3
PATHS = np.array([[10.3, 0.2, -0.4, 0.0, 0.3], [10.9, 0.35, -0.3, -0.6, 2.0], [20.1, -0.5, 0.3, -1.2, -1.0]])


@pytest.fixture(scope="module")
def stop():
    """Three paths, two within a cell, seen by one panel and by two."""
    link = plain_link(
        ArrayConfig(columns=8, beams_per_panel=8, sector_deg=110.0),
        ArrayConfig(columns=4, beams_per_panel=3, sector_deg=110.0, panel_azimuth_deg=[-30.0, 60.0]),
        combine_symbols=False,
        comb=6,
    )
    link = replace(
        link, prs_symbol=link.prs_symbol[:, :K], frequency_offset_hz=(np.arange(K) - K // 2) * SPACING_HZ
    )
    gain = np.exp(PATHS[:, 3] + 1j * PATHS[:, 4])
    bin_s = 1 / (K * SPACING_HZ)
    plain = PlainPaths(PATHS[:, 0] * bin_s, PATHS[:, 1:2], PATHS[:, 2:3], gain)
    rng = np.random.default_rng(4)
    sweep = plain_sweep(link, plain, rng, 20.0)
    phasor = np.exp(2j * np.pi * rng.random(sweep.samples.shape[:2])).astype(np.complex64)
    sweep = replace(sweep, samples=sweep.samples * phasor[:, :, None])
    spectrum = delay_spectrum(sweep)
    ends = LinkBeams(Manifold(link.tx_codebook), Manifold(link.rx_codebook), spectrum.noise_mw)
    bins = np.arange(-6, K - 6)
    window = spectrum.window(bins)
    return sweep, spectrum, ends, local_samples(spectrum, window, bins, np.arange(len(window)), PATHS[:, 0])


def oracle(sweep, spectrum, ends, paths):
    """Log-likelihood ratio by its definition, subcarrier by subcarrier and pair by pair."""
    frequency = (np.arange(K) - (K - 1) / 2) * SPACING_HZ
    tx = ends.tx.response(paths[:, 1:2])
    rx = ends.rx.response(paths[:, 2:3])
    gain = np.exp(paths[:, 3] + 1j * paths[:, 4])
    total = 0.0
    for m in range(ends.tx.n_beams):
        for n in range(ends.rx.n_beams):
            received = sweep.samples[m, n].astype(complex) * sweep.prs_symbol[m].conj()
            mean = np.zeros(K, complex)
            for i in range(len(paths)):
                wave = np.exp(-2j * np.pi * frequency * paths[i, 0] * spectrum.bin_s)
                mean += gain[i] * tx[i, m] * rx[i, n] * wave
            z = abs(np.vdot(mean, received)) / spectrum.noise_mw[n]
            energy = np.vdot(mean, mean).real / spectrum.noise_mw[n]
            total += np.log(ive(0, 2 * z)) + 2 * z - energy
    return total


def test_the_likelihood_is_that_of_the_uncompressed_samples(stop):
    sweep, spectrum, ends, local = stop
    for shift in (0.0, 0.05):
        paths = PATHS + shift
        expected = oracle(sweep, spectrum, ends, paths)
        assert log_likelihood_gradient(local, ends, paths).value == pytest.approx(expected, rel=2e-5)


def test_the_score_is_the_slope_of_the_likelihood(stop):
    _, _, ends, local = stop
    at = log_likelihood_gradient(local, ends, PATHS)
    step = 1e-4
    for index in range(PATHS.size):
        shift = np.zeros(PATHS.size)
        shift[index] = step
        move = shift.reshape(PATHS.shape)
        slope = (
            log_likelihood_gradient(local, ends, PATHS + move).value
            - log_likelihood_gradient(local, ends, PATHS - move).value
        ) / (2 * step)
        assert at.gradient[index] == pytest.approx(slope, rel=2e-3, abs=0.05)


def test_the_information_is_that_of_the_bound(stop):
    sweep, spectrum, ends, local = stop
    centred = sweep.frequency_offset_hz - sweep.frequency_offset_hz.mean()
    bound = path_information(
        ends.tx, ends.rx, centred, spectrum.noise_mw, PATHS[:, 0] * spectrum.bin_s, PATHS[:, 1:2],
        PATHS[:, 2:3], np.exp(PATHS[:, 3] + 1j * PATHS[:, 4]), coherent=False,
    )  # fmt: skip
    scale = np.tile([spectrum.bin_s, 1, 1, 1, 1], len(PATHS))
    bound = bound.reshape(15, 15) * np.outer(scale, scale)
    root = np.sqrt(np.diagonal(bound))
    found = log_likelihood_gradient(local, ends, PATHS, faint=0.0).information
    assert np.abs((found - bound) / np.outer(root, root)).max() < 2e-3


def test_the_maximum_has_zero_score_and_exceeds_the_truth(stop):
    _, _, ends, local = stop
    start = PATHS + np.array([0.2, 0.02, -0.02, 0.1, 0.2])
    _, at, is_top = maximise_likelihood(local, ends, start)
    assert is_top
    assert at.value > log_likelihood_gradient(local, ends, PATHS).value
    root = np.sqrt(np.diagonal(at.information))
    assert np.abs(at.gradient / root).max() < 0.1


def test_score_of_a_probe_is_that_of_a_faint_path(stop):
    _, _, ends, local = stop
    paths, at, _ = maximise_likelihood(local, ends, PATHS)
    probes = _probes(ends, paths)[::7]
    pull, own, cross = _score(local, ends, _known(local, ends, paths), at, probes, np.arange(len(local.pair)))
    for i, probe in enumerate(probes):
        faint = probe.copy()
        amplitude = 1e-3 / np.sqrt(np.trace(own[i]))
        faint[-2] = np.log(amplitude)
        whole = log_likelihood_gradient(local, ends, np.vstack([paths, faint]), faint=0.0)
        n = paths.size
        assert pull[i] == pytest.approx(whole.gradient[n + 3 :] / amplitude, rel=0.01, abs=0.02 / amplitude * 1e-3)
        information = whole.information[n + 3 :, n + 3 :] / amplitude**2
        assert own[i] == pytest.approx(information, rel=2e-3, abs=2e-3 * np.abs(information).max())
        shared = whole.information[n + 3 :, :n] / amplitude
        assert cross[i] == pytest.approx(shared, rel=5e-3, abs=5e-3 * np.abs(shared).max())


@pytest.mark.parametrize("n_bins", [48, 49])
def test_waves_are_the_transform_of_a_delay(n_bins):
    bins, delays = np.arange(-5, n_bins - 5), np.array([0.0, 3.25, 7.0, 7.00003])
    frequency = np.arange(n_bins) - (n_bins - 1) / 2
    turns = np.exp(2j * np.pi / n_bins * frequency[:, None, None] * (bins[:, None] - delays))
    value, slope = delay_waves(bins, delays, n_bins)
    assert np.abs(turns.sum(axis=0) / np.sqrt(n_bins) - value).max() < 1e-7
    after, before = (delay_waves(bins, delays + step, n_bins)[0] for step in (1e-4, -1e-4))
    assert np.abs((after - before) / 2e-4 - slope).max() < 1e-4


def test_the_window_continues_beyond_the_period(stop):
    sweep, spectrum, *_ = stop
    frequency = (np.arange(K) - (K - 1) / 2)[:, None]
    bins = np.array([-3, 0, 5, K - 1, K + 2])
    expected = (
        (sweep.samples * sweep.prs_symbol.conj()[:, None])
        @ np.exp(2j * np.pi / K * frequency * bins)
        / np.sqrt(K * spectrum.noise_mw)[:, None]
    )
    assert np.abs(spectrum.window(bins) - expected.reshape(-1, len(bins))).max() < 1e-4


def test_bessel_functions():
    for x in (0.0, 1e-3, 0.5, 3.7, 3.8, 20.0, 1e4):
        value, ratio = log_bessel(x)
        assert value == pytest.approx(np.log(ive(0, x)) + x, rel=1e-6, abs=1e-6)
        assert ratio == pytest.approx(ive(1, x) / ive(0, x), rel=1e-6, abs=1e-12)


def test_cell_amplitudes_and_column_maxima():
    rng = np.random.default_rng(0)
    value = (rng.standard_normal((2, 3, 9)) + 1j * rng.standard_normal((2, 3, 9))).astype(np.complex64)
    scale = np.array([1.0, 2.0, 0.5], np.float32)
    out = np.empty((2, 3, 2, 8), np.float32)
    cell_amplitudes(value, scale, -1.0, out)
    full = np.abs(value[..., :-1]) * scale[:, None] - np.sqrt(np.pi) / 2
    half = np.abs(value[..., :-1] - value[..., 1:]) * scale[:, None] / np.sqrt(2) - np.sqrt(np.pi) / 2
    assert np.abs(out[:, :, 0] - full).max() < 1e-5
    assert np.abs(out[:, :, 1] - half).max() < 1e-5
    table = out.reshape(6, -1)
    largest, row = column_maxima(table)
    assert (largest == table.max(axis=0)).all()
    assert (row == table.argmax(axis=0)).all()


def test_fixed_paths_count_like_fitted_ones(stop):
    _, _, ends, local = stop
    whole = log_likelihood_gradient(local, ends, PATHS)
    beside = log_likelihood_gradient(local.with_fixed(ends, PATHS[1:], PATHS[:1, 0]), ends, PATHS[:1])
    assert beside.value == pytest.approx(whole.value, rel=1e-9)
    assert beside.pair_snr == pytest.approx(whole.pair_snr, rel=1e-9)
    assert beside.gradient == pytest.approx(whole.gradient[:5], rel=1e-6, abs=1e-6 * np.abs(whole.gradient).max())
    assert beside.information == pytest.approx(whole.information[:5, :5], rel=1e-6, abs=1e-6)


def test_the_brightest_pairs_hold_most_of_every_path(stop):
    _, _, ends, local = stop
    share = ends.energy_shares(PATHS)
    bright = ends.bright_pairs(PATHS, 0.9)
    assert (share[bright].sum(axis=0) >= 0.9).all() and 0 < bright.sum() < len(bright)
    strongest = ends.bright_pairs(PATHS[:1], 0.9)
    assert share[strongest, 0].min() >= share[~strongest, 0].max()
    whole, some = (log_likelihood_gradient(part, ends, PATHS) for part in (local, local.of_pairs(bright)))
    np.testing.assert_allclose(some.pair_value, whole.pair_value[bright[local.pair]], rtol=1e-9)


def test_the_likelihood_without_a_path_is_that_of_the_others(stop):
    _, _, ends, local = stop
    chosen = np.array([2, 0])
    found = likelihood_without(local, ends, PATHS, chosen)
    expected = [log_likelihood_gradient(local, ends, np.delete(PATHS, path, axis=0)).value for path in chosen]
    assert found == pytest.approx(expected, rel=1e-6)
    alone = likelihood_without(local, ends, PATHS[:1], np.array([0]))
    assert alone == pytest.approx([0.0], abs=1e-6)


def test_paths_far_apart_are_not_coupled(stop):
    _, _, ends, local = stop
    at = log_likelihood_gradient(local, ends, PATHS)
    assert correlated_paths(at, 3, 0, 0.1).tolist() == [False, True, False]
    assert correlated_paths(at, 3, 2, 0.1).tolist() == [False, False, False]


def test_candidates_have_their_likelihood_ratio():
    rng = np.random.default_rng(2)
    factors = np.linspace(0.5, 1.5, 5)
    tx, rx = (rng.standard_normal((2, n)) + 1j * rng.standard_normal((2, n)) for n in (3, 4))
    tx, rx = (part / np.linalg.norm(part, axis=1, keepdims=True) for part in (tx, rx))
    noise = rng.standard_normal((12, 2)) + 1j * rng.standard_normal((12, 2))
    shape = np.einsum("im,in->mni", tx, rx).reshape(12, 2)
    turns = np.exp(2j * np.pi * rng.random((12, 1)))
    matched = (6 * shape * turns + noise).astype(np.complex64)
    unknown, known = np.zeros(12, complex), 0.99 * turns[:, 0]
    amplitude, _, ratio = candidate_ratios(tx, rx, matched, unknown.copy(), factors, 0.0, 0.5)
    share, received = np.abs(shape[:, 0]), np.abs(matched[:, 0]).astype(float)
    trial = (share @ received) * factors[:, None] * share
    expected = (np.log(ive(0, 2 * trial * received)) + 2 * trial * received - trial**2).sum(axis=1)
    assert ratio[0] == pytest.approx(expected.max(), rel=1e-5)
    assert amplitude[0] == pytest.approx((share @ received) * factors[expected.argmax()], rel=1e-5)
    amplitude, phase, ratio = candidate_ratios(tx, rx, matched, known.copy(), factors, 0.0, 0.5)
    in_phase = np.vdot(shape[:, 0] * known, matched[:, 0])
    assert ratio[0] == pytest.approx(max(expected.max(), abs(in_phase) ** 2), rel=1e-5)
    assert phase[0] == pytest.approx(np.angle(in_phase), abs=1e-5)


def test_phases_are_known_in_the_beam_pairs_of_other_paths() -> None:
    link = plain_link()
    ends = LinkBeams(Manifold(link.tx_codebook), Manifold(link.rx_codebook), np.ones(len(link.rx_codebook)))
    lone = np.array([[10.0, 0.5, -0.4, 0.0, 0.0]])
    assert ends.known_phase_shares(lone, K) == pytest.approx(0.0)
    beside = np.concatenate([lone, [[30.0, 0.5, -0.4, 3.0, 1.0]]])
    aside = np.concatenate([lone, [[10.0, -0.7, 0.6, -1.0, 1.0]]])
    assert ends.known_phase_shares(beside, K)[0] > 0.99
    power = K * np.square(np.abs(ends.amplitudes(aside)))
    known = power[:, 1] / (power[:, 1] + 0.5)
    assert ends.known_phase_shares(aside, K)[0] == pytest.approx(known @ power[:, 0] / power[:, 0].sum())
    assert ends.known_phase_shares(aside, K)[0] < 0.5
