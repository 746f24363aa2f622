from dataclasses import replace

import numpy as np
import pytest

from estimation.channel.coherent.diffuse import fit_over_background
from estimation.channel.estimate import estimate_channel
from estimation.channel.still import is_still
from sim.observation import BeamSweep
from tests.estimation.channel.coherent.moving_sweeps import moving_sweep, scan_clock
from tests.estimation.channel.plain_sweeps import plain_link, plain_paths

LINK = plain_link()
SHIFTS_HZ = np.array([0.0, 140.0, -210.0])
PATHS = plain_paths(LINK, [20.0, 60.0, 61.0], [-20.0, 5.0, 30.0], [10.0, 25.0, -30.0], [30.0, 28.0, 26.0])


def _sweep(order: str, seed: int = 1, shifts_hz: np.ndarray = SHIFTS_HZ) -> BeamSweep:
    sweep: BeamSweep = moving_sweep(LINK, PATHS, shifts_hz, scan_clock(LINK, order), np.random.default_rng(seed))
    return sweep


@pytest.mark.parametrize("order", ["linear", "interleaved", "random"])
def test_doppler_is_found_with_delay_and_angles(order: str) -> None:
    fit = fit_over_background(_sweep(order))
    assert len(fit) == 3 and fit.doppler_hz[0] == 0
    std_hz = np.sqrt(fit.covariance[1:, -1, -1])
    assert (np.abs(fit.doppler_hz[1:, 0] - SHIFTS_HZ[1:]) < 4 * std_hz).all() and (std_hz < 8).all()
    assert np.allclose(fit.aod_rad[:, 0], PATHS.aod_rad[:, 0], atol=0.03)
    on_the_way_s = fit.doppler_hz[:, 0] * fit.seen_s / LINK.carrier_hz  # the paths keep their delays here
    assert np.allclose(fit.delay_s - on_the_way_s, PATHS.delay_s, atol=5e-10)


def test_without_a_clock_moving_paths_fall_apart() -> None:
    sweep = _sweep("random")
    assert fit_over_background(replace(sweep, clock=None)).size("doppler") == 0
    assert len(fit_over_background(replace(sweep, clock=None))) > 3


def test_a_frozen_world_with_a_clock_has_the_paths_of_one_without() -> None:
    sweep = _sweep("linear", shifts_hz=np.zeros(3))
    with_clock, without = fit_over_background(sweep), fit_over_background(replace(sweep, clock=None))
    assert not with_clock.doppler_hz.any()
    assert np.allclose(with_clock.delay_s, without.delay_s, atol=2e-11)
    assert np.allclose(with_clock.aod_rad, without.aod_rad, atol=2e-3)
    plain = np.sqrt(np.einsum("iaa->ia", without.covariance))
    assert np.allclose(np.sqrt(np.einsum("iaa->ia", with_clock.covariance))[:, :3], plain, rtol=0.02)


@pytest.mark.parametrize("method", ["coherent", "auto"])
def test_the_estimate_says_what_moves(method: str) -> None:
    found = estimate_channel(_sweep("linear"), method)
    assert found.motion is not None and found.motion.is_moving.tolist() == [False, True, True]
    assert np.isnan(found.motion.doppler_std_hz).tolist() == [True, False, False]
    assert is_still(found).tolist() == [True, False, False] and found.covariance.shape == (3, 3, 3)


def test_random_phases_leave_a_frozen_world() -> None:
    sweep = _sweep("linear")
    phases = np.exp(2j * np.pi * np.random.default_rng(3).random(sweep.samples.shape[:2]))
    found = estimate_channel(replace(sweep, samples=sweep.samples * phases[:, :, None]), "auto")
    assert found.motion is None and found.reason.startswith("incoherent") and is_still(found).all()
