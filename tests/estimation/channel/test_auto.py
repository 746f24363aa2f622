from dataclasses import replace

import numpy as np
import pytest

from estimation.channel import auto
from estimation.channel.auto import fit_auto
from estimation.channel.coherent.diffuse import fit_over_background
from estimation.channel.coherent.paths import fit_coherent
from estimation.channel.incoherent.paths import fit_incoherent
from estimation.channel.phases.pairs import phases_against, phases_of
from estimation.channel.phases.ramp import fit_phase_ramp, without_phase_ramp
from scenes.record import FloatArray
from sim.config import WaveformConfig
from sim.observation import BeamSweep
from sim.signal.waveform.occasions import sweep_occasions
from tests.estimation.channel.plain_sweeps import no_plain_paths, plain_link, plain_paths, plain_sweep

SMALL = plain_link()
PATHS = plain_paths(
    SMALL, [30.0, 130.0, 131.0], [-20.0, 20.0, 40.0], [5.0, 25.0, -35.0], [33.0, 27.0, 24.0], phase=[0, 1, 2]
)


def with_phases(phase_rad: FloatArray, seed: int = 1) -> BeamSweep:
    sweep = plain_sweep(SMALL, PATHS, np.random.default_rng(seed))
    return replace(sweep, samples=sweep.samples * np.exp(1j * phase_rad)[:, :, None])


@pytest.mark.parametrize("offset_hz", [0.0, 150.0, -1500.0, 20e3])
def test_a_frequency_offset_is_estimated_and_removed(offset_hz: float) -> None:
    times = sweep_occasions(WaveformConfig(), 10, 10).time_s[0]
    chosen = fit_auto(with_phases(2 * np.pi * offset_hz * times))
    assert chosen.mode == "coherent"
    assert chosen.frequency_offset_hz == pytest.approx(offset_hz, abs=60)
    assert np.rad2deg(chosen.ramp.residual_rad) < 4
    assert len(chosen.fit) == 3
    assert np.allclose(chosen.fit.delay_s, PATHS.delay_s, atol=5e-10)
    assert np.isfinite(chosen.fit.phase_rad).all()
    assert chosen.reason.startswith("coherent: phases of ")


def test_a_sweep_may_go_through_the_tx_beams_first() -> None:
    chosen = fit_auto(with_phases(0.02 * np.arange(10)[:, None] + 0.2 * np.arange(10)))
    assert chosen.mode == "coherent"
    assert chosen.ramp.tx_step_rad == pytest.approx(0.02, abs=0.03)
    assert chosen.ramp.rx_step_rad == pytest.approx(0.2, abs=0.03)


def test_random_phases_stay_incoherent() -> None:
    phase = np.random.default_rng(2).uniform(-np.pi, np.pi, (10, 10))
    chosen = fit_auto(with_phases(phase))
    fit, reason = chosen.fit, chosen.reason
    assert reason.startswith("incoherent: ")
    assert len(fit) == 3
    assert np.isnan(fit.phase_rad).all()


@pytest.mark.parametrize(("step_deg", "mode"), [(5.0, "tracked"), (45.0, "incoherent")])
def test_wandering_phases_are_tracked_where_neighbours_tell_them(step_deg: float, mode: str) -> None:
    phase = np.deg2rad(step_deg) * np.cumsum(np.random.default_rng(3).standard_normal(100)).reshape(10, 10)
    chosen = fit_auto(with_phases(phase))
    assert chosen.mode == mode
    assert len(chosen.fit) == 3
    std = np.sqrt(np.einsum("paa->pa", chosen.fit.covariance))
    assert (np.abs(chosen.fit.delay_s - PATHS.delay_s) < 4 * std[:, 0]).all()
    assert (np.abs(chosen.fit.aod_rad - PATHS.aod_rad)[:, 0] < 4 * std[:, 1]).all()
    if mode == "tracked":
        assert "walk by" in chosen.reason
    else:
        assert "from one pair to the next they change by" in chosen.reason


@pytest.mark.parametrize(("spread_deg", "mode"), [(4.0, "tracked"), (25.0, "incoherent")])
def test_the_residual_is_that_of_the_phases_without_noise(spread_deg: float, mode: str) -> None:
    phase = np.deg2rad(spread_deg) * np.random.default_rng(4).standard_normal((10, 10))
    chosen = fit_auto(with_phases(phase))
    assert np.rad2deg(chosen.ramp.residual_rad) == pytest.approx(spread_deg, rel=0.35, abs=1.5)
    assert chosen.ramp.upper_rad > chosen.ramp.residual_rad
    assert chosen.mode == mode


def test_a_phase_ramp_is_removed() -> None:
    sweep = with_phases(np.zeros((10, 10)))
    back = without_phase_ramp(with_phases(0.3 * np.arange(10)[:, None] - 0.1 * np.arange(10)), 0.3, -0.1)
    assert np.allclose(back.samples, sweep.samples, atol=1e-4)


def test_too_few_pairs_stay_incoherent() -> None:
    nothing = plain_sweep(SMALL, no_plain_paths(SMALL), np.random.default_rng(5))
    chosen = fit_auto(nothing)
    assert chosen.mode == "incoherent"
    assert "too few beam pairs" in chosen.reason
    assert chosen.ramp.n_pairs == 0
    assert len(chosen.fit) == 0


