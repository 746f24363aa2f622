"""Dense diffuse background: noise if it is dense, no effect if there is none."""

import numpy as np

from estimation.channel.coherent.diffuse import fit_over_background, resolved_paths
from estimation.channel.coherent.misfit import background_over_delay
from estimation.channel.coherent.paths import PreparedStop, compress_stop, fit_coherent
from estimation.channel.coherent.refine import Reference, refine_paths
from estimation.channel.config import MaximumLikelihoodConfig
from estimation.channel.model.path_model import PathParameters
from isac_arena.validation.scenarios.link_bench import (
    diffuse_background,
    draw_paths,
    make_bench,
    observe_paths,
    single_path,
)
from scenes.record import FloatArray
from tests.estimation.channel.plain_sweeps import plain_link, plain_paths, plain_sweep


def test_without_a_background_it_is_the_coherent_fit() -> None:
    bench, rng = make_bench(1), np.random.default_rng(1)
    for stop in range(2):
        paths = draw_paths(rng, bench.cell, strongest_db=(20.0, 40.0))
        sweep = observe_paths(bench, paths, stop).sweep
        plain, over = fit_coherent(sweep), fit_over_background(sweep)
        assert len(over) == len(plain)
        std_s = np.sqrt(plain.covariance[:, 0, 0])  # where the likelihood is flat, steps end at their tolerance
        assert (np.abs(over.delay_s - plain.delay_s) < 0.1 * std_s).all()
        ratio = over.covariance[:, 0, 0] / plain.covariance[:, 0, 0]
        assert (ratio > 0.99).all()
        assert np.median(ratio) < 1.3


def test_diffuse_power_is_taken_as_noise() -> None:
    bench, rng = make_bench(1), np.random.default_rng([1, 4])
    plain, over, nees = 0, 0, []
    for stop in range(8):
        paths = single_path(rng, 33.0)
        background = diffuse_background(rng, bench, paths, below_db=10.0)
        sweep = observe_paths(bench, paths, stop, background).sweep
        plain += len(fit_coherent(sweep)) - 1
        fit = fit_over_background(sweep)
        over += int((~fit.is_weak).sum()) - 1
        best = int(np.argmax(fit.snr_db))
        found = np.array([fit.delay_s[best], fit.aod_rad[best, 0], fit.aoa_rad[best, 0]])
        error = found - paths.parameters[0]
        nees.append(error @ np.linalg.solve(fit.covariance[best], error) / 3)
    assert over <= 0.4 * plain
    assert np.mean(nees) < 2.0


def test_the_background_over_delay_is_one_if_noise_explains_it() -> None:
    rng = np.random.default_rng(2)
    shape = (16, 16, 200)
    noise = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)
    assert (background_over_delay(noise) == 1).all()
    power = 1 + 4 * np.exp(-np.arange(200) / 20)
    found = background_over_delay(noise * np.sqrt(power))
    np.testing.assert_allclose(found[:60], power[:60], rtol=0.15)
    assert (found[180:] == 1).all()


def test_many_paths_are_found_and_known_within_their_covariances() -> None:
    """Sixty paths in three hundred delay bins, where paths share cells of one axis but not of all."""
    link, rng = plain_link(), np.random.default_rng(7)
    n = 60
    delay_ns = np.sort(rng.uniform(50, 850, n))
    angles = rng.uniform(-50, 50, (2, n))
    paths = plain_paths(link, delay_ns, *angles, rng.uniform(20, 40, n), phase=rng.uniform(0, 6.28, n))
    fit = fit_over_background(
        plain_sweep(link, paths, rng), MaximumLikelihoodConfig(max_paths=120, delay_after_ns=900)
    )
    fit = fit.take("path", ~fit.is_weak)
    away = np.abs(fit.delay_s[:, None] - 1e-9 * delay_ns) / 1e-9
    for found, true in ((fit.aod_rad[:, 0], angles[0]), (fit.aoa_rad[:, 0], angles[1])):
        away = np.maximum(away, np.abs(np.rad2deg(found)[:, None] - true) / 3)
    assert (away.min(axis=0) < 1).mean() >= 0.95
    assert (away.min(axis=1) < 1).mean() >= 0.95


def _resolved_two(true_cells: list[float], fitted_cells: list[float]) -> FloatArray:
    """Delays in cells from 200 ns of what `resolved_paths` leaves of two fitted paths."""
    link, cell_ns, n = plain_link(), 1e9 / (288 * 120e3), len(true_cells)
    paths = plain_paths(
        link, 200.0 + cell_ns * np.array(true_cells), [5.0] * n, [-9.0] * n, 50.0, phase=[0.0, 2.0][:n]
    )
    stop = compress_stop(plain_sweep(link, paths, np.random.default_rng(4)), None, None, None)
    assert isinstance(stop, PreparedStop)
    sweep, first_bin = stop.compressed, 200e-9 / stop.compressed.bin_s
    alike = (value[:1].repeat(2, axis=0) for value in (paths.aod_rad, paths.aoa_rad, paths.amplitude))
    two = PathParameters(first_bin + np.array(fitted_cells), *alike)
    fitted = refine_paths(Reference(sweep, two.take(slice(0))), two, 1)
    return resolved_paths(sweep, fitted, stop.window).paths.delay_bins - first_bin


def test_a_path_that_its_neighbour_replaces_is_left_out() -> None:
    np.testing.assert_allclose(_resolved_two([0.0], [-0.1, 0.1]), [0.0], atol=0.01)


def test_two_paths_that_none_replaces_are_kept() -> None:
    np.testing.assert_allclose(np.sort(_resolved_two([-0.4, 0.4], [-0.4, 0.4])), [-0.4, 0.4], atol=0.02)
