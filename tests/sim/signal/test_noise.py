"""Circular Gaussian numbers: against the method in double precision from the same bits, and in distribution."""

import numpy as np
import pytest
from scipy import stats

from sim.signal.noise import add_circular_gaussian


def slow_box_muller(shape: tuple[int, int], power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Box and Muller (1958) as printed, from the same random words."""
    words = rng.integers(0, 2**64 - 1, shape[0] * shape[1], dtype=np.uint64, endpoint=True).view(np.uint32)
    first, second = words.astype(np.int64).reshape(2, *shape)
    uniform = (first % 2**31 + 0.5) / 2**31
    # The low 30 bits are a signed share of a quarter turn, the high 2 bits count quarter turns.
    share = second % 2**30 / 2**30
    turns = second // 2**30 / 4 + (share - (share >= 0.5)) / 4
    return np.sqrt(-power[:, None] * np.log(uniform)) * np.exp(2j * np.pi * turns)


def test_same_numbers_as_in_double_precision() -> None:
    power = np.array([1.0, 4e-9, 0.0])
    found = np.zeros((3, 20_000), np.complex64)
    add_circular_gaussian(found, power, np.random.default_rng(4))
    expected = slow_box_muller(found.shape, power, np.random.default_rng(4))
    assert not found[2].any()
    # Close to u = 1 single precision keeps no more than the absolute place of u.
    error = np.abs(found - expected) / np.sqrt(power + 1e-30)[:, None]
    assert error.max() < 5e-4
    assert np.quantile(error, 0.99) < 2e-6


def test_powers_are_exponential_phases_uniform_and_all_independent() -> None:
    samples = np.zeros((2, 100_000), np.complex64)
    add_circular_gaussian(samples, np.array([2.0, 2.0]), np.random.default_rng(11))
    z = samples.ravel()
    assert stats.kstest(np.abs(z) ** 2 / 2, "expon").pvalue > 1e-3
    assert stats.kstest(np.angle(z) / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3
    for part in (z.real, z.imag):
        assert stats.kstest(part, "norm").pvalue > 1e-3
    limit = 5 / np.sqrt(len(z))
    assert abs(np.corrcoef(z.real**2, z.imag**2)[0, 1]) < limit
    assert abs(np.corrcoef(np.abs(z[:-1]), np.abs(z[1:]))[0, 1]) < limit


def test_tails_reach_as_far_as_a_gaussian() -> None:
    samples = np.zeros((20, 200_000), np.complex64)
    add_circular_gaussian(samples, np.ones(20), np.random.default_rng(6))
    beyond = int((np.abs(samples) ** 2 > 10).sum())
    assert beyond == pytest.approx(4e6 * np.exp(-10), abs=5 * np.sqrt(4e6 * np.exp(-10)))


def test_numbers_are_added_and_repeat() -> None:
    one, two = (np.full((3, 50), 7 + 1j, np.complex64) for _ in range(2))
    for samples in (one, two):
        add_circular_gaussian(samples, np.array([1e-12, 1.0, 1.0]), np.random.default_rng(1))
    np.testing.assert_array_equal(one, two)
    np.testing.assert_allclose(one[0], 7 + 1j, atol=1e-5)


def test_samples_of_another_type_are_refused() -> None:
    for samples in (np.zeros((2, 4), complex), np.zeros((4, 2), np.complex64).T):
        with pytest.raises(ValueError, match="must be complex64 without gaps"):
            add_circular_gaussian(samples, np.ones(2), np.random.default_rng(1))
