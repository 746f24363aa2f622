"""Thermal noise of the receiver: circular Gaussian numbers that are fast to draw.

The numbers follow the method of Box and Muller (1958) in single precision. A uniform number u gives the power
-ln u, which is exponentially distributed. A second uniform number gives the phase. Logarithm, sine and cosine are
truncated series with the accuracy of single precision: the compiler turns loops of them into vector instructions,
which it cannot do with calls of a mathematics library. Sums are not reassociated, so all machines give the same
bits.
"""

import numpy as np
from numba import njit

from scenes.record import ComplexArray, FloatArray

LN_2 = np.float32(np.log(2.0))
TURN_34 = np.float32(2 * np.pi / 2**34)  # 32 bits over a quarter turn
ROOT_HALF_BITS = np.int32(np.float32(np.sqrt(0.5)).view(np.int32))
LOG_SERIES = tuple(np.float32(2 / n) for n in (1, 3, 5, 7, 9))  # ln((1 + s) / (1 - s)), |s| < 0.172: 2e-9
SIN_SERIES = tuple(np.float32(1 / n) for n in (1, -6, 120, -5040, 362880))  # up to pi / 4: 2e-9
COS_SERIES = tuple(np.float32(1 / n) for n in (1, -2, 24, -720, 40320))  # up to pi / 4: 3e-8


def add_noise(samples: ComplexArray, power_mw: FloatArray, rng: np.random.Generator) -> ComplexArray:
    """Samples (tx_beam, rx_beam, subcarrier), in place, plus circular Gaussian noise of `power_mw` (rx_beam,).

    Every beam pair is measured in its own OFDM symbol, so the noise is independent between pairs.
    """
    for beam in samples:  # one beam's noise stays in the cache
        add_circular_gaussian(beam, power_mw, rng)
    return samples


def add_circular_gaussian(samples: ComplexArray, power: FloatArray, rng: np.random.Generator) -> None:
    """Add circular Gaussian numbers of mean `power` (row,) in place to complex64 samples (row, sample).

    Powers end at 22.2 times their mean, which one number in 2^32 would exceed.

    Raises `ValueError` for samples of another type, or with gaps in memory.
    """
    if samples.dtype != np.complex64 or not samples.flags.c_contiguous:
        raise ValueError(f"samples: {samples.dtype}, must be complex64 without gaps in memory")
    bits = rng.integers(0, 2**64 - 1, samples.size, dtype=np.uint64, endpoint=True)
    halves = bits.view(np.int32).reshape(2, *samples.shape)
    parts = samples.view(np.float32)
    for row, scale in enumerate(power.astype(np.float32)):
        _add_row(parts[row], halves[0, row], halves[1, row], scale)


@njit(cache=True, error_model="numpy")
def _add_row(parts, power_bits, phase_bits, scale):  # type: ignore[no-untyped-def]
    """Add sqrt(scale) times circular Gaussian numbers to samples (real and imaginary part by turns,)."""
    for i in range(len(power_bits)):
        # u = (31 bits + 1/2) / 2^31 = 2^(exponent - 31) mantissa, the mantissa from sqrt(1/2) to sqrt(2)
        word = np.float32(np.float32(power_bits[i] & 0x7FFFFFFF) + np.float32(0.5)).view(np.int32)
        exponent = np.int32(word - ROOT_HALF_BITS) >> 23
        mantissa = np.int32(word - (exponent << 23)).view(np.float32)
        s = (mantissa - np.float32(1)) / (mantissa + np.float32(1))
        logarithm = s * _even(LOG_SERIES, s * s) + np.float32(exponent - 31) * LN_2
        amplitude = np.sqrt(-scale * logarithm)
        # two bits choose the quarter turn, the others the angle within +-pi / 4 of it
        quarter = phase_bits[i] >> 30
        angle = np.float32(np.int32(phase_bits[i] << 2)) * TURN_34
        sine = amplitude * angle * _even(SIN_SERIES, angle * angle)
        cosine = amplitude * _even(COS_SERIES, angle * angle)
        is_odd, is_low = (quarter & 1) != 0, (quarter & 2) != 0
        real, imaginary = (-sine, cosine) if is_odd else (cosine, sine)
        parts[2 * i] += -real if is_low else real
        parts[2 * i + 1] += -imaginary if is_low else imaginary


@njit(cache=True, inline="always")
def _even(c, x):  # type: ignore[no-untyped-def]
    """Polynomial of five coefficients in x."""
    return c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4])))
