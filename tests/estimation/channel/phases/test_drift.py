"""The drift of a clock against all paths of a coherent fit, and its part of the errors."""

import numpy as np
import pytest

from estimation.channel.coherent.diffuse import fit_over_background
from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.incoherent.clock_drift import ClockDrift, without_drift
from estimation.channel.phases.drift import drift_against, with_drift_errors
from estimation.channel.phases.pairs import without_phases
from isac_arena.validation.scenarios.link_bench import draw_paths, make_bench, observe_paths

PPM = 0.02
SYMBOL_S = (1 + 144 / 2048) / 120e3
PER_PAIR_S = PPM * 1e-6 * SYMBOL_S


def sweep_of(seed, **impairments):
    bench = make_bench(seed, **impairments)
    paths = draw_paths(np.random.default_rng(seed), bench.cell, strongest_db=(45.0, 50.0), pair_share=0.0)
    return observe_paths(bench, paths, 0).sweep


@pytest.mark.parametrize("seed", [100, 101])
def test_a_drift_is_found_whatever_the_phases_of_pairs(seed):
    fit = fit_over_background(sweep_of(seed))
    sweep = sweep_of(seed, clock_drift_ppm=PPM)
    turned = without_phases(sweep, np.random.default_rng(seed).uniform(-3, 3, sweep.samples.shape[:2]))
    found = drift_against(turned, fit, ClockDrift())
    assert found.per_pair == pytest.approx(PER_PAIR_S, rel=0.1)
    assert abs(found.per_pair - PER_PAIR_S) < 4 * np.sqrt(found.variance)
    half = drift_against(without_drift(turned, PER_PAIR_S / 2), fit, ClockDrift(PER_PAIR_S / 2))
    assert half.per_pair == pytest.approx(found.per_pair, rel=0.02)
    still = drift_against(sweep_of(seed), fit, ClockDrift())
    assert abs(still.per_pair) < 4 * np.sqrt(still.variance)
    assert abs(still.per_pair) < 0.02 * PER_PAIR_S


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
