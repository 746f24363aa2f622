"""A recording from an independent transmitter, channel and receiver: nothing of `sim` or `estimation` is used.

Written from TS 38.211: clause 5.2.1 (Gold sequence), 7.4.1.7.2 and 7.4.1.7.3 (PRS sequence and mapping, comb 4),
4.3 (slots) and 5.3.1 (OFDM with prefixes), one resource per TX beam, a slot each; TS 38.214 clause 5.1.6.5
(periods of the resource set, an RX beam each). The channel is a sum of plane waves between two lines of isotropic
elements.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

MU, SPACING_HZ = 3, 120e3
N_RB, COMB = 24, 4
N_SUBCARRIERS = 12 * N_RB
SIZE = 512  # samples of the useful part of a symbol
RATE_HZ = SIZE * SPACING_HZ
PERIOD_SLOTS = 32
N_TX, N_RX = 12, 10  # beams, and elements of each end
CARRIER_HZ = 60e9
N_SYMBOLS = 4  # of the resource: one pass over the comb
OFFSETS = (0, 2, 1, 3)  # k' of comb 4, Table 7.4.1.7.3-1


@dataclass(frozen=True)
class PlaneWaves:
    """Plane waves: delays in s, sines of the azimuths of departure and arrival, complex amplitudes in sqrt(mW)."""

    delay_s: Array
    sin_aod: Array
    sin_aoa: Array
    amplitude: Array


@dataclass(frozen=True)
class ReceiverErrors:
    """Of the receiver: timing in s, frequency in Hz, recorded over true time minus 1, noise amplitude."""

    timing_s: float
    cfo_hz: float
    drift: float
    noise: float  # standard deviation of a complex sample, sqrt(mW)


def gold(c_init: int, length: int) -> Array:
    """c(n) of clause 5.2.1, bit by bit."""
    x1, x2 = [1] + 30 * [0], [(c_init >> k) & 1 for k in range(31)]
    for n in range(1600 + length):
        x1.append((x1[n + 3] + x1[n]) % 2)
        x2.append((x2[n + 3] + x2[n + 2] + x2[n + 1] + x2[n]) % 2)
    return np.array([(x1[n + 1600] + x2[n + 1600]) % 2 for n in range(length)])


def prs(sequence_id: int, slot: int, symbol: int) -> tuple[Array, Array]:
    """Subcarriers and symbols of one OFDM symbol of a resource from symbol 0, comb 4."""
    low = sequence_id % 1024
    c_init = (2**22 * (sequence_id // 1024) + 2**10 * (14 * slot + symbol + 1) * (2 * low + 1) + low) % 2**31
    bits = gold(c_init, 2 * N_SUBCARRIERS // COMB)
    k = np.arange(0, N_SUBCARRIERS, COMB) + OFFSETS[symbol % 4]
    return k, ((1 - 2 * bits[0::2]) + 1j * (1 - 2 * bits[1::2])) / np.sqrt(2)


def symbol_start_s(slot: int, symbol: int) -> float:
    """Start of the useful part of a symbol: clause 5.3.1 with kappa = 64, T_c = 1 / (480 kHz x 4096)."""
    t_c, kappa = 1 / (480e3 * 4096), 64
    useful = 2048 * kappa * 2.0**-MU * t_c
    start = 0.0
    in_subframe, subframe = slot % 2**MU, slot // 2**MU
    for number in range(14 * in_subframe + symbol + 1):
        prefix = 144 * kappa * 2.0**-MU + (16 * kappa if number % (7 * 2**MU) == 0 else 0)
        start += prefix * t_c + (useful if number < 14 * in_subframe + symbol else 0.0)
    return float(1e-3 * subframe + start)


def beams(n: int) -> tuple[Array, Array]:
    """Weights (beam, element) of a line of n elements half a wavelength apart, and sines of their directions."""
    sines = np.linspace(-0.8, 0.8, n)
    place = np.arange(n) - (n - 1) / 2
    return np.exp(-1j * np.pi * np.outer(sines, place)) / np.sqrt(n), sines


def responses(n: int, sines: Array) -> Array:
    """Responses (beam, path) of the beams of a line."""
    weights, _ = beams(n)
    return np.asarray(weights @ np.exp(1j * np.pi * np.outer(np.arange(n) - (n - 1) / 2, sines)))


def record(paths: PlaneWaves, errors: ReceiverErrors, rng: np.random.Generator) -> Array:
    """Samples of a sweep: TX beam m in slot m of a period, RX beam n in period n; silence elsewhere."""
    total = round(RATE_HZ * (1 + errors.drift) * (symbol_start_s(PERIOD_SLOTS * N_RX, 0) + errors.timing_s)) + SIZE
    samples = errors.noise / np.sqrt(2) * (rng.standard_normal(total) + 1j * rng.standard_normal(total))
    tx, rx = responses(N_TX, paths.sin_aod), responses(N_RX, paths.sin_aoa)
    prefix_s = 144 / 2048 / SPACING_HZ
    for beam in range(N_TX):
        sent: dict[int, list[tuple[Array, Array]]] = {}
        for period in range(N_RX):
            slot = PERIOD_SLOTS * period + beam
            in_frame = slot % 80
            if in_frame not in sent:
                sent[in_frame] = [prs(beam, in_frame, symbol) for symbol in range(N_SYMBOLS)]
            for symbol, (k, x) in enumerate(sent[in_frame]):
                start_s = symbol_start_s(slot, symbol)
                for one in range(len(paths.delay_s)):
                    gain = paths.amplitude[one] * tx[beam, one] * rx[period, one] / np.sqrt(len(k))
                    begin_s = start_s + paths.delay_s[one] - prefix_s
                    ends_s = np.array([begin_s, begin_s + prefix_s + 1 / SPACING_HZ])
                    ticks = (1 + errors.drift) * (ends_s + errors.timing_s) * RATE_HZ
                    n = np.arange(int(np.ceil(ticks[0])), int(np.ceil(ticks[1])))
                    t = n / RATE_HZ / (1 + errors.drift) - errors.timing_s
                    # sum over subcarriers of x exp(j 2 pi f_k (t - start - delay))
                    since = t - start_s - paths.delay_s[one]
                    wave = np.exp(2j * np.pi * SPACING_HZ * np.outer(since, k - N_SUBCARRIERS // 2)) @ x
                    samples[n] += gain * wave * np.exp(2j * np.pi * errors.cfo_hz * t)
    return np.asarray(samples)
