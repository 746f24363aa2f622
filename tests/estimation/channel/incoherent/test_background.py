"""The noise of a path in its own beam pairs and delays: correct, and part of the covariances."""

import numpy as np
import pytest

from estimation.channel.incoherent.background import NOTABLE, Background
from estimation.channel.incoherent.likelihood import LinkBeams
from estimation.channel.incoherent.paths import fit_incoherent
from estimation.channel.model.manifold import Manifold
from isac_arena.validation.scenarios.link_bench import (
    diffuse_background,
    draw_paths,
    make_bench,
    observe_paths,
    single_path,
)
from tests.estimation.channel.plain_sweeps import plain_link

LINK = plain_link()
ENDS = LinkBeams(Manifold(LINK.tx_codebook), Manifold(LINK.rx_codebook), np.ones(10))
PATHS = np.array([[30.2, -0.3, 0.2, 0.0, 0.0], [70.0, 0.5, -0.4, 0.0, 0.0]])
BINS, N_BINS = np.arange(100), 288


def noise(power: np.ndarray, seed: int) -> Background:
    rng = np.random.default_rng(seed)
    residual = (rng.standard_normal((100, 100)) + 1j * rng.standard_normal((100, 100))) * np.sqrt(power / 2)
    return Background.of(residual, BINS, N_BINS)


def test_noise_alone_is_no_background() -> None:
    rises = [noise(np.ones((100, 100)), seed).noise_factor(ENDS, PATHS) for seed in range(200)]
    assert np.mean(np.array(rises) > 1) < 0.03
    widening = [noise(np.ones((100, 100)), seed).covariance_factor(ENDS, PATHS) for seed in range(20)]
    assert (np.array(widening) == 1).all()


@pytest.mark.parametrize("sides", ["both", "after"])
def test_the_noise_factor_is_the_power_around_a_path_in_its_own_beams(sides: str) -> None:
    power = np.ones((100, 100))
    power[:, 31 if sides == "after" else 10 : 50] = 5.0
    rises = np.array([noise(power, seed).noise_factor(ENDS, PATHS) for seed in range(50)])
    assert rises[:, 0].mean() == pytest.approx(5.0, rel=0.1)
    assert (rises[:, 1] == 1).mean() > 0.95
    share = np.abs(ENDS.amplitudes(PATHS)[:, 0]) ** 2
    power = np.ones((100, 100))
    power[share < 0.01 * share.max()] = 10.0  # loud where the path is not
    assert noise(power, 1).noise_factor(ENDS, PATHS)[0] < NOTABLE


def test_a_few_other_paths_are_no_background() -> None:
    power = np.ones((100, 100))
    power[:, [26, 27, 35, 36]] = 1e4
    assert noise(power, 3).noise_factor(ENDS, PATHS)[0] == 1.0


def test_residual_power_in_the_own_cells_of_a_path_widens_its_covariance() -> None:
    power = np.ones((100, 100))
    power[:, 29:32] = 20.0
    found = noise(power, 4).covariance_factor(ENDS, PATHS)
    assert found[0] == pytest.approx(20.0, rel=0.35)
    assert found[1] == 1.0


def test_clean_stops_are_fitted_as_without_a_background() -> None:
    bench, rng = make_bench(1, phase_noise_pair_deg=180.0), np.random.default_rng(3)
    paths = draw_paths(rng, bench.cell, strongest_db=(30.0, 40.0))
    fit = fit_incoherent(observe_paths(bench, paths, 0).sweep)
    assert len(fit) == len(paths)
    assert (fit.snr_db.max() - fit.snr_db).max() < 25


def test_a_path_over_diffuse_power_is_one_path_with_an_honest_covariance() -> None:
    bench, rng = make_bench(1, phase_noise_pair_deg=180.0), np.random.default_rng([1, 4])
    extra, nees = 0, []
    for stop in range(8):
        paths = single_path(rng, 30.0)
        background = diffuse_background(rng, bench, paths, below_db=10.0)
        fit = fit_incoherent(observe_paths(bench, paths, stop, background).sweep)
        extra += len(fit) - 1
        best = int(np.argmax(fit.snr_db))
        found = np.array([fit.delay_s[best], fit.aod_rad[best, 0], fit.aoa_rad[best, 0]])
        error = found - paths.parameters[0]
        nees.append(error @ np.linalg.solve(fit.covariance[best], error) / 3)
    assert extra <= 5  # 0.3 a stop, and three standard deviations of chance
    assert np.mean(nees) < 2.4
