"""Groups of close paths: mirrored pairs explain more, seldom less, and no pair is tried twice."""

import numpy as np
import pytest

from estimation.channel.coherent.mirror import LEAST_GAIN, PairMirror, _mirrored
from estimation.channel.coherent.pairs import _PairSamples, refine_pairs
from estimation.channel.coherent.paths import PreparedStop, compress_stop, fit_paths
from estimation.channel.coherent.refine import Reference, Solution, refine_paths, solve_at
from estimation.channel.fit import PathFit
from estimation.channel.model.path_model import PathParameters
from scenes.record import IntArray
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


def test_mirrored_pairs_keep_their_centroids_and_come_back() -> None:
    paths = PathParameters(
        np.array([10.0, 10.4, 30.0]), np.array([[0.1], [0.2], [1.0]]), np.array([[3.1], [-3.1], [0.0]]),
        np.array([3.0, 1j, 2.0]),
    )  # fmt: skip
    first, second = _mirrored(paths, np.array([[0, 1], [1, 2]])).take(slice(2)), paths.take(slice(2))
    assert np.abs(second.amplitude) @ (first.delay_bins - second.delay_bins) == pytest.approx(0)
    assert first.delay_bins[0] > first.delay_bins[1]
    twice = _mirrored(first, np.array([[0, 1]]))
    np.testing.assert_allclose(twice.delay_bins, second.delay_bins)
    np.testing.assert_allclose(np.sin(twice.aoa_rad), np.sin(second.aoa_rad), atol=1e-12)


@pytest.fixture(scope="module")
def fitted() -> tuple[Reference, Solution]:
    """A group and a path apart, fitted."""
    stop = _group(2)
    paths = _fit(stop).paths
    solution = refine_paths(Reference(stop.compressed, paths), paths, 30)
    return Reference(stop.compressed, solution.paths), solution


def _numbered(n_paths: int) -> IntArray:
    return np.array([[i, j] for i in range(n_paths) for j in range(n_paths) if i < j])


def test_pairs_in_place_gain_nothing(fitted: tuple[Reference, Solution]) -> None:
    reference, solution = fitted
    pairs = _numbered(len(solution.paths))
    refined, gain = refine_pairs(reference, solution, pairs, solution.paths.take(pairs.ravel()), 8)
    np.testing.assert_allclose(gain, 0.0, atol=0.1)
    np.testing.assert_allclose(refined.delay_bins, solution.paths.delay_bins[pairs.ravel()], atol=0.01)


def test_a_pair_of_two_gains_what_a_joint_fit_gains(fitted: tuple[Reference, Solution]) -> None:
    """With no path beside them nothing is linearised, and all delays are within reach."""
    reference, solution = fitted
    two = refine_paths(
        Reference(reference.sweep, solution.paths.take(slice(2))), solution.paths.take(slice(2)), 30
    )
    reference, pair = Reference(reference.sweep, two.paths), np.array([[0, 1]])
    moved = two.paths.moved(np.array([[0.4], [-0.3]]) * np.array([1, 0.01, 0.01, 0.01])[: two.slope.shape[1] - 2])
    refined, gain = refine_pairs(reference, solve_at(reference, two.paths), pair, moved, 30)
    joint = refine_paths(reference, moved, 30)
    assert gain[0] == pytest.approx(joint.explained - two.explained, abs=1e-3 * two.explained)
    np.testing.assert_allclose(refined.delay_bins, joint.paths.delay_bins, atol=0.01)


def test_normal_equations_of_pairs_are_derivatives_of_what_they_explain(
    fitted: tuple[Reference, Solution],
) -> None:
    """With the paths near them eliminated: half the gradient by central differences."""
    reference, solution = fitted
    pairs = np.array([[0, 1], [1, 2]])
    near = np.array([[2, 3], [0, -1]])
    problem = _PairSamples.of(reference, solution, solution.paths.take(pairs.ravel()), near)
    places = _mirrored(solution.paths, pairs)
    at = problem.at(places)
    slope, step = at.slope.reshape(2, 2, -1), 1e-5
    for parameter in range(slope.shape[2] - 2):
        for path in range(2):
            move = np.zeros((4, slope.shape[2] - 2))
            move[path::2, parameter] = step
            after, before = (problem.at(places.moved(sign * move)).explained for sign in (1, -1))
            scale = np.abs(slope[:, :, 2 + parameter]).max()
            np.testing.assert_allclose(
                (after - before) / (4 * step), slope[:, path, 2 + parameter], atol=1e-3 * scale
            )


def test_screened_pairs_gain_what_the_trial_finds(fitted: tuple[Reference, Solution]) -> None:
    """The prediction with linearised neighbours ranks pairs as the fit with all of them does."""
    predicted, found = [], []
    for seed in range(6):
        stop = _group(seed)
        paths = _fit(stop).paths
        solution = refine_paths(Reference(stop.compressed, paths), paths, 10)
        reference = Reference(stop.compressed, solution.paths)
        pairs = _numbered(len(solution.paths))
        places, gain = refine_pairs(reference, solution, pairs, _mirrored(solution.paths, pairs), 8)
        for number, pair in enumerate(pairs):
            two = places.take(np.array([2 * number, 2 * number + 1]))
            trial = refine_paths(reference, solution.paths.with_paths(pair, two), 8)
            predicted.append(gain[number] > LEAST_GAIN)
            found.append(trial.explained > solution.explained + LEAST_GAIN)
    missed = np.array(found) & ~np.array(predicted)
    assert missed.sum() <= 0.1 * len(found)
