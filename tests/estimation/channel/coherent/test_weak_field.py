"""Weak paths beside a strong one count as its noise."""

import numpy as np
import pytest

from estimation.channel.coherent.misfit import weak_field
from estimation.channel.coherent.refine import Reference, solve_at
from estimation.channel.model.path_model import PathParameters
from tests.estimation.channel.plain_sweeps import compressed, plain_link, plain_paths, plain_sweep

LINK = plain_link()


def field_power(spread_ns: float, seed: int = 3):
    """Noise about a strong path beside 60 weak ones within `spread_ns`: as a field, and as paths."""
    rng = np.random.default_rng(seed)
    n = 60
    delay = np.concatenate([[300.0], 300.0 + rng.uniform(-spread_ns, spread_ns, n)])
    aod = np.concatenate([[-15.0], -15.0 + rng.uniform(-4, 4, n)])
    aoa = np.concatenate([[12.0], 12.0 + rng.uniform(-4, 4, n)])
    snr = np.concatenate([[50.0], np.full(n, 22.0)])
    paths = plain_paths(LINK, delay, aod, aoa, snr, phase=rng.uniform(-3, 3, n + 1))
    sweep = compressed(plain_sweep(LINK, paths, rng))
    still = np.zeros((n + 1, 0))
    delay_bins = paths.delay_s / sweep.bin_s
    start = PathParameters(delay_bins, paths.aod_rad, paths.aoa_rad, np.ones(n + 1, complex), still)
    found = solve_at(Reference(sweep, start.take(np.arange(0))), start).paths
    is_weak = np.arange(n + 1) > 0
    reference = Reference(sweep, found)
    return weak_field(reference, found, is_weak)[0], weak_field(reference, found, np.zeros(n + 1, bool))[0]


def test_weak_paths_about_a_strong_one_are_noise_and_noise_alone_is_none():
    as_field, as_paths = field_power(300.0)
    assert as_field > 5
    assert as_paths == pytest.approx(1.0)


def test_the_side_lobes_of_one_weak_path_are_no_field():
    """Four bins after the strong path, where the side lobes of 50 dB fill the bins beside it."""
    rng = np.random.default_rng(5)
    delay_ns = 300.0 + 1e9 / (288 * 120e3) * np.array([0.0, 4.3])
    paths = plain_paths(LINK, delay_ns, [-15.0, -13.0], [12.0, 11.0], np.array([60.0, 50.0]))
    sweep = compressed(plain_sweep(LINK, paths, rng))
    start = PathParameters(paths.delay_s / sweep.bin_s, paths.aod_rad, paths.aoa_rad, paths.amplitude)
    found = solve_at(Reference(sweep, start.take(np.arange(0))), start).paths
    field = weak_field(Reference(sweep, found), found, np.array([False, True]))
    assert field[0] == pytest.approx(1.0)
