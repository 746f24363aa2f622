"""OFDM with a cyclic prefix, TS 38.211 clause 5.3.1: a resource grid to time-domain I/Q samples and back.

The grid starts at point A; subcarrier N/2 of its N lies at zero frequency. Baseband only: the phase term that
refers every symbol to the carrier frequency is part of up-conversion (clause 5.4).
"""

import numpy as np

from scenes.record import ComplexArray, IntArray
from sim.signal.waveform.prs import PREFIX_SHARE, SYMBOLS_PER_SLOT, CyclicPrefix, check_cyclic_prefix


def sample_rate_hz(numerology: int, n_fft: int = 4096) -> float:
    """Samples per second: the FFT size times the subcarrier spacing."""
    return n_fft * 15e3 * 2.0**numerology


def cp_lengths(numerology: int, slot: int, n_fft: int = 4096, cyclic_prefix: CyclicPrefix = "normal") -> IntArray:
    """Samples of the cyclic prefix (symbol,) of the 14 symbols of a slot, or the 12 with the extended one.

    Normal: 144/2048 of a symbol, and 2^mu 16/2048 of it more in the first symbol of every half subframe (0.5 ms).
    Extended: 512/2048 in every symbol.

    Raises `ValueError` if a prefix is not a whole number of samples with this FFT size, the numerology is
    outside 0 to 6, or the extended prefix is used with another numerology than 2.
    """
    if n_fft < 128 or n_fft % 128:
        raise ValueError(f"n_fft = {n_fft}: allowed are multiples of 128, whose prefixes are whole samples")
    if not 0 <= numerology <= 6:
        raise ValueError(f"numerology = {numerology}: allowed is 0 to 6")
    check_cyclic_prefix(cyclic_prefix, numerology)
    n_symbols = SYMBOLS_PER_SLOT[cyclic_prefix]
    usual = np.full(n_symbols, round(PREFIX_SHARE[cyclic_prefix] * n_fft))
    if cyclic_prefix == "extended":
        return usual
    is_longer = (slot * n_symbols + np.arange(n_symbols)) % (7 * 2**numerology) == 0
    return np.asarray(usual + is_longer * (n_fft // 128 * 2**numerology))


def modulate(grid: ComplexArray, cp_length: IntArray, n_fft: int = 4096) -> ComplexArray:
    """Samples (sample,) of consecutive OFDM symbols from a grid (symbol, subcarrier), each after its prefix.

    s(t) = sum_k a_k exp(j 2 pi (k - N/2) t / N_fft): a symbol's mean |s|^2 is the sum of |a_k|^2.

    Raises `ValueError` if the grid does not fit the FFT or the prefixes do not fit the symbols.
    """
    from scipy.fft import ifft  # noqa: PLC0415  (slow to import)

    _check(len(grid), grid.shape[1], cp_length, n_fft)
    spectrum = np.zeros((len(grid), n_fft), np.result_type(grid, np.complex64))
    spectrum[:, _bins(grid.shape[1], n_fft)] = grid
    bodies = ifft(spectrum, axis=1, norm="forward")
    pieces = [
        part for body, prefix in zip(bodies, cp_length, strict=True) for part in (body[n_fft - prefix :], body)
    ]
    return np.concatenate(pieces)


def demodulate(
    samples: ComplexArray, n_subcarriers: int, cp_length: IntArray, n_fft: int = 4096, early: int = 0
) -> ComplexArray:
    """Grid (symbol, subcarrier) of samples (sample,): the inverse of `modulate`.

    `early` moves the FFT window by this number of samples into the prefix and removes the resulting phase ramp, so
    that echoes before the nominal start cause no error.

    Raises `ValueError` if the number of samples does not fit the symbols.
    """
    from scipy.fft import fft  # noqa: PLC0415  (slow to import)

    _check(len(cp_length), n_subcarriers, cp_length, n_fft)
    total = int(np.sum(cp_length)) + n_fft * len(cp_length)
    if len(samples) != total:
        raise ValueError(f"samples: {len(samples)} given, {len(cp_length)} symbols with prefixes take {total}")
    if not 0 <= early <= np.min(cp_length, initial=n_fft):
        raise ValueError(f"early = {early}: allowed is 0 to the shortest prefix, {np.min(cp_length)}")
    start = np.cumsum(cp_length) + n_fft * np.arange(len(cp_length)) - early
    bodies = samples[start[:, None] + np.arange(n_fft)]
    grid = fft(bodies, axis=1, norm="forward")[:, _bins(n_subcarriers, n_fft)]
    if early:
        ramp = np.exp(2j * np.pi * early / n_fft * (np.arange(n_subcarriers) - n_subcarriers // 2))
        grid = grid * ramp.astype(grid.dtype)
    return np.asarray(grid)


def _bins(n_subcarriers: int, n_fft: int) -> IntArray:
    return np.asarray((np.arange(n_subcarriers) - n_subcarriers // 2) % n_fft)


def _check(n_symbols: int, n_subcarriers: int, cp_length: IntArray, n_fft: int) -> None:
    if n_subcarriers > n_fft:
        raise ValueError(f"n_fft = {n_fft}: the grid has {n_subcarriers} subcarriers, the FFT needs as many bins")
    if len(cp_length) != n_symbols:
        raise ValueError(f"cp_length: {len(cp_length)} prefixes for {n_symbols} symbols")
    if n_symbols and not 0 <= np.min(cp_length) <= np.max(cp_length) <= n_fft:
        raise ValueError(f"cp_length = {np.min(cp_length)} to {np.max(cp_length)}: allowed is 0 to n_fft")
