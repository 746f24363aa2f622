from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.crb import crb
from estimation.channel.incoherent import IncoherentFit, fit_incoherent
from estimation.channel.incoherent_threshold import Levels, null_tail
from estimation.channel.manifold import Manifold
from scenes.record import FloatArray
from sim.config import ArrayConfig
from sim.impairments import with_element_errors
from sim.link import Link
from sim.sweep import BeamSweep
from tests.estimation.channel.plain_sweeps import (
    PlainPaths,
    no_plain_paths,
    plain_link,
    plain_paths,
    plain_sweep,
)

CHI2_95 = 7.815  # of 3 degrees of freedom
SMALL = plain_link()
PANELS = ArrayConfig(
    columns=8, beams_per_panel=8, sector_deg=90.0, panel_azimuth_deg=[-180.0, -90.0, 0.0, 90.0]
)
ELEVATION = ArrayConfig(columns=8, beams_per_panel=8, beam_elevation_deg=[-20.0, 0.0, 20.0])


def scrambled(sweep: BeamSweep, rng: np.random.Generator) -> BeamSweep:
    """The sweep with a random phase on every beam pair."""
    phasor = np.exp(2j * np.pi * rng.random(sweep.samples.shape[:2])).astype(np.complex64)
    return replace(sweep, samples=sweep.samples * phasor[:, :, None])


def places(fit: IncoherentFit | PlainPaths) -> FloatArray:
    return np.concatenate([fit.delay_s[:, None], fit.aod_rad, fit.aoa_rad], axis=1)


def bounds(link: Link, paths: PlainPaths) -> Any:
    return crb(
        link.tx_codebook, link.rx_codebook, link.frequency_offset_hz, 1.0, delay_s=paths.delay_s,
        aod_rad=paths.aod_rad, aoa_rad=paths.aoa_rad, amplitude=paths.amplitude, coherent=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("tx", "rx"), [(None, None), (None, PANELS), (ELEVATION, None)], ids=["azimuth", "panels", "elevation"]
)
def test_without_noise_paths_come_back_as_they_were(tx: ArrayConfig | None, rx: ArrayConfig | None) -> None:
    link = plain_link(tx, rx)
    aod = [[10.0, 5.0], [-25.0, -8.0], [35.0, 12.0]] if tx is ELEVATION else [10.0, -25.0, 35.0]
    aoa = [-100.0, 20.0, 170.0] if rx is PANELS else [-20.0, 5.0, 30.0]
    paths = plain_paths(link, [-40.0, 85.0, 230.0], aod, aoa, [45.0, 40.0, 38.0], phase=[0.5, -2.0, 3.0])
    fit = fit_incoherent(scrambled(plain_sweep(link, paths), np.random.default_rng(1)))
    assert fit.status == "ok"
    assert len(fit) == 3
    assert np.allclose(fit.delay_s, paths.delay_s, atol=2e-11)
    assert np.allclose(places(fit)[:, 1:], places(paths)[:, 1:], atol=1e-3)
    assert np.allclose(fit.amplitude, np.abs(paths.amplitude), rtol=2e-3)
    assert np.isnan(fit.phase_rad).all()


def test_errors_reach_the_bound_and_covariances_are_honest() -> None:
    """Three paths, two of one delay, 60 stops: 180 errors hold RMSE / CRB and NEES / 3 to 5 to 6 % (one sigma)."""
    rng = np.random.default_rng(12)
    scaled, nees = [], []
    for _ in range(60):
        paths = plain_paths(
            SMALL, [30.0, 130.0, 135.0], [rng.uniform(-45, 45), 20.0, -30.0], rng.uniform(-45, 45, 3),
            rng.uniform(17, 35, 3), phase=rng.uniform(0, 6.28, 3),
        )  # fmt: skip
        fit = fit_incoherent(scrambled(plain_sweep(SMALL, paths, rng), rng))
        if len(fit) != 3:  # a false alarm
            continue
        error = places(fit) - places(paths)
        scaled.append(error / bounds(SMALL, paths).std)
        nees.append(np.einsum("pa,pab,pb->p", error, np.linalg.inv(fit.covariance), error))
    assert len(scaled) >= 58
    ratio = np.sqrt((np.concatenate(scaled) ** 2).mean(axis=0))
    assert ratio.max() < 1.2
    assert ratio.mean() < 1.1
    assert abs(np.mean(nees) / 3 - 1) < 0.2
    assert 0.9 < (np.concatenate(nees) < CHI2_95).mean() < 0.99


def test_phases_of_the_pairs_are_those_of_the_sweep() -> None:
    rng = np.random.default_rng(3)
    paths = plain_paths(SMALL, 80.0, 12.0, -20.0, 30.0)
    sweep = plain_sweep(SMALL, paths, rng)
    turn = rng.uniform(-np.pi, np.pi, sweep.samples.shape[:2])
    fit = fit_incoherent(replace(sweep, samples=sweep.samples * np.exp(1j * turn)[:, :, None]))
    lit = fit.pair_snr > 10
    left = np.exp(1j * (fit.pair_phase_rad - turn)[lit])
    assert lit.sum() > 8
    off = np.angle(left / left.mean()) * np.sqrt(2 * fit.pair_snr[lit])
    assert 0.5 < off.std() < 1.6
    assert (fit.pair_path[lit] == 0).all()
    assert (fit.pair_path[fit.pair_snr == 0] == -1).all()


