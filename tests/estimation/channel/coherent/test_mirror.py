"""Groups of close paths: mirrored pairs explain more, seldom less, and no pair is tried twice."""

import numpy as np
import pytest

from estimation.channel.coherent.mirror import PairMirror, _mirrored
from estimation.channel.coherent.paths import PreparedStop, compress_stop, fit_paths
from estimation.channel.coherent.refine import Reference, Solution, refine_paths
from estimation.channel.fit import PathFit
from estimation.channel.model.path_model import PathParameters
from tests.estimation.channel.plain_sweeps import PANELS, plain_link, plain_paths, plain_sweep

LINK = plain_link(rx=PANELS)
N_GROUPS, N_PATHS = 12, 4
CLEAR = 5.0  # gain of likelihood that noise does not cause


def _group(seed: int) -> PreparedStop:
    """Four paths within a cell of delay and angles, some above the horizon, at the edge of two panels."""
    rng = np.random.default_rng(seed)
    delay_ns = 200 + np.sort(rng.uniform(0, 25, N_PATHS))
    aod = np.column_stack([20 + rng.uniform(-4, 4, N_PATHS), np.zeros(N_PATHS)])
    aoa = np.column_stack([-48 + rng.uniform(-4, 4, N_PATHS), rng.uniform(-15, 15, N_PATHS)])
    snr_db, phase = rng.permutation([55.0, 52.0, 48.0, 44.0]), rng.uniform(-3, 3, N_PATHS)
    sweep = plain_sweep(LINK, plain_paths(LINK, delay_ns, aod, aoa, snr_db, phase=phase), rng)
    stop = compress_stop(sweep, None, None, None)
    assert not isinstance(stop, PathFit)
    return stop


def _fit(stop: PreparedStop) -> Solution:
    return fit_paths(stop.compressed, stop.window, stop.plan, stop.config)


def test_groups_are_explained_better_with_mirrored_pairs_and_seldom_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    stops = [_group(seed) for seed in range(N_GROUPS)]
    mirrored = np.array([_fit(stop).explained for stop in stops])
    monkeypatch.setattr(PairMirror, "__call__", lambda _, reference, solution, max_steps: solution)
    plain = np.array([_fit(stop).explained for stop in stops])
    assert (mirrored > plain - 1).mean() >= 0.9  # a move to a higher maximum can lead the search elsewhere
    assert (mirrored > plain + CLEAR).mean() >= 0.5
    assert mirrored.sum() > plain.sum() + N_GROUPS * CLEAR


def test_a_pair_tried_in_vain_is_known_until_it_moves() -> None:
    stop = _group(2)
    paths = _fit(stop).paths
    reference = Reference(stop.compressed, paths)
    solution, mirror = refine_paths(reference, paths, 10), PairMirror()
    while (better := mirror(reference, solution, 10)) is not solution:
        solution = better
    rate = np.full((len(solution.paths), 1 + solution.paths.aod_rad.shape[1] + 2), 10.0)
    tried = mirror._pairs_tried(solution.paths, rate)
    assert tried.any() and not (tried & tried.T).any()
    moved = solution.paths.moved(np.full(rate.shape, 0.1))
    assert not mirror._pairs_tried(moved, rate).any()


def test_a_mirrored_pair_keeps_its_centroid_and_comes_back() -> None:
    paths = PathParameters(
        np.array([10.0, 10.4, 30.0]), np.array([[0.1], [0.2], [1.0]]), np.array([[3.1], [-3.1], [0.0]]),
        np.array([3.0, 1j, 2.0]),
    )  # fmt: skip
    pair = np.array([0, 1])
    once = _mirrored(paths, pair)
    assert np.abs(paths.amplitude[pair]) @ (once.delay_bins - paths.delay_bins)[pair] == pytest.approx(0)
    assert (once.delay_bins[0] > once.delay_bins[1]) and once.delay_bins[2] == 30.0
    twice = _mirrored(once, pair)
    np.testing.assert_allclose(twice.delay_bins, paths.delay_bins)
    np.testing.assert_allclose(np.sin(twice.aoa_rad), np.sin(paths.aoa_rad), atol=1e-12)
