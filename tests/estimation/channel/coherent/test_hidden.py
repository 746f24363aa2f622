"""Possible further paths: their scores against brute force, and the errors that undetected ones cause."""

import numpy as np
import pytest

from estimation.channel.coherent.hidden import KnownPaths, probes_about
from estimation.channel.coherent.misfit import error_scale, quadrature_statistic
from estimation.channel.coherent.neighbours import _learned_odds, neighbour_covariance
from estimation.channel.coherent.refine import Reference, Solution, marginal_covariances, refine_paths
from estimation.channel.model.path_model import (
    PathParameters,
    PathTangents,
    cells_apart,
    manifold_rates,
    responses,
    tangents,
)
from scenes.pose import wrap_angle
from scenes.record import BoolArray, ComplexArray, FloatArray
from tests.estimation.channel.plain_sweeps import PlainPaths, compressed, plain_link, plain_paths, plain_sweep

SMALL = plain_link()
GROUPS = 12


def _fitted(paths: PlainPaths, known: BoolArray, seed: int) -> tuple[Reference, Solution]:
    """The best fit of the `known` paths alone, to samples of all."""
    sweep = compressed(plain_sweep(SMALL, paths, np.random.default_rng(seed)))
    every = PathParameters(paths.delay_s / sweep.bin_s, paths.aod_rad, paths.aoa_rad, paths.amplitude)
    start = every.take(known)
    solution = refine_paths(Reference(sweep, start.take(slice(0))), start, 30)
    return Reference(sweep, solution.paths), solution


def _vectors(at: PathTangents) -> ComplexArray:
    """All tangents (path, tangent, cell) of paths, written out."""
    value, slopes = [part[:, 0] for part in (at.tx, at.rx, at.delay)], []
    for axis, part in ((2, at.delay), (0, at.tx), (1, at.rx)):
        for k in range(1, part.shape[1]):
            slopes.append([part[:, k] if axis == own else value[own] for own in range(3)])
    every = [np.einsum("pm,pn,pd->pmnd", *factors).reshape(len(value[0]), -1) for factors in (value, *slopes)]
    return np.stack(every, axis=1)


def _real(columns: ComplexArray) -> FloatArray:
    return np.concatenate([columns.real, columns.imag], axis=-1)


def test_scores_of_probes_are_those_of_a_dense_least_squares() -> None:
    paths = plain_paths(SMALL, [200.0, 202.0], [5.0, 9.0], [-9.0, -4.0], [35.0, 30.0], phase=[0.3, 2.0])
    reference, solution = _fitted(paths, np.array([True, True]), 1)
    first = solution.paths.take(slice(1))
    rate = manifold_rates(reference.sweep, first)
    probes = probes_about(first, rate[0], 2)
    assert len(probes) == 6 + 12
    assert np.allclose(cells_apart(probes, first, rate), 0.5)
    test = KnownPaths(reference, solution).test(probes, np.ones(2, bool))
    known = _vectors(tangents(reference.sweep, solution.paths))
    amplitude = solution.paths.amplitude[:, None, None]
    columns = np.concatenate([known[:, :1], 1j * known[:, :1], amplitude * known[:, 1:]], axis=1)
    design = _real(columns.reshape(-1, columns.shape[2]))
    rest = _real((reference.parts[0] + 1j * reference.parts[1]).ravel())
    rest = rest - design.T @ np.linalg.lstsq(design.T, rest, rcond=None)[0]
    value = _vectors(responses(reference.sweep, probes))[:, 0]
    for probe in range(len(probes)):
        two = np.stack([_real(value[probe]), _real(1j * value[probe])])
        coefficients = np.linalg.lstsq(design.T, two.T, rcond=None)[0]
        left = two - coefficients.T @ design
        np.testing.assert_allclose(test.own[probe], left @ left.T, rtol=1e-3, atol=1e-3 * test.energy[probe])
        np.testing.assert_allclose(test.score[probe], left @ rest, atol=2e-2 * np.sqrt(test.energy[probe]))
        shift = coefficients.T.reshape(2, 2, -1)[:, :, 2:]
        np.testing.assert_allclose(test.shift[probe], shift, rtol=1e-2, atol=1e-3 * np.abs(shift).max())


