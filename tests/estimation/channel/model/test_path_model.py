"""The path model against dense arrays of the size paths x samples."""

from typing import Any

import numpy as np
import pytest

from estimation.channel.coherent.refine import Reference, marginal_covariances, refine_paths, solve_at
from estimation.channel.model.compress import CompressedSweep, beam_span, compress
from estimation.channel.model.kernels import dirichlet
from estimation.channel.model.manifold import Manifold
from estimation.channel.model.path_model import (
    PathParameters,
    gram_matrix,
    group_gram_matrix,
    normal_equations,
    own_gram_matrix,
    products_with,
    residual,
    response_energies,
    responses,
    tangents,
)
from scenes.record import ComplexArray
from sim.config import ArrayConfig
from tests.estimation.channel.plain_sweeps import plain_link, plain_paths, plain_sweep

TWO_ANGLES = ArrayConfig(columns=4, beams_per_panel=5, beam_elevation_deg=[-15.0, 15.0])


@pytest.fixture(scope="module", params=["azimuth", "elevation"])
def swept(request: Any) -> CompressedSweep:
    """Two paths in noise, seen by ends of one and one, or of two and one angles."""
    link = plain_link(TWO_ANGLES if request.param == "elevation" else None)
    paths = plain_paths(link, [200.0, 242.0], [10.0, -20.0], [-5.0, 20.0], [25.0, 20.0], phase=[0.3, 2.0])
    sweep = plain_sweep(link, paths, np.random.default_rng(1))
    tx, rx = Manifold(link.tx_codebook), Manifold(link.rx_codebook)
    return compress(sweep, beam_span(tx), beam_span(rx, sweep.noise_power_mw)).window(np.arange(-10, 30))


def _guess(sweep: CompressedSweep) -> PathParameters:
    rng = np.random.default_rng(2)
    aod = (
        np.deg2rad([10.3, -20.2])[:, None]
        + 0.05 * rng.standard_normal((2, sweep.tx.n_angles)) * [1, 0][: sweep.tx.n_angles]
    )
    aoa = np.deg2rad([[-5.1], [20.2]])
    return PathParameters(np.array([6.9, 8.35]), aod, aoa, np.array([0.02 + 0.01j, -0.01 + 0.02j]))


def _moved(paths: PathParameters, path: int, parameter: int, step: float) -> PathParameters:
    moves = np.zeros((len(paths), 1 + paths.aod_rad.shape[1] + paths.aoa_rad.shape[1]))
    moves[path, parameter] = step
    return paths.moved(moves)


def _dense(sweep: CompressedSweep, paths: PathParameters) -> ComplexArray:
    """Unit responses (path, all samples) of paths."""
    at = responses(sweep, paths)
    dense = np.einsum("pi,pj,pd->pijd", at.tx[:, 0], at.rx[:, 0], at.delay[:, 0])
    return np.asarray(dense.reshape(len(paths), -1))


def _dense_tangents(sweep: CompressedSweep, paths: PathParameters) -> ComplexArray:
    """Responses and their derivatives (path, tangent, all samples), derivatives by central differences."""
    steps = [1e-4] + [1e-6] * (paths.aod_rad.shape[1] + paths.aoa_rad.shape[1])
    rows = [
        [_dense(sweep, paths)[p]]
        + [
            (_dense(sweep, _moved(paths, p, k, h))[p] - _dense(sweep, _moved(paths, p, k, -h))[p]) / (2 * h)
            for k, h in enumerate(steps)
        ]
        for p in range(len(paths))
    ]
    return np.array(rows)


def test_dirichlet_kernel_is_the_mean_of_its_exponentials() -> None:
    n, position = 48, np.arange(-60, 70)
    near = 3 + np.array([0.0, 1e-6, 3e-4, 9.99e-4, 1.01e-3])
    delay = np.concatenate([np.random.default_rng(0).uniform(-50, 60, 20), near, [-45.0, 51.0004]])
    rate = 2j * np.pi * (np.arange(n) - (n - 1) / 2) / n
    waves = np.exp(rate * (position - delay[:, None])[..., None])
    kernel = dirichlet(position, delay, n)
    assert np.allclose(kernel[:, 0], waves.mean(axis=2), atol=1e-11)
    assert np.allclose(kernel[:, 1], (rate * waves).mean(axis=2), atol=1e-9)


def test_inner_products_are_those_of_dense_arrays(swept: CompressedSweep) -> None:
    paths = _guess(swept)
    dense, at = _dense_tangents(swept, paths), tangents(swept, paths)
    products = dense.conj() @ swept.samples.ravel()
    norm = np.linalg.norm(dense, axis=2) * np.linalg.norm(swept.samples)
    assert np.abs((products_with(swept.parts, at) - products) / norm).max() < 1e-6
    full = np.einsum("pas,qbs->paqb", dense.conj(), dense)
    norm = np.linalg.norm(dense, axis=2)
    assert np.abs((gram_matrix(at, at) - full) / norm[:, :, None, None] / norm).max() < 1e-6
    assert np.allclose(response_energies(at), np.einsum("papa->pa", full)[:, 0].real)


