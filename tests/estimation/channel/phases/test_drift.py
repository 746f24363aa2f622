"""The drift of a clock against all paths of a coherent fit, and its part of the errors."""

import numpy as np
import pytest

from estimation.channel.coherent.diffuse import fit_over_background
from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.incoherent.clock_drift import ClockDrift, without_drift
from estimation.channel.phases.drift import drift_against, settled_drift, with_drift_errors
from estimation.channel.phases.pairs import without_phases
from isac_arena.validation.scenarios.link_bench import draw_paths, make_bench, observe_paths

PPM = 0.02
PAIR_S = 2 * (1 + 144 / 2048) / 120e3  # two symbols, which the receiver combines
PER_PAIR_S = PPM * 1e-6 * PAIR_S


def sweep_of(seed, **impairments):
    bench = make_bench(seed, **impairments)
    paths = draw_paths(np.random.default_rng(seed), bench.cell, strongest_db=(45.0, 50.0), pair_share=0.0)
    return observe_paths(bench, paths, 0).sweep


@pytest.mark.parametrize("seed", [100, 101])
def test_a_drift_is_found_whatever_the_phases_of_pairs(seed):
    sweep = sweep_of(seed, clock_drift_ppm=PPM)
    fit = fit_over_background(sweep)
    turned = without_phases(sweep, np.random.default_rng(seed).uniform(-3, 3, sweep.samples.shape[:2]))
    found = drift_against(turned, fit, ClockDrift())
    assert found.per_pair / PER_PAIR_S == pytest.approx(1, rel=0.1)
    assert abs(found.per_pair - PER_PAIR_S) < 4 * np.sqrt(found.variance)
    rest = fit_over_background(without_drift(sweep, PER_PAIR_S / 2))
    half = drift_against(without_drift(turned, PER_PAIR_S / 2), rest, ClockDrift(PER_PAIR_S / 2))
    assert half.per_pair / PER_PAIR_S == pytest.approx(1, rel=0.1)
    steady = sweep_of(seed)
    still = drift_against(steady, fit_over_background(steady), ClockDrift())
    assert abs(still.per_pair) < 4 * np.sqrt(still.variance)
    assert abs(still.per_pair) < 0.02 * PER_PAIR_S


def test_paths_that_were_fitted_to_a_drift_hide_a_part_of_it():
    sweep = sweep_of(102, clock_drift_ppm=PPM)
    once = drift_against(sweep, fit_over_background(sweep), ClockDrift())
    settled = settled_drift(sweep, fit_over_background, 0.0)
    assert settled.is_likely
    assert abs(settled.per_pair - PER_PAIR_S) < 4 * np.sqrt(settled.variance)
    assert abs(settled.per_pair - PER_PAIR_S) < abs(once.per_pair - PER_PAIR_S)
    assert settled.variance < once.variance
    assert not settled_drift(sweep_of(102), fit_over_background, 0.0).is_likely


def test_an_unknown_drift_moves_a_path_by_the_pairs_that_see_it():
    sweep = sweep_of(100)
    fit = fit_over_background(sweep)
    wide = with_drift_errors(sweep, fit, ClockDrift(0.0, 1e-30))
    added = np.sqrt((wide.covariance - fit.covariance)[:, 0, 0]) / 1e-15
    tx = nominal_manifold(sweep.tx_codebook).response(fit.aod_rad)
    rx = nominal_manifold(sweep.rx_codebook).response(fit.aoa_rad)
    for k in range(len(fit)):
        energy = np.abs(np.outer(tx[k], rx[k])).ravel() ** 2
        assert added[k] == pytest.approx(np.average(np.arange(energy.size), weights=energy))
