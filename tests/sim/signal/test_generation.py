"""The delay grid and the basis of beams against sums taken path by path, and blocks against the whole."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from isac_arena.validation.scenarios.paths import random_paths
from scenes.pose import Pose
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.signal.arrays.codebook import beam_response
from sim.signal.generation import _spanning, beam_channel, beam_channel_blocks, path_waves, sum_over_paths
from sim.signal.link import make_codebook, make_link


def direct(tx: np.ndarray, rx: np.ndarray, delay_s: np.ndarray, frequency_hz: np.ndarray) -> np.ndarray:
    total = np.zeros((tx.shape[1], rx.shape[1], len(frequency_hz)), complex)
    for path, delay in enumerate(delay_s):
        wave = np.exp(-2j * np.pi * frequency_hz * delay)
        total += tx[path, :, None, None] * rx[path, None, :, None] * wave
    return total


@settings(max_examples=25, deadline=None)
@given(
    st.integers(1, 600),
    st.sampled_from([0.0, 1e-9, 3e-8, 3e-7, 4e-6]),
    st.integers(1, 40),
    st.sampled_from([-1.9e8, 0.0, 5e6]),
    st.integers(0, 99),
)
def test_sums_of_waves(count: int, spread_s: float, n_subcarriers: int, first_hz: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    tx, rx = (rng.standard_normal((count, n, 2)) @ [1, 1j] for n in (5, 3))
    delay_s = rng.uniform(0, spread_s, count) + rng.uniform(-1e-7, 1e-7)
    frequency_hz = first_hz + 240e3 * np.arange(n_subcarriers) * 40
    found = sum_over_paths(tx, rx, delay_s, frequency_hz)
    expected = direct(tx, rx, delay_s, frequency_hz)
    assert found.dtype == np.complex64 and found.flags.c_contiguous
    assert np.abs(found - expected).max() <= 2e-6 * np.abs(expected).max()


@pytest.mark.parametrize("n_subcarriers", [1, 2, 63, 64, 65, 792, 3168])
@pytest.mark.parametrize("kind", ["even", "falling", "with a gap"])
def test_waves_of_even_and_uneven_subcarriers(n_subcarriers: int, kind: str) -> None:
    frequency_hz = -1.9e8 + 120e3 * np.arange(n_subcarriers)
    if kind == "falling":
        frequency_hz = frequency_hz[::-1]
    elif kind == "with a gap":
        frequency_hz[n_subcarriers // 2 :] += 7e3
    delay_s = np.array([-3e-7, 0.0, 1e-9, 4e-6])
    expected = np.exp(-2j * np.pi * np.outer(delay_s, frequency_hz))
    np.testing.assert_allclose(path_waves(delay_s, frequency_hz), expected, atol=2e-12)
    assert path_waves(delay_s[:0], frequency_hz).shape == (0, n_subcarriers)


@pytest.mark.parametrize("count", [0, 3, 1500])
def test_blocks_of_beams_are_parts_of_the_whole(count: int) -> None:
    array = ArrayConfig(rows=2, columns=4, beams_per_panel=7)
    link = make_link(
        SimulationConfig(scene="-", waveform=WaveformConfig(n_rb=24, comb=12), tx_array=array, rx_array=array)
    )
    arguments = {
        "tx_codebook": link.tx_codebook,
        "rx_codebook": link.rx_codebook,
        "tx_pose": Pose(np.zeros(3), 0.3),
        "rx_pose": Pose(np.ones(3), -0.2),
        "frequency_offset_hz": link.frequency_offset_hz,
        "clock_bias_s": 2e-8,
    }
    paths = random_paths(np.random.default_rng(5), count)
    whole = beam_channel(paths, **arguments)
    blocks = list(beam_channel_blocks(paths, **arguments, tx_beams_per_block=3))
    assert [len(block) for block in blocks] == [3, 3, 1]
    np.testing.assert_array_equal(np.concatenate(blocks), whole)
    with pytest.raises(ValueError, match="tx_beams_per_block = 0"):
        next(beam_channel_blocks(paths, **arguments, tx_beams_per_block=0))


def test_few_beams_span_those_of_every_panel() -> None:
    array = ArrayConfig(rows=2, columns=4, panel_azimuth_deg=[-90.0, 0.0, 90.0], beams_per_panel=7)
    codebook = make_codebook(array, 60e9)
    basis, spanning = _spanning(codebook)
    assert basis.shape == (21, 12)  # horizontal beams of 4 columns span 4, whatever the rows, on each of 3 panels
    rng = np.random.default_rng(2)
    directions = rng.uniform(-np.pi, np.pi, 40), rng.uniform(-1, 1, 40)
    np.testing.assert_allclose(
        basis @ beam_response(spanning, *directions), beam_response(codebook, *directions), atol=1e-12
    )
