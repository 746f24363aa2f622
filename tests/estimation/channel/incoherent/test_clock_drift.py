"""The drift of a clock during a sweep is found, removed, and part of the errors."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.incoherent.clock_drift import without_drift
from estimation.channel.incoherent.paths import fit_incoherent
from isac_arena.validation.scenarios.link_bench import draw_paths, make_bench, observe_paths, single_path
from sim.signal.hardware.impairments import apply_clock_drift

PPM = 0.05
SYMBOL_S = (1 + 144 / 2048) / 120e3


def sweep_of(seed: int, **impairments: float):
    bench = make_bench(seed, beam_phase_std_deg=60.0, **impairments)
    rng = np.random.default_rng(seed)
    paths = draw_paths(rng, bench.cell, strongest_db=(45.0, 50.0), pair_share=0.0)
    return observe_paths(bench, paths, 0).sweep, paths


@pytest.mark.parametrize("seed", [100, 101, 102])
def test_a_drift_is_found_and_its_error_is_known(seed: int) -> None:
    """Without correction delays are 0.1 - 0.4 ns late, a hundred times their errors."""
    sweep, paths = sweep_of(seed, clock_drift_ppm=PPM)
    fit = fit_incoherent(sweep)
    assert fit.drift_s == pytest.approx(PPM * 1e-6 * SYMBOL_S, rel=0.05)
    assert "drifts" in fit.caveat
    near = np.abs(fit.delay_s[:, None] - paths.delay_s).argmin(axis=0)
    error = (fit.delay_s[near] - paths.delay_s) / np.sqrt(fit.covariance[near, 0, 0])
    assert np.abs(error).max() < 4.0
    strong = np.argmax(paths.snr_db)
    assert abs(fit.delay_s[near[strong]] - paths.delay_s[strong]) < 40e-12


@pytest.mark.parametrize("seed", [100, 101, 102])
def test_a_steady_clock_is_left_alone(seed: int) -> None:
    fit = fit_incoherent(sweep_of(seed)[0])
    assert abs(fit.drift_s) * fit.pair_snr.size < 1e-12
    assert np.sqrt(fit.covariance[np.argmax(fit.snr_db), 0, 0]) < 5e-12


def test_one_path_alone_tells_no_small_drift() -> None:
    """A path that no fit knows shifts the delays of the pairs that both light, as a small drift does."""
    bench = make_bench(104, beam_phase_std_deg=60.0)
    sweep = observe_paths(bench, single_path(np.random.default_rng(104), 70.0), 0).sweep
    pairs = np.arange(np.prod(sweep.samples.shape[:2])).reshape(sweep.samples.shape[:2])
    bin_s = 1 / np.ptp(sweep.frequency_offset_hz)

    def drift_bins(added: float) -> float:
        late_s = added * bin_s * pairs / pairs.size
        turn = np.exp(-2j * np.pi * late_s[:, :, None] * sweep.frequency_offset_hz)
        fit = fit_incoherent(replace(sweep, samples=(sweep.samples * turn).astype(np.complex64)))
        return fit.drift_s * pairs.size / bin_s

    assert drift_bins(0.5) == pytest.approx(0.5, rel=0.1)
    assert abs(drift_bins(0.05)) < 0.02


def test_what_is_removed_is_what_a_fast_clock_adds() -> None:
    sweep, _ = sweep_of(103)
    samples = sweep.samples.copy()
    n_tx, n_rx = samples.shape[:2]
    time_s = SYMBOL_S * np.arange(n_tx * n_rx).reshape(n_tx, n_rx)
    apply_clock_drift(samples, time_s, PPM, sweep.frequency_offset_hz)
    steady = without_drift(replace(sweep, samples=samples), PPM * 1e-6 * SYMBOL_S)
    np.testing.assert_allclose(steady.samples, sweep.samples, atol=1e-5 * np.abs(sweep.samples).max())
