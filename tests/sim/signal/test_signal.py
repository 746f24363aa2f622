"""Equation (1), noise, link budget and campaign determinism."""

import numpy as np
import pytest

from isac_arena.validation.scenarios.paths import random_paths
from scenes.pose import Pose
from scenes.record import concatenate
from sim.config import ArrayConfig, ClockConfig, SimulationConfig, WaveformConfig
from sim.propagation.paths import canonical_order, empty_paths
from sim.signal.arrays.array import element_amplitude, steering_vector
from sim.signal.generation import beam_channel
from sim.signal.link import make_link
from sim.signal.noise import add_noise
from sim.signal.power import noise_power_mw
from sim.simulate import RandomStage, clock_biases_s, stage_generator

SMALL = SimulationConfig(
    scene="none",
    waveform=WaveformConfig(n_rb=24, comb=12),
    tx_array=ArrayConfig(rows=2, columns=3, beams_per_panel=3),
    rx_array=ArrayConfig(rows=1, columns=4, panel_azimuth_deg=[0.0, 90.0], beams_per_panel=2, sector_deg=90.0),
)


def test_samples_are_equation_1_term_by_term() -> None:
    rng = np.random.default_rng(1)
    link, paths = make_link(SMALL), random_paths(rng, 4, 3.0, 1.0)
    tx_pose, rx_pose, bias_s = Pose(np.zeros(3), 0.7), Pose(np.ones(3), -1.1), 3e-8
    channel = beam_channel(
        paths, tx_codebook=link.tx_codebook, rx_codebook=link.rx_codebook, tx_pose=tx_pose, rx_pose=rx_pose,
        frequency_offset_hz=link.frequency_offset_hz, clock_bias_s=bias_s,
    )  # fmt: skip
    expected = np.zeros(channel.shape, complex)
    for m, n, k in np.ndindex(channel.shape):
        for i in range(len(paths)):
            gains = 1.0 + 0j
            for book, beam, azimuth, elevation in (
                (link.tx_codebook, m, paths.aod_azimuth_rad[i] - 0.7, paths.aod_elevation_rad[i]),
                (link.rx_codebook, n, paths.aoa_azimuth_rad[i] + 1.1, paths.aoa_elevation_rad[i]),
            ):
                local = azimuth - book.panel_azimuth_rad[beam]
                steering = steering_vector(book.element_position_m, 60e9, local, elevation)
                gains *= (book.weights[beam] * steering).sum() * element_amplitude("tr38901", local, elevation)
            delay = paths.delay_s[i] + bias_s
            expected[m, n, k] += paths.gain[i] * gains * np.exp(-2j * np.pi * link.frequency_offset_hz[k] * delay)
    np.testing.assert_allclose(channel, expected, atol=2e-5 * np.abs(expected).max())


def test_no_paths_give_silence() -> None:
    link, pose = make_link(SMALL), Pose(np.zeros(3), 0.0)
    channel = beam_channel(
        empty_paths(["wall"]), tx_codebook=link.tx_codebook, rx_codebook=link.rx_codebook, tx_pose=pose,
        rx_pose=pose, frequency_offset_hz=link.frequency_offset_hz, clock_bias_s=0.0,
    )  # fmt: skip
    assert channel.shape == (3, 4, 24) and not channel.any()


def test_noise_has_the_stated_power_and_is_white() -> None:
    power = np.array([1e-8, 4e-8])
    noise = add_noise(np.zeros((40, 2, 2000), np.complex64), power, np.random.default_rng(2))
    assert noise.dtype == np.complex64
    measured = (np.abs(noise) ** 2).mean(axis=(0, 2))
    np.testing.assert_allclose(measured, power, rtol=5 / np.sqrt(80_000))
    lag = (noise[:, :, 1:] * noise[:, :, :-1].conj()).mean(axis=(0, 2))
    assert (np.abs(lag) < 5 * power / np.sqrt(80_000)).all()
    pseudo = (noise**2).mean(axis=(0, 2))
    assert (np.abs(pseudo) < 5 * power * np.sqrt(2) / np.sqrt(80_000)).all()


def test_thermal_noise_floor() -> None:
    assert 10 * np.log10(noise_power_mw(1.0, 0.0)) == pytest.approx(-173.98, abs=0.01)
    assert 10 * np.log10(noise_power_mw(190.08e6, 10.0)) == pytest.approx(-81.19, abs=0.01)


def test_every_stage_and_stop_draws_its_own_numbers() -> None:
    draws = {
        (seed, stage, stop): stage_generator(seed, stage, stop).random()
        for seed in (1, 2)
        for stage in RandomStage
        for stop in range(3)
    }
    assert len(set(draws.values())) == len(draws)
    assert draws[1, RandomStage.NOISE, 2] == stage_generator(1, RandomStage.NOISE, 2).random()


def test_clock_is_a_random_walk_and_a_prefix_of_a_longer_one() -> None:
    config = SMALL.model_copy(update={"clock": ClockConfig(initial_bias_ns=10, walk_std_ns=2)})
    long = clock_biases_s(config, 4000)
    np.testing.assert_array_equal(clock_biases_s(config, 10), long[:10])
    assert np.std(np.diff(long)) == pytest.approx(2e-9, rel=0.05)
    still = SMALL.model_copy(update={"clock": ClockConfig(initial_bias_ns=10, walk_std_ns=0)})
    np.testing.assert_allclose(clock_biases_s(still, 5), 1e-8)


def test_canonical_order_does_not_depend_on_the_order_given() -> None:
    rng = np.random.default_rng(3)
    paths = random_paths(rng, 50)
    shuffled = paths.take("path", rng.permutation(50))
    np.testing.assert_array_equal(canonical_order(paths).gain, canonical_order(shuffled).gain)
    halves = concatenate([paths.take("path", slice(0, 20)), paths.take("path", slice(20, None))], "path")
    np.testing.assert_array_equal(halves.delay_s, paths.delay_s)