def test_normal_equations_are_products_of_the_real_columns(swept: CompressedSweep) -> None:
    paths, rng = _guess(swept), np.random.default_rng(3)
    dense, at = _dense_tangents(swept, paths), tangents(swept, paths)
    rest = rng.standard_normal((*dense.shape[:2], 2)) @ np.array([1.0, 1j])
    scale = np.repeat(paths.amplitude[:, None], dense.shape[1] - 1, axis=1)
    columns = np.concatenate([dense[:, :1], 1j * dense[:, :1], scale[..., None] * dense[:, 1:]], axis=1)
    matrix, slope = normal_equations(at, rest, paths.amplitude)
    expected = np.einsum("pas,qbs->paqb", columns.conj(), columns).real
    norm = np.linalg.norm(columns, axis=2)
    assert np.abs((matrix - expected) / norm[:, :, None, None] / norm).max() < 1e-6
    assert np.allclose(slope[:, :2], np.stack([rest[:, 0].real, rest[:, 0].imag], axis=1))
    assert np.allclose(slope[:, 2:], (scale.conj() * rest[:, 1:]).real)


def test_residual_is_that_of_dense_arrays(swept: CompressedSweep) -> None:
    paths = _guess(swept)
    rest = swept.samples.ravel() - paths.amplitude @ _dense(swept, paths)
    parts = residual(swept, paths)
    assert np.allclose((parts[0] + 1j * parts[1]).ravel(), rest, atol=1e-4)


def test_normal_equations_are_those_of_least_squares(swept: CompressedSweep) -> None:
    """Slope and information against the Jacobian of the whole sample vector, amplitudes against least squares."""
    paths = _guess(swept)
    solution = solve_at(Reference(swept, paths), paths)
    dense, data = _dense_tangents(swept, paths), swept.samples.ravel()
    amplitude = np.linalg.lstsq(dense[:, 0].T, data, rcond=None)[0]
    assert np.allclose(solution.paths.amplitude, amplitude, rtol=1e-5)
    rest = data - amplitude @ dense[:, 0]
    explained = np.linalg.norm(data) ** 2 - np.linalg.norm(rest) ** 2
    assert np.isclose(solution.explained, explained, rtol=1e-6)
    columns = np.concatenate([dense[:, :1], 1j * dense[:, :1], amplitude[:, None, None] * dense[:, 1:]], axis=1)
    norm = np.linalg.norm(columns, axis=2)
    slope = (columns.conj() @ rest).real
    assert np.abs((solution.slope - slope) / norm / np.linalg.norm(rest)).max() < 1e-6
    information = np.einsum("pas,qbs->paqb", columns.conj(), columns).real
    assert np.abs((solution.information - information) / norm[:, :, None, None] / norm).max() < 1e-6


def test_refinement_ends_where_the_slope_vanishes(swept: CompressedSweep) -> None:
    reference = Reference(swept, _guess(swept))
    start = solve_at(reference, reference.paths)
    best = refine_paths(reference, reference.paths, 30)
    assert best.explained > start.explained
    std = np.sqrt(np.einsum("papa->pa", best.information))
    assert np.abs(best.slope / std).max() < 0.05


def test_reference_does_not_change_the_solution(swept: CompressedSweep) -> None:
    """Only the residual of reference paths is in single precision: far or near ones give the same likelihood."""
    paths = _guess(swept)
    near = Reference(swept, refine_paths(Reference(swept, paths), paths, 30).paths)
    far = Reference(swept, paths.take(slice(0, 0)))
    one, other = solve_at(near, paths), solve_at(far, paths)
    assert np.isclose(one.explained, other.explained, rtol=1e-6)
    assert np.allclose(one.paths.amplitude, other.paths.amplitude, rtol=1e-4)


def test_covariance_is_the_inverse_information_of_the_parameters(swept: CompressedSweep) -> None:
    paths = _guess(swept)
    solution = solve_at(Reference(swept, paths), paths)
    full = np.linalg.inv(2 * solution.flat_information)
    n = solution.slope.shape[1]
    block = full.reshape(2, n, 2, n)[0, 2:, 0, 2:]
    found = marginal_covariances(solution, swept.n_subcarriers)[0]
    scale = np.sqrt(np.diagonal(block))
    assert np.allclose(found / scale[:, None] / scale, block / scale[:, None] / scale, atol=1e-2)


def test_products_within_groups_are_blocks_of_the_gram_matrix(swept: CompressedSweep) -> None:
    six = _guess(swept)
    for step in (0.3, 0.7):
        six = six.joined(_guess(swept).moved(np.full((2, swept.tx.n_angles + swept.rx.n_angles + 1), step)))
    at = tangents(swept, six)
    every = gram_matrix(at, at)
    pairs = group_gram_matrix(at, at, 2)
    threes = group_gram_matrix(tangents(swept, six.take(slice(4))), at, 2, 3)
    for k in range(3):
        block = every[2 * k : 2 * k + 2, :, 2 * k : 2 * k + 2]
        np.testing.assert_allclose(pairs[k], block, rtol=1e-9, atol=1e-9 * np.abs(every).max())
    np.testing.assert_allclose(threes[1], every[2:4, :, 3:6], rtol=1e-9, atol=1e-9 * np.abs(every).max())
    np.testing.assert_allclose(own_gram_matrix(at, at), np.einsum("iaib->iab", every), rtol=1e-9, atol=1e-9)
