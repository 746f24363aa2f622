"""The made-up stops are what they say, and their samples are those of the model behind the bounds."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from estimation.channel.model.crb import path_snr_db
from isac_arena.validation.scenarios.link_bench import (
    EDGE_SINE,
    PAIR_CELLS,
    SEPARATED_CELLS,
    diffuse_background,
    draw_paths,
    equal_pair,
    make_bench,
    nearest,
    noise_stop,
    observe_paths,
    single_path,
    true_bounds,
    with_settings,
)
from sim.signal.arrays.codebook import beam_response


@pytest.fixture(scope="module")
def bench():
    return make_bench(3)


@pytest.fixture(scope="module")
def stop(bench):
    paths = draw_paths(np.random.default_rng(1), bench.cell, strongest_db=(30.0, 30.0))
    return observe_paths(bench, paths, 5)


def test_the_link_is_that_of_the_issue(bench):
    assert (bench.tx.n_beams, bench.rx.n_beams, bench.n_subcarriers) == (32, 32, 3168)
    assert (bench.tx.n_angles, bench.rx.n_angles) == (1, 1)
    sine = np.sin(bench.link.tx_codebook.azimuth_rad)
    assert_allclose(np.diff(sine), 2 * np.sin(np.pi / 3) / 32, rtol=1e-9)
    assert_allclose(bench.cell, [1 / (3168 * 120e3), 0.125, 0.125])


def test_paths_are_drawn_as_described(bench):
    in_pairs, total = 0, 0
    for seed in range(200):
        paths = draw_paths(np.random.default_rng(seed), bench.cell, strongest_db=(20.0, 40.0))
        assert 5 <= len(paths) <= 12 and np.all(np.diff(paths.delay_s) >= 0)
        assert np.argmax(paths.snr_db) == 0 and 20 <= paths.snr_db[0] <= 40
        below = paths.snr_db[0] - paths.snr_db[1:]
        assert np.all((below >= 3) & (below <= 20))
        assert np.all(np.abs(paths.cells[:, 1:]) <= EDGE_SINE)
        apart = nearest(paths.cells / bench.cell)
        paired = apart < SEPARATED_CELLS
        assert np.all((apart[paired] >= PAIR_CELLS[0] - 1e-9) & (apart[paired] <= PAIR_CELLS[1] + 1e-9))
        in_pairs, total = in_pairs + paired.sum(), total + len(paths)
    assert in_pairs / total == pytest.approx(0.25, abs=0.05)


def test_samples_are_the_model_of_the_bounds_plus_white_noise(bench, stop):
    """No simulator code here: manifolds, delays and gains alone must leave noise of the nominal power."""
    link, parameters = bench.link, stop.paths.parameters
    tx = beam_response(link.tx_codebook, parameters[:, 1])
    rx = beam_response(link.rx_codebook, parameters[:, 2])
    wave = np.exp(-2j * np.pi * parameters[:, :1] * link.frequency_offset_hz)
    left = np.empty_like(stop.sweep.samples)
    for beam in range(32):
        pairs = tx[beam] * stop.amplitude * rx
        left[beam] = stop.sweep.samples[beam] - (pairs @ wave) * link.prs_symbol[beam]
    power = np.mean(np.abs(left) ** 2, axis=(0, 2)) / link.noise_power_mw
    assert_allclose(power, 1, atol=5 / np.sqrt(32 * 3168))
    snr = path_snr_db(
        bench.tx, bench.rx, 3168, link.noise_power_mw, parameters[:, 1:2], parameters[:, 2:], stop.amplitude
    )
    assert_allclose(snr, stop.paths.snr_db)


def test_a_stop_is_the_same_bits_again_and_another_one_has_other_noise(bench, stop):
    again = observe_paths(bench, stop.paths, 5)
    assert_array_equal(again.sweep.samples, stop.sweep.samples)
    assert np.any(observe_paths(bench, stop.paths, 6).sweep.samples != stop.sweep.samples)


def test_random_pair_phases_leave_magnitudes_and_spread_over_the_circle(bench):
    strong = single_path(np.random.default_rng(2), 80.0)
    kept = observe_paths(bench, strong, 0).sweep.samples
    lost = observe_paths(with_settings(bench, phase_noise_pair_deg=180.0), strong, 0).sweep.samples
    turn = np.sum(lost * kept.conj(), axis=2)
    seen = np.sum(np.abs(kept) ** 2, axis=2) > 100 * np.mean(bench.link.noise_power_mw) * 3168
    assert_allclose(np.abs(turn[seen]), np.sum(np.abs(kept) ** 2, axis=2)[seen], rtol=0.05)
    n = int(seen.sum())
    assert np.abs(np.mean(np.exp(1j * np.angle(turn[seen])))) < 3.5 / np.sqrt(n)


def test_bounds_of_pairs_are_wider_than_those_of_separate_paths(bench):
    pair = equal_pair(np.random.default_rng(3), bench.cell, axis=1, cells=0.4, snr_db=30.0)
    assert_allclose(np.diff(np.sort(pair.aod_sine)), 0.4 * bench.cell[1])
    bounds = true_bounds(bench, observe_paths(bench, pair, 0), coherent=True)
    assert np.all(bounds.loss_db > 3) and np.allclose(bounds.separation, 0.4)
    lone = single_path(np.random.default_rng(3), 30.0)
    bounds = true_bounds(bench, observe_paths(bench, lone, 0), coherent=True)
    assert_allclose(bounds.loss_db, 0, atol=1e-9)
    assert np.isinf(bounds.separation).all()


def test_the_background_has_the_power_asked_for(bench):
    rng = np.random.default_rng(4)
    paths = single_path(rng, 30.0)
    background = diffuse_background(rng, bench, paths, below_db=10.0, n=20_000)
    strongest = np.abs(observe_paths(bench, paths, 0).amplitude[0]) ** 2 / bench.link.tx_power_mw
    assert 10 * np.log10(background.power.sum() / strongest) == pytest.approx(-10, abs=0.15)
    assert np.all(background.delay_s >= paths.delay_s[0])


def test_noise_alone_is_noise_alone(bench):
    samples = noise_stop(bench, 0).samples
    assert np.mean(np.abs(samples) ** 2) / bench.link.noise_power_mw[0] == pytest.approx(1, abs=0.01)