def test_noise_alone_makes_paths_as_often_as_asked() -> None:
    rng = np.random.default_rng(4)
    config = MaximumLikelihoodConfig(false_alarm_probability=0.2)
    n = 80
    hits = sum(
        len(fit_incoherent(plain_sweep(SMALL, no_plain_paths(SMALL), rng), config)) > 0 for _ in range(n)
    )
    assert abs(hits / n - 0.2) < 3.5 * np.sqrt(0.2 * 0.8 / n)


@pytest.mark.slow
def test_false_alarms_are_rare_where_they_are_to_be() -> None:
    rng = np.random.default_rng(5)
    config = MaximumLikelihoodConfig(false_alarm_probability=0.01)
    n = 3000
    nothing = no_plain_paths(SMALL)
    hits = sum(len(fit_incoherent(plain_sweep(SMALL, nothing, rng), config)) > 0 for _ in range(n))
    assert 0.5 < hits / n / 0.01 < 1.5


def test_levels_fall_where_paths_are_expected() -> None:
    tail = null_tail(Manifold(SMALL.tx_codebook), Manifold(SMALL.rx_codebook))
    levels = Levels(tail, MaximumLikelihoodConfig(), 1e-9, 8000)
    expected, late = levels.first(np.array([100.0, 5000.0]))
    near, far = levels.further(np.array([5100.0, 100.0]), 5000.0)
    assert near < expected < late
    assert near < far
    probability = np.exp(tail.log_probability(tail.threshold(1e-3, 500.0), 500.0))
    assert probability == pytest.approx(1e-3, rel=0.01)


def test_two_equal_paths_of_nearly_one_delay_are_two() -> None:
    """0.45 of a delay cell apart, in the same direction."""
    rng = np.random.default_rng(6)
    cell_ns = 1e9 / (288 * 120e3)
    counts = []
    for phase in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        paths = plain_paths(
            SMALL, [150.0, 150.0 + 0.45 * cell_ns], [5.0, 5.0], [-9.0, -9.0], 30.0, phase=[0.0, phase]
        )
        counts.append(len(fit_incoherent(scrambled(plain_sweep(SMALL, paths, rng), rng))))
    assert np.mean(np.array(counts) == 2) >= 0.85


def test_calibrated_manifolds_take_the_place_of_nominal_ones() -> None:
    rng = np.random.default_rng(7)
    built = replace(
        SMALL,
        tx_codebook=with_element_errors(SMALL.tx_codebook, 1.0, 0.3, rng),
        rx_codebook=with_element_errors(SMALL.rx_codebook, 1.0, 0.3, rng),
    )
    paths = plain_paths(built, [80.0, 150.0], [12.0, -30.0], [0.0, 20.0], [40.0, 35.0])
    sweep = replace(
        plain_sweep(built, paths, rng), tx_codebook=SMALL.tx_codebook, rx_codebook=SMALL.rx_codebook
    )
    known = fit_incoherent(sweep, None, Manifold(built.tx_codebook, 1), Manifold(built.rx_codebook, 1))
    assert np.allclose(places(known), places(paths), atol=[3e-10, 0.01, 0.01])


def test_noise_powers_may_differ_between_beams_and_a_beam_may_be_dead() -> None:
    rng = np.random.default_rng(8)
    noise_mw = np.geomspace(0.2, 5.0, 10)
    paths = plain_paths(SMALL, [80.0, 170.0], [12.0, -20.0], [3.0, 30.0], [30.0, 28.0])
    sweep = plain_sweep(SMALL, paths, rng, noise_mw)
    samples = sweep.samples.copy()
    samples[:, 0] = 0
    fit = fit_incoherent(scrambled(replace(sweep, samples=samples), rng))
    assert len(fit) == 2
    assert np.allclose(places(fit), places(paths), atol=[1e-9, 0.03, 0.03])


def test_no_more_paths_than_allowed() -> None:
    paths = plain_paths(
        SMALL, [30.0, 130.0, 260.0], [0.0, 30.0, -30.0], [0.0, -30.0, 20.0], [35.0, 33.0, 30.0]
    )
    sweep = plain_sweep(SMALL, paths, np.random.default_rng(9))
    fit = fit_incoherent(sweep, MaximumLikelihoodConfig(max_paths=2))
    assert np.allclose(fit.delay_s, paths.delay_s[:2], atol=2e-9)


def test_silence_and_noise_have_a_status() -> None:
    nothing = no_plain_paths(SMALL)
    silent = fit_incoherent(plain_sweep(SMALL, nothing))
    assert (silent.status, len(silent)) == ("no_signal", 0)
    noise = fit_incoherent(plain_sweep(SMALL, nothing, np.random.default_rng(10)))
    assert (noise.status, len(noise)) == ("no_paths", 0)
    assert noise.covariance.shape == (0, 3, 3)


def test_bad_samples_are_refused_in_one_line() -> None:
    sweep = plain_sweep(SMALL, plain_paths(SMALL, 80.0, 0.0, 0.0, 30.0))
    samples = sweep.samples.copy()
    samples[2, 1, 5] = np.nan
    with pytest.raises(ValueError, match=r"stop 3: beam pair \(2, 1\) is not finite"):
        fit_incoherent(replace(sweep, samples=samples))
    with pytest.raises(ValueError, match="2 subcarriers"):
        fit_incoherent(sweep.take("subcarrier", slice(0, 1)))


def test_same_samples_same_bits() -> None:
    paths = plain_paths(SMALL, [30.0, 45.0], [0.0, 10.0], [0.0, -10.0], [35.0, 33.0])
    sweep = plain_sweep(SMALL, paths, np.random.default_rng(11))
    one, other = fit_incoherent(sweep), fit_incoherent(sweep)
    assert np.array_equal(places(one), places(other))
    assert np.array_equal(one.covariance, other.covariance)