def test_without_a_ramp_the_fit_is_the_coherent_one() -> None:
    sweep = with_phases(np.zeros((10, 10)))
    chosen, coherent = fit_auto(sweep), fit_coherent(sweep)
    std = np.sqrt(np.einsum("paa->pa", coherent.covariance))[:, 0]
    assert (np.abs(chosen.fit.delay_s - coherent.delay_s) < 0.3 * std).all()
    assert fit_phase_ramp(phases_of(fit_incoherent(sweep))).n_pairs == chosen.ramp.n_pairs


@pytest.mark.parametrize("true_ps", [0.0, 70.0])
def test_coherent_paths_decide_about_a_drift_of_the_clock(monkeypatch, true_ps: float) -> None:
    """Pairs one by one showed a drift of 60 ps over the sweep that is not there, or a little larger."""
    strong = replace(PATHS, amplitude=100 * PATHS.amplitude)
    sweep = plain_sweep(SMALL, strong, np.random.default_rng(6))
    late_s = 1e-12 * true_ps * np.arange(100).reshape(10, 10) / 100
    turn = np.exp(-2j * np.pi * late_s[:, :, None] * sweep.frequency_offset_hz)
    sweep = replace(sweep, samples=sweep.samples * turn)
    found = replace(fit_incoherent(sweep), drift_s=0.6e-12)
    monkeypatch.setattr(auto, "fit_incoherent", lambda *_, **__: found)
    chosen = fit_auto(sweep)
    assert chosen.mode == "coherent"
    error = (chosen.fit.delay_s - PATHS.delay_s) / np.sqrt(chosen.fit.covariance[:, 0, 0])
    assert (np.abs(error) < 3).all()
    assert chosen.fit.covariance[:, 0, 0].max() < (12e-12) ** 2


def test_all_paths_show_a_drift_that_pairs_do_not(monkeypatch) -> None:
    strong = replace(PATHS, amplitude=100 * PATHS.amplitude)
    sweep = plain_sweep(SMALL, strong, np.random.default_rng(9))
    late_s = 100e-12 * np.arange(100).reshape(10, 10) / 100
    turn = np.exp(-2j * np.pi * late_s[:, :, None] * sweep.frequency_offset_hz)
    sweep = replace(sweep, samples=sweep.samples * turn)
    found = replace(fit_incoherent(sweep), drift_s=0.0)
    monkeypatch.setattr(auto, "fit_incoherent", lambda *_, **__: found)
    chosen = fit_auto(sweep)
    assert chosen.mode == "coherent"
    assert len(chosen.fit) == 3
    error = (chosen.fit.delay_s - PATHS.delay_s) / np.sqrt(chosen.fit.covariance[:, 0, 0])
    assert (np.abs(error) < 3).all()
    assert chosen.fit.covariance[:, 0, 0].max() < (12e-12) ** 2


def test_noise_in_proportion_to_the_signal_of_a_pair_is_no_path() -> None:
    """As of a mixer with an image 25 dB below the signal: another one in every pair, at all delays alike."""
    strong = replace(PATHS, amplitude=30 * PATHS.amplitude)
    rng = np.random.default_rng(10)
    sweep = plain_sweep(SMALL, strong, rng)
    level = np.sqrt(np.square(np.abs(sweep.samples)).mean(axis=2, keepdims=True) / 2) * 10 ** (-25 / 20)
    image = level * (rng.standard_normal(sweep.samples.shape) + 1j * rng.standard_normal(sweep.samples.shape))
    chosen = fit_auto(replace(sweep, samples=sweep.samples + image))
    assert chosen.mode == "coherent"
    seen = chosen.fit.take("path", ~chosen.fit.is_weak)
    assert len(seen) == 3
    error = (seen.delay_s - PATHS.delay_s) / np.sqrt(seen.covariance[:, 0, 0])
    assert (np.abs(error) < 3).all()
    clean = fit_auto(sweep).fit
    assert (seen.covariance[:, 0, 0] > 2 * clean.covariance[:, 0, 0]).all()


def test_a_few_coherent_paths_come_before_tracked_phases(monkeypatch) -> None:
    """An incoherent fit may show other phases than coherent paths do; these hold, so there is nothing to track."""
    sweep = plain_sweep(SMALL, PATHS, np.random.default_rng(7))
    wandering = np.cumsum(np.random.default_rng(8).standard_normal(100)).reshape(10, 10)
    real = auto.phases_of

    def other_phases(fit, **settings):
        pairs = real(fit, **settings)
        return replace(pairs, phase_rad=pairs.phase_rad + wandering)

    monkeypatch.setattr(auto, "phases_of", other_phases)
    chosen = fit_auto(sweep)
    assert chosen.mode == "coherent"
    np.testing.assert_allclose(chosen.fit.delay_s, fit_over_background(sweep).delay_s, atol=1e-13)


def test_all_paths_of_a_coherent_fit_show_a_ramp_and_random_phases() -> None:
    """Against the true paths: a ramp is told to its noise, random phases have the residual of a uniform one."""
    rng = np.random.default_rng(4)
    plain = with_phases(np.zeros((10, 10)))
    fit = fit_coherent(plain)
    ramp = fit_phase_ramp(phases_against(with_phases(0.02 * np.arange(10)[:, None] + 0.1 * np.arange(10)), fit))
    assert ramp.is_coherent
    assert ramp.tx_step_rad == pytest.approx(0.02, abs=1e-2)
    assert ramp.rx_step_rad == pytest.approx(0.1, abs=1e-2)
    assert np.rad2deg(ramp.residual_rad) < 2
    random = fit_phase_ramp(phases_against(with_phases(rng.uniform(-np.pi, np.pi, (10, 10))), fit))
    assert not random.is_coherent
    assert np.rad2deg(random.residual_rad) > 45
