"""Tracked phases of beam pairs: against dense Gaussian posteriors, and drawn phases of known variances."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.phases.pairs import PairPhases
from estimation.channel.phases.track import smooth_walk, track_phases, wanders
from scenes.pose import wrap_angle
from scenes.record import FloatArray


def test_a_walk_is_smoothed_as_a_dense_gaussian_posterior() -> None:
    rng = np.random.default_rng(1)
    n, step = 40, 0.01
    variance = np.where(rng.random(n) < 0.4, np.inf, rng.uniform(0.001, 0.05, n))
    seen = 0.3 * rng.standard_normal(n)
    difference = np.diff(np.eye(n), axis=0)
    first = np.zeros(n)
    first[0] = 1.0
    precision = difference.T @ difference / step + np.outer(first, first) / 1e3 + np.diag(1 / variance)
    mean, spread, _ = smooth_walk(seen, variance, step)
    expected = np.linalg.solve(precision, np.where(np.isfinite(variance), seen / variance, 0.0))
    np.testing.assert_allclose(mean, expected, atol=1e-6)
    np.testing.assert_allclose(spread, np.diagonal(np.linalg.inv(precision)), rtol=1e-4)


def test_the_likelihood_of_a_walk_is_that_of_its_differences() -> None:
    rng = np.random.default_rng(2)
    n, step, noise = 30, 0.02, 0.01
    seen = np.cumsum(np.sqrt(step) * rng.standard_normal(n)) + np.sqrt(noise) * rng.standard_normal(n)
    lag = np.abs(np.subtract.outer(np.arange(n - 1), np.arange(n - 1)))
    covariance = np.where(lag == 0, step + 2 * noise, np.where(lag == 1, -noise, 0.0))
    change = np.diff(seen)
    dense = -0.5 * (change @ np.linalg.solve(covariance, change) + np.linalg.slogdet(covariance)[1])
    assert smooth_walk(seen, np.full(n, noise), step)[2] == pytest.approx(dense, abs=1e-3)


def drawn(step_deg: float, own_deg: float, seed: int) -> tuple[PairPhases, FloatArray]:
    """Pairs of unequal SNR, a third of them dark, and their true phases."""
    rng = np.random.default_rng(seed)
    shape = (20, 48)
    beams = rng.uniform(-np.pi, np.pi, (shape[0], 1)) + np.deg2rad(60) * rng.standard_normal((1, shape[1]))
    walk = np.deg2rad(step_deg) * np.cumsum(rng.standard_normal(shape[0] * shape[1])).reshape(shape)
    true = beams + walk + np.deg2rad(own_deg) * rng.standard_normal(shape)
    snr = np.where(rng.random(shape) < 1 / 3, 0.0, 10 ** rng.uniform(1.0, 4.0, shape))
    phase = true + rng.standard_normal(shape) * np.sqrt(0.5 / np.maximum(snr, 1e-3))
    zeros, usable = np.zeros(shape), np.ones(shape, bool)
    return PairPhases(wrap_angle(phase), snr, zeros, np.zeros(shape, int), usable), true


@pytest.mark.parametrize(("step_deg", "own_deg"), [(0.0, 0.0), (4.0, 1.0), (3.0, 6.0)])
def test_beam_phases_a_walk_and_own_phases_are_tracked(step_deg: float, own_deg: float) -> None:
    pairs, true = drawn(step_deg, own_deg, 3)
    track = track_phases(pairs)
    error = wrap_angle(track.phase_rad - true)
    error = wrap_angle(error - np.angle(np.exp(1j * error).sum()))
    bright, dark = pairs.snr > 1000, pairs.snr == 0
    assert np.rad2deg(np.sqrt(np.square(error[bright]).mean())) < 2
    assert 0.5 < np.mean(np.square(error[dark]) / track.variance[dark]) < 1.6
    assert np.rad2deg(track.error_rad) < 3 + 2 * step_deg + 1.3 * own_deg


def test_the_order_of_magnitude_of_steps_and_own_phases_is_learned() -> None:
    pairs, _ = drawn(4.0, 4.0, 4)
    track = track_phases(pairs)
    assert 2 <= np.rad2deg(track.step_rad) <= 8
    assert 2 <= np.rad2deg(track.own_rad) <= 8


def test_random_phases_are_not_known_from_others() -> None:
    pairs, _ = drawn(0.0, 200.0, 5)
    assert np.rad2deg(track_phases(pairs).error_rad) > 25


def test_without_a_lit_pair_nothing_is_known() -> None:
    pairs, _ = drawn(0.0, 0.0, 6)
    dark = PairPhases(pairs.phase_rad, np.zeros(pairs.snr.shape), pairs.residual, pairs.path, pairs.is_usable)
    assert track_phases(dark).n_pairs == 0
    assert track_phases(dark).error_rad == np.inf


@pytest.mark.parametrize(
    ("step_deg", "own_deg", "hidden", "expected"),
    [
        (0.0, 0.0, 0.0, False),
        (0.0, 0.0, 0.02, False),
        (0.5, 0.0, 0.02, True),
        (0.0, 6.0, 0.02, True),
        (0.0, 3.0, 0.0, True),
    ],
)
def test_phases_wander_where_they_change_and_magnitudes_do_not(
    step_deg: float, own_deg: float, hidden: float, expected: bool
) -> None:
    pairs, _ = drawn(step_deg, own_deg, 4)
    rng = np.random.default_rng(5)
    of_phases, of_magnitudes = hidden * rng.standard_normal((2, *pairs.snr.shape))
    noise = rng.standard_normal(pairs.snr.shape) * np.sqrt(0.5 / np.maximum(pairs.snr, 1e-3))
    phase_rad = wrap_angle(pairs.phase_rad + of_phases)
    assert wanders(replace(pairs, phase_rad=phase_rad, log_magnitude=of_magnitudes + noise)) is expected
    assert not wanders(pairs)  # without magnitudes nothing tells