def test_a_path_errs_by_the_shift_of_the_neighbour_that_is_left_out() -> None:
    ratio_db, errors, expected = -40.0, [], []
    for phase in (0.0, 1.0, 2.5):
        paths = plain_paths(
            SMALL, [200.0, 212.0], [5.0, 5.0], [-9.0, -9.0], [90.0, 90.0 + ratio_db], phase=[0.0, phase]
        )
        reference, solution = _fitted(paths, np.array([True, False]), 2)
        places = np.concatenate([paths.delay_s[:1] / reference.sweep.bin_s, paths.aod_rad[0], paths.aoa_rad[0]])
        found = solution.paths
        errors.append(np.concatenate([found.delay_bins, found.aod_rad[0], found.aoa_rad[0]]) - places)
        second = PathParameters(
            paths.delay_s[1:] / reference.sweep.bin_s, paths.aod_rad[1:], paths.aoa_rad[1:], paths.amplitude[1:]
        )
        test = KnownPaths(reference, solution).test(second, np.ones(1, bool))
        amplitude = paths.amplitude[1] * solution.paths.amplitude[0] / paths.amplitude[0]  # as compressed
        expected.append(np.array([amplitude.real, amplitude.imag]) @ test.shift[0, :, 0])
    np.testing.assert_allclose(np.array(errors)[:, 0], np.array(expected)[:, 0], rtol=0.05, atol=2e-6)


@pytest.mark.parametrize("has_neighbours", [True, False])
def test_covariances_hold_with_and_without_undetected_neighbours(has_neighbours: bool) -> None:
    """Twelve paths far apart, each with a neighbour within half a cell that no test finds, or none."""
    nees, plain = [], []
    for trial in range(6):
        rng = np.random.default_rng([trial, 5])
        delay = 100.0 + 60 * np.arange(GROUPS)
        angles = rng.uniform(-45, 45, (2, GROUPS))
        offset = rng.uniform(-1, 1, (3, GROUPS)) * np.array([[9.0], [5.0], [5.0]])  # half a cell each
        snr = rng.uniform(25, 40, GROUPS)
        weaker = rng.uniform(-22, -8, GROUPS) if has_neighbours else np.full(GROUPS, -300.0)
        paths = plain_paths(
            SMALL,
            np.concatenate([delay, delay + offset[0]]),
            np.concatenate([angles[0], angles[0] + offset[1]]),
            np.concatenate([angles[1], angles[1] + offset[2]]),
            np.concatenate([snr, snr + weaker]),
            phase=rng.uniform(0, 6.28, 2 * GROUPS),
        )
        reference, solution = _fitted(paths, np.arange(2 * GROUPS) < GROUPS, trial)
        by_noise = marginal_covariances(solution, reference.sweep.n_subcarriers)
        by_neighbours, probability = neighbour_covariance(reference, solution, np.ones(len(solution.paths)))
        scale = error_scale(*quadrature_statistic(reference, solution))
        assert ((probability >= 0) & (probability <= 1)).all()
        found = solution.paths
        error = np.concatenate(
            [
                (found.delay_bins - paths.delay_s[:GROUPS] / reference.sweep.bin_s)[:, None],
                wrap_angle(found.aod_rad - paths.aod_rad[:GROUPS]),
                wrap_angle(found.aoa_rad - paths.aoa_rad[:GROUPS]),
            ],
            axis=1,
        )
        for covariance, values in ((by_noise, plain), (scale[:, None, None] * by_noise + by_neighbours, nees)):
            values.append(np.einsum("pi,pij,pj->p", error, np.linalg.inv(covariance), error) / 3)
    if has_neighbours:
        assert np.mean(plain) > 5
        assert 0.3 < np.mean(nees) < 1.6
        assert np.mean(np.concatenate(nees) < 7.815 / 3) > 0.9
    else:
        assert 0.85 < np.mean(nees) / np.mean(plain) <= 1  # neighbours much closer than a cell may be there


def test_the_odds_of_a_neighbour_follow_the_evidence() -> None:
    assert _learned_odds(np.full(40, 1e-3)) < 0.1
    assert _learned_odds(np.full(40, 1e3)) > 20
    half = np.concatenate([np.full(200, 1e4), np.full(200, 1e-4)])
    assert _learned_odds(half) == pytest.approx(1.0, rel=0.05)
