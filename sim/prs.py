"""NR downlink positioning reference signal (DL PRS), TS 38.211 clause 7.4.1.7."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.record import ComplexArray, FloatArray, IntArray

SYMBOLS_PER_SLOT = 14
SUBCARRIERS_PER_RB = 12

# Frequency offset k' by comb size and symbol within the resource, TS 38.211 Table 7.4.1.7.3-1.
COMB_OFFSETS: dict[int, tuple[int, ...]] = {
    2: (0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1),
    4: (0, 2, 1, 3, 0, 2, 1, 3, 0, 2, 1, 3),
    6: (0, 3, 1, 4, 2, 5, 0, 3, 1, 4, 2, 5),
    12: (0, 6, 3, 9, 1, 7, 4, 10, 2, 8, 5, 11),
}


@dataclass(frozen=True)
class PrsConfig:
    """One PRS resource: its place in the grid, counted from point A of the positioning frequency layer.

    Raises
    ------
    ValueError
        For a comb size, offset, band, symbol or sequence ID outside of the standard.
    """

    n_rb: int = 264
    comb: int = 2
    numerology: int = 3
    rb_offset: int = 0
    re_offset: int = 0
    first_symbol: int = 0
    n_symbols: int = 1

    def __post_init__(self) -> None:
        checks = {
            "comb": (self.comb in COMB_OFFSETS, "2, 4, 6 or 12"),
            "numerology": (0 <= self.numerology <= 6, "0 to 6"),
            "n_rb": (1 <= self.n_rb <= 275, "1 to 275 resource blocks"),
            "rb_offset": (self.rb_offset >= 0, "0 or more"),
            "re_offset": (0 <= self.re_offset < self.comb, "0 to comb - 1"),
            "first_symbol": (0 <= self.first_symbol < SYMBOLS_PER_SLOT, "0 to 13"),
            "n_symbols": (1 <= self.n_symbols <= SYMBOLS_PER_SLOT - self.first_symbol, "within the slot"),
        }
        for name, (valid, allowed) in checks.items():
            if not valid:
                raise ValueError(f"PrsConfig.{name} = {getattr(self, name)}: allowed is {allowed}")

    @property
    def subcarrier_spacing_hz(self) -> float:
        """Subcarrier spacing 15 kHz * 2^mu."""
        return 15e3 * 2.0**self.numerology

    @property
    def n_subcarriers(self) -> int:
        """Subcarriers in the band, occupied by the PRS or not."""
        return SUBCARRIERS_PER_RB * self.n_rb


def gold_sequence(c_init: int, length: int) -> IntArray:
    """Bits c(0) ... c(length - 1) of the length-31 Gold sequence, TS 38.211 clause 5.2.1.

    c(n) = x1(n + Nc) + x2(n + Nc) mod 2 with Nc = 1600, x1 started with a single one and x2 with `c_init`.
    """
    total = 1600 + length
    x1, x2 = np.zeros(total + 31, np.uint8), np.zeros(total + 31, np.uint8)
    x1[0] = 1
    x2[:31] = (c_init >> np.arange(31)) & 1
    # Bits n + 28 and earlier are known when bit n + 31 is due, so 28 bits are made at a time.
    for n in range(0, total, 28):
        end = min(n + 28, total)
        x1[n + 31 : end + 31] = x1[n + 3 : end + 3] ^ x1[n:end]
        x2[n + 31 : end + 31] = x2[n + 3 : end + 3] ^ x2[n + 2 : end + 2] ^ x2[n + 1 : end + 1] ^ x2[n:end]
    return np.asarray(x1[1600:total] ^ x2[1600:total], dtype=int)


def prs_c_init(sequence_id: int, slot: int, symbol: int) -> int:
    """Initialisation of the pseudo-random sequence of one OFDM symbol, TS 38.211 clause 7.4.1.7.2."""
    if not 0 <= sequence_id < 4096:
        raise ValueError(f"sequence_id = {sequence_id}: allowed is 0 to 4095")
    low = sequence_id % 1024
    mixed = 2**10 * (SYMBOLS_PER_SLOT * slot + symbol + 1) * (2 * low + 1)
    return (2**22 * (sequence_id // 1024) + mixed + low) % 2**31


def prs_symbols(config: PrsConfig, sequence_id: int, slot: int, symbol: int | None = None) -> ComplexArray:
    """QPSK symbols (subcarrier,) of one OFDM symbol of the PRS, |x| = 1, in ascending subcarrier order.

    `symbol` is the OFDM symbol in the slot, the resource's first by default. The sequence counts from point A,
    so a resource with an RB offset starts inside it.
    """
    symbol = config.first_symbol if symbol is None else symbol
    n_occupied = config.n_subcarriers // config.comb
    first = config.rb_offset * SUBCARRIERS_PER_RB // config.comb
    bits = gold_sequence(prs_c_init(sequence_id, slot, symbol), 2 * (first + n_occupied))[2 * first :]
    signs = (1 - 2 * bits.astype(float)) / np.sqrt(2)
    return np.asarray(signs[0::2] + 1j * signs[1::2])


def prs_subcarriers(config: PrsConfig, symbol: int | None = None) -> IntArray:
    """Occupied subcarriers (subcarrier,) of one OFDM symbol, counted from point A, TS 38.211 clause 7.4.1.7.3.

    k = m K_comb + ((k_offset + k') mod K_comb).

    Raises `ValueError` where the symbol is not one of the resource.
    """
    symbol = config.first_symbol if symbol is None else symbol
    if not 0 <= symbol - config.first_symbol < config.n_symbols:
        raise ValueError(f"symbol = {symbol}: the resource has {config.n_symbols} from {config.first_symbol}")
    k_prime = COMB_OFFSETS[config.comb][(symbol - config.first_symbol) % 12]
    start = config.rb_offset * SUBCARRIERS_PER_RB
    return (
        start + np.arange(0, config.n_subcarriers, config.comb) + (config.re_offset + k_prime) % config.comb
    )


def subcarrier_frequency_hz(config: PrsConfig, subcarrier: IntArray) -> FloatArray:
    """Frequency offset in Hz of subcarriers (counted from point A) from the centre of the PRS band."""
    centre = config.rb_offset * SUBCARRIERS_PER_RB + config.n_subcarriers / 2
    return np.asarray((subcarrier - centre) * config.subcarrier_spacing_hz)
