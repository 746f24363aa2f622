from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.coherent.plan import NEAR_SHARE
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.incoherent.paths import _observable, fit_incoherent
from estimation.channel.incoherent.threshold import DetectionLevels, null_tail
from estimation.channel.model.false_alarms import (
    delay_curvatures,
    detection_level,
    direction_curvatures,
    region_curvatures,
)
from estimation.channel.model.manifold import Manifold
from tests.estimation.channel.plain_sweeps import (
    CHI2_95,
    places,
    plain_bounds,
    plain_link,
    plain_paths,
    plain_sweep,
    scrambled,
)

SMALL = plain_link()


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
        scaled.append(error / plain_bounds(SMALL, paths, coherent=False).std)
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
    residual = np.exp(1j * (fit.pair_phase_rad - turn)[lit])
    assert lit.sum() > 8
    off = np.angle(residual / residual.mean()) * np.sqrt(2 * fit.pair_snr[lit])
    assert 0.5 < off.std() < 1.6
    assert (fit.pair_path[lit] == 0).all()
    assert (fit.pair_path[fit.pair_snr == 0] == -1).all()


def test_levels_fall_where_paths_are_expected() -> None:
    tail = null_tail(Manifold(SMALL.tx_codebook), Manifold(SMALL.rx_codebook))
    levels = DetectionLevels(tail, MaximumLikelihoodConfig(), 1e-9, 8000)
    expected, late = levels.first(np.array([100.0, 5000.0]))
    near, far = levels.further(np.array([5100.0, 100.0]), 5000.0, np.zeros(2))
    assert near < expected < late
    assert near < far
    probability = np.exp(tail.log_probability(tail.threshold(1e-3, 500.0), 500.0))
    assert probability == pytest.approx(1e-3, rel=0.01)


def test_levels_rise_to_those_of_known_phases() -> None:
    """A path in pairs whose phases others determine is detected coherently, and so is noise."""
    ends = Manifold(SMALL.tx_codebook), Manifold(SMALL.rx_codebook)
    levels = DetectionLevels(null_tail(*ends), MaximumLikelihoodConfig(), 1e-9, 8000)
    dark, half, lit = levels.further(np.full(3, 100.0), 50.0, np.array([0.0, 0.5, 1.0]))
    assert dark < half < lit
    assert half == pytest.approx((dark + lit) / 2)
    n_near = levels.config.delay_before_ns + levels.config.delay_after_ns
    region = region_curvatures(delay_curvatures(n_near, 8000), *map(direction_curvatures, ends))
    assert lit == pytest.approx(detection_level(NEAR_SHARE * levels.config.false_alarm_probability, region))


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


def test_bad_samples_are_refused_in_one_line() -> None:
    sweep = plain_sweep(SMALL, plain_paths(SMALL, 80.0, 0.0, 0.0, 30.0))
    samples = sweep.samples.copy()
    samples[2, 1, 5] = np.nan
    with pytest.raises(ValueError, match=r"stop 3: beam pair \(2, 1\) is not finite"):
        fit_incoherent(replace(sweep, samples=samples))
    with pytest.raises(ValueError, match="2 subcarriers"):
        fit_incoherent(sweep.take("subcarrier", slice(0, 1)))


def test_what_cannot_be_observed_is_uniform_and_finite() -> None:
    covariance = np.stack([np.diag([0.1, 0.2, 0.3]), np.full((3, 3), np.nan)])
    covariance[1, 0, 0] = np.inf
    kept, lost = _observable(covariance, 100)
    np.testing.assert_array_equal(kept, covariance[0])
    np.testing.assert_allclose(lost, np.diag([100**2, (2 * np.pi) ** 2, (2 * np.pi) ** 2]) / 12)
