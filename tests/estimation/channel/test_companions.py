"""Companions: what wrong responses of the arrays leave of strong paths, and no true path."""

import numpy as np

from estimation.channel.coherent.diffuse import fit_over_background
from estimation.channel.coherent.plan import nominal_manifold
from estimation.channel.companions import companions
from isac_arena.validation.scenarios.link_bench import draw_paths, make_bench, observe_paths

STRONG_DB = (45.0, 50.0)


def test_wrong_elements_leave_companions_that_are_marked() -> None:
    bench = make_bench(3, element_gain_std_db=1.0, element_phase_std_deg=10.0)
    rng = np.random.default_rng(5)
    reported, ghosts = 0, 0
    for stop in range(4):
        paths = draw_paths(rng, bench.cell, strongest_db=STRONG_DB)
        fit = fit_over_background(observe_paths(bench, paths, stop).sweep)
        assert len(fit) > len(paths)
        reported += int((~fit.is_weak).sum()) - len(paths)
        ghosts += len(fit) - len(paths)
    assert reported <= 0.2 * ghosts


def test_true_paths_of_exact_arrays_are_no_companions() -> None:
    bench = make_bench(3)
    rng = np.random.default_rng(6)
    for stop in range(4):
        paths = draw_paths(rng, bench.cell, strongest_db=STRONG_DB)
        sweep = observe_paths(bench, paths, stop).sweep
        fit = fit_over_background(sweep)
        manifolds = nominal_manifold(sweep.tx_codebook), nominal_manifold(sweep.rx_codebook)
        assert not companions(fit, *manifolds).any()
