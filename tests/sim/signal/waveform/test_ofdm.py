"""OFDM modulation against the sum of clause 5.3.1, and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes.record import ComplexArray
from sim.signal.waveform.ofdm import cp_lengths, demodulate, modulate, sample_rate_hz


def random_grid(seed: int, n_symbols: int, n_subcarriers: int) -> ComplexArray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n_symbols, n_subcarriers)) + 1j * rng.standard_normal((n_symbols, n_subcarriers))


def test_prefixes_of_the_real_campaign() -> None:
    assert sample_rate_hz(3) == 491.52e6
    assert cp_lengths(3, 0).tolist() == [544] + [288] * 13
    assert cp_lengths(3, 1).tolist() == [288] * 14
    assert cp_lengths(3, 4).tolist() == [544] + [288] * 13
    assert cp_lengths(2, 0)[0] == 416 and cp_lengths(2, 2)[0] == 416 and cp_lengths(2, 1)[0] == 288
    assert cp_lengths(0, 0).tolist() == ([320] + [288] * 6) * 2


def test_extended_prefixes_fill_twelve_symbols_of_numerology_2() -> None:
    prefixes = cp_lengths(2, 3, 4096, "extended")
    assert prefixes.tolist() == [1024] * 12
    assert (prefixes + 4096).sum() == 0.25e-3 * sample_rate_hz(2)
    grid = random_grid(5, 12, 240)
    samples = modulate(grid, prefixes)
    echo = np.concatenate([np.zeros(1000), samples[:-1000]])  # beyond a normal prefix, within this one
    ramp = np.exp(-2j * np.pi * 1000 / 4096 * (np.arange(240) - 120))
    np.testing.assert_allclose(demodulate(echo, 240, prefixes), grid * ramp, atol=1e-11)
    with pytest.raises(ValueError, match=r"'extended' with numerology = 3: .*TS 38.211 Table 4.2-1"):
        cp_lengths(3, 0, 4096, "extended")
    with pytest.raises(ValueError, match="cyclic_prefix = 'long': allowed are"):
        cp_lengths(2, 0, 4096, "long")  # type: ignore[arg-type]


@pytest.mark.parametrize("numerology", range(7))
def test_half_subframes_last_half_a_millisecond(numerology: int) -> None:
    slots = [cp_lengths(numerology, slot, 1024) + 1024 for slot in range(2**numerology)]
    halves = np.concatenate(slots).reshape(2, -1).sum(axis=1)
    np.testing.assert_array_equal(halves, 0.5e-3 * sample_rate_hz(numerology, 1024))


def test_samples_are_the_sum_over_subcarriers() -> None:
    grid = random_grid(1, 2, 24)
    samples = modulate(grid, np.array([18, 9]), 128)
    t = np.concatenate([np.arange(-18, 128), np.arange(-9, 128)])
    symbol = np.repeat([0, 1], [146, 137])
    waves = np.exp(2j * np.pi * np.outer(t, np.arange(24) - 12) / 128)
    np.testing.assert_allclose(samples, (grid[symbol] * waves).sum(axis=1), atol=1e-12)
    assert np.mean(np.abs(samples[18:146]) ** 2) == pytest.approx((np.abs(grid[0]) ** 2).sum())


@given(st.integers(0, 100), st.integers(1, 4), st.integers(1, 128), st.integers(0, 9))
def test_demodulation_is_the_inverse(seed: int, n_symbols: int, n_subcarriers: int, early: int) -> None:
    grid = random_grid(seed, n_symbols, n_subcarriers)
    prefixes = np.full(n_symbols, 9)
    back = demodulate(modulate(grid, prefixes, 128), n_subcarriers, prefixes, 128, early)
    np.testing.assert_allclose(back, grid, atol=1e-12)


def test_an_echo_within_the_prefix_is_a_phase_ramp() -> None:
    grid, prefixes, delay = random_grid(2, 3, 100), np.full(3, 9), 6
    samples = modulate(grid, prefixes, 128)
    received = np.concatenate([np.zeros(delay), samples[:-delay]])
    ramp = np.exp(-2j * np.pi * delay / 128 * (np.arange(100) - 50))
    np.testing.assert_allclose(demodulate(received, 100, prefixes, 128), grid * ramp, atol=1e-11)


def test_single_precision_stays_single() -> None:
    samples = modulate(random_grid(3, 1, 12).astype(np.complex64), np.array([9]), 128)
    assert samples.dtype == np.complex64
    assert demodulate(samples, 12, np.array([9]), 128, early=3).dtype == np.complex64


def test_bad_input_is_named() -> None:
    with pytest.raises(ValueError, match="n_fft = 100"):
        cp_lengths(3, 0, 100)
    with pytest.raises(ValueError, match="numerology = 7"):
        cp_lengths(7, 0)
    with pytest.raises(ValueError, match=r"n_fft = 128: the grid has 132 subcarriers"):
        modulate(random_grid(0, 1, 132), np.array([9]), 128)
    with pytest.raises(ValueError, match="2 prefixes for 1 symbols"):
        modulate(random_grid(0, 1, 12), np.array([9, 9]), 128)
    with pytest.raises(ValueError, match="136 given, 1 symbols with prefixes take 137"):
        demodulate(np.zeros(136, complex), 12, np.array([9]), 128)
    with pytest.raises(ValueError, match="early = 10"):
        demodulate(np.zeros(137, complex), 12, np.array([9]), 128, early=10)
