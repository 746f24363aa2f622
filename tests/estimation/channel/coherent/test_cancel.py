"""Cancelling pairs are separated or merged, and true close pairs stay."""

from dataclasses import replace

import numpy as np

from estimation.channel.coherent.cancel import cancelling_coherence, without_cancelling_paths
from estimation.channel.coherent.prune import prune_paths
from estimation.channel.coherent.refine import Reference, Solution, refine_paths, solve_at
from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.path_model import PathParameters
from tests.estimation.channel.plain_sweeps import compressed, plain_link, plain_paths, plain_sweep

SMALL = plain_link()
CELL_NS = 1e9 / (288 * 120e3)


def _two(apart_cells: float, phase: float) -> tuple[CompressedSweep, PathParameters]:
    """Two paths of 35 dB this far apart in delay, in noise, and the true places on the grid of the sweep."""
    delay_ns = 200.0 + CELL_NS * apart_cells * np.array([-0.5, 0.5])
    paths = plain_paths(SMALL, delay_ns, [5.0, 5.0], [-9.0, -9.0], 35.0, phase=[0.0, phase])
    sweep = compressed(plain_sweep(SMALL, paths, np.random.default_rng(1)))
    return sweep, PathParameters(paths.delay_s / sweep.bin_s, paths.aod_rad, paths.aoa_rad, paths.amplitude)


def _cancelling_pair(sweep: CompressedSweep, truth: PathParameters) -> PathParameters:
    """Two paths a thousandth of a bin apart between the true ones."""
    middle = truth.delay_bins.mean() + np.array([-5e-4, 5e-4])
    return PathParameters(middle, truth.aod_rad, truth.aoa_rad, truth.amplitude)


def test_cancelling_paths_are_separated_to_the_true_places() -> None:
    sweep, truth = _two(0.8, 1.0)
    reference = Reference(sweep, truth.take(slice(0)))
    pair = solve_at(reference, _cancelling_pair(sweep, truth))
    assert cancelling_coherence(pair).any()
    assert np.abs(pair.paths.amplitude).max() > 30 * np.abs(truth.amplitude).max()
    found = without_cancelling_paths(reference, pair, 30)
    assert not cancelling_coherence(found).any()
    assert np.allclose(np.sort(found.paths.delay_bins), truth.delay_bins, atol=0.1)
    assert found.explained > pair.explained


def test_cancelling_paths_at_one_path_become_one_significant_path() -> None:
    sweep, truth = _two(0.0, 0.0)
    reference = Reference(sweep, truth.take(slice(0)))
    found = without_cancelling_paths(reference, solve_at(reference, _cancelling_pair(sweep, truth)), 30)
    assert not cancelling_coherence(found).any()
    found = prune_paths(reference, found, lambda paths: np.full(len(paths), 24.0), 30)
    assert len(found.paths) == 1
    assert np.isclose(found.paths.delay_bins[0], truth.delay_bins[0], atol=0.05)


def test_close_paths_need_not_cancel_by_as_much() -> None:
    """Six hundredths of a cell apart, in place of a path and a weaker one beside it: 5 dB above their sum."""
    delay_ns = 200.0 + CELL_NS * np.array([0.0, 0.4])
    paths = plain_paths(SMALL, delay_ns, [5.0, 5.0], [-9.0, -9.0], np.array([35.0, 29.0]))
    sweep = compressed(plain_sweep(SMALL, paths, np.random.default_rng(2)))
    truth = PathParameters(paths.delay_s / sweep.bin_s, paths.aod_rad, paths.aoa_rad, paths.amplitude)
    reference = Reference(sweep, truth.take(slice(0)))
    pair = solve_at(reference, replace(truth, delay_bins=truth.delay_bins[0] + np.array([-0.03, 0.03])))
    power = np.square(np.abs(pair.paths.amplitude))
    together = np.abs(pair.paths.amplitude.sum()) ** 2
    assert 4 < power.max() / together < 20
    found = without_cancelling_paths(reference, pair, 30)
    assert found.explained > pair.explained
    assert np.allclose(np.sort(found.paths.delay_bins), truth.delay_bins, atol=0.1)


def test_true_pairs_are_kept_at_any_phases() -> None:
    for phase in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        sweep, truth = _two(0.5, phase)
        reference = Reference(sweep, truth.take(slice(0)))
        fitted = refine_paths(reference, truth, 30)
        assert without_cancelling_paths(reference, fitted, 30) is fitted


def _fitted_three(true_bins: list[float], fitted_bins: list[float], snr_db: float) -> Solution:
    """A fit of three paths from these places, in bins from 200 ns, to a sweep with paths at the true ones."""
    n, delay_ns = len(true_bins), 200.0 + CELL_NS * np.array(true_bins)
    phase = np.linspace(0.0, 2.0, n)
    paths = plain_paths(SMALL, delay_ns, [5.0] * n, [-9.0] * n, snr_db, phase=phase)
    sweep = compressed(plain_sweep(SMALL, paths, np.random.default_rng(3)))
    bins = 200.0 / CELL_NS + np.array(fitted_bins)
    alike = (value[:1].repeat(3, axis=0) for value in (paths.aod_rad, paths.aoa_rad, paths.amplitude))
    three = PathParameters(bins, *alike)
    reference = Reference(sweep, three.take(slice(0)))
    return without_cancelling_paths(reference, refine_paths(reference, three, 30), 30)


def test_a_group_in_place_of_one_path_is_merged() -> None:
    found = _fitted_three([0.0], [-0.15, 0.0, 0.15], 60.0).paths
    assert len(found) < 3
    assert np.isclose(found.delay_bins[np.abs(found.amplitude).argmax()], 200.0 / CELL_NS, atol=1e-3)


def test_a_group_that_noise_does_not_lose_is_kept() -> None:
    found = _fitted_three([-0.7, 0.0, 0.7], [-0.7, 0.0, 0.7], 50.0).paths
    assert np.allclose(np.sort(found.delay_bins), 200.0 / CELL_NS + np.array([-0.7, 0.0, 0.7]), atol=0.02)
