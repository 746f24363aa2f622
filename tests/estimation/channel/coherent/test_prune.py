"""Redundant paths, and refinement of only the near ones."""

import numpy as np

from estimation.channel.coherent.prune import hidden_second_paths, prune_paths, redundant_paths
from estimation.channel.coherent.refine import (
    Reference,
    paths_near,
    refine_near,
    refine_paths,
    solve_amplitudes,
    solve_at,
)
from estimation.channel.model.cholesky import regular_inverse
from estimation.channel.model.path_model import PathParameters
from tests.estimation.channel.plain_sweeps import compressed, plain_link, plain_paths, plain_sweep

SMALL = plain_link()


def _fitted(delay_ns: list[float], snr_db: float = 30.0) -> tuple[Reference, PathParameters]:
    n = len(delay_ns)
    angles = np.linspace(-40, 40, n)
    paths = plain_paths(SMALL, delay_ns, angles, angles[::-1], snr_db, phase=np.arange(n))
    sweep = compressed(plain_sweep(SMALL, paths, np.random.default_rng(3)))
    places = PathParameters(paths.delay_s / sweep.bin_s, paths.aod_rad, paths.aoa_rad, paths.amplitude)
    return Reference(sweep, places.take(slice(0))), places


def test_of_two_for_one_path_one_is_redundant() -> None:
    reference, truth = _fitted([100.0, 400.0])
    double = truth.joined(truth.take(slice(1)).moved(np.array([[0.1, 0.0, 0.0]])))
    solution = solve_at(reference, double)
    dropped = redundant_paths(solution, np.full(3, 24.0))
    assert dropped.sum() == 1
    assert not dropped[1]


def test_loss_of_a_redundant_path_is_the_increase_of_the_residual() -> None:
    """A weak path alone in its place: the linear model is exact, its power is what is lost."""
    reference, truth = _fitted([100.0, 400.0, 900.0], 20.0)
    solution = refine_paths(reference, truth, 30)
    without = refine_paths(reference, truth.take(np.array([True, False, True])), 30)
    loss = solution.explained - without.explained
    for share, expected in ((0.99, False), (1.01, True)):
        level = np.array([0.0, share * loss, 0.0])
        assert redundant_paths(solution, level)[1] == expected


def test_refining_near_paths_equals_refining_all_if_the_others_are_far() -> None:
    reference, truth = _fitted(list(np.linspace(50, 8000, 30)))
    start = truth.moved(np.where(np.arange(30)[:, None] == 7, [0.2, 0.02, 0.02], 0.0))
    about = start.take(slice(7, 8))
    assert list(np.flatnonzero(paths_near(reference.sweep, start, about))) == [7]
    local, whole = refine_near(reference, start, about, 30), refine_paths(reference, start, 30)
    assert np.allclose(local.paths.delay_bins[7], whole.paths.delay_bins[7], atol=0.03)
    assert np.allclose(local.paths.aod_rad[7], whole.paths.aod_rad[7], atol=3e-3)
    assert np.array_equal(local.paths.delay_bins[:7], start.delay_bins[:7])


def test_amplitudes_alone_are_those_of_the_full_solution() -> None:
    reference, truth = _fitted([100.0, 104.0, 900.0])
    full, quick = solve_at(reference, truth), solve_amplitudes(reference, truth)
    np.testing.assert_allclose(quick.paths.amplitude, full.paths.amplitude, rtol=1e-6)
    assert np.isclose(quick.explained, full.explained)
    np.testing.assert_allclose(quick.information, full.information, rtol=1e-9)
    np.testing.assert_allclose(quick.slope, full.slope, rtol=1e-9)


def test_of_many_paths_the_redundant_ones_go_together_and_no_other() -> None:
    reference, truth = _fitted(list(np.linspace(50, 8000, 30)))
    beside = truth.take(np.arange(0, 30, 6)).moved(np.array([[0.15, 0.0, 0.0]]))
    start = refine_paths(reference, truth.joined(beside), 3)
    found = prune_paths(reference, start, lambda paths: np.full(len(paths), 24.0), 3)
    assert len(found.paths) == 30
    apart = np.abs(found.paths.delay_bins[:, None] - truth.delay_bins)
    assert (apart.min(axis=0) < 0.3).all()


def test_hidden_second_paths_are_found_at_all_places_at_once() -> None:
    reference, truth = _fitted([100.0, 102.0, 900.0, 902.0, 1800.0], 40.0)
    one_each = refine_paths(reference, truth.take(np.array([0, 2, 4])), 30)
    found = hidden_second_paths(Reference(reference.sweep, one_each.paths), one_each, 24.0)
    near = np.abs(found.delay_bins[:, None] - one_each.paths.delay_bins).argmin(axis=1)
    assert {0, 1} <= set(near)
    assert 2 not in near


def test_regular_inverse_is_the_inverse_and_survives_an_unobservable_parameter() -> None:
    rng = np.random.default_rng(4)
    half = rng.standard_normal((30, 40)) * np.logspace(-3, 3, 30)[:, None]
    information = half @ half.T
    np.testing.assert_allclose(regular_inverse(information) @ information, np.eye(30), atol=1e-5)
    information[7], information[:, 7] = 0.0, 0.0
    inverse = regular_inverse(information)
    assert np.isfinite(inverse).all()
    np.testing.assert_allclose(inverse, inverse.T, rtol=1e-12)
