"""NR downlink positioning reference signal (DL PRS), TS 38.211 clause 7.4.1.7: sequence and resource elements.

This module describes one resource in one slot. `sim.signal.waveform.schedule` describes its slots.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from scenes.record import ComplexArray, FloatArray, IntArray

SUBCARRIERS_PER_RB = 12

CyclicPrefix = Literal["normal", "extended"]

# Symbols per slot, TS 38.211 Tables 4.3.2-1 and 4.3.2-2, and the usual length of a prefix over that of the useful
# symbol, clause 5.3.1.
SYMBOLS_PER_SLOT: dict[str, int] = {"normal": 14, "extended": 12}
PREFIX_SHARE: dict[str, float] = {"normal": 144 / 2048, "extended": 512 / 2048}

# Frequency offset k' by comb size and symbol within the resource, TS 38.211 Table 7.4.1.7.3-1.
COMB_OFFSETS: dict[int, tuple[int, ...]] = {
    2: (0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1),
    4: (0, 2, 1, 3, 0, 2, 1, 3, 0, 2, 1, 3),
    6: (0, 3, 1, 4, 2, 5, 0, 3, 1, 4, 2, 5),
    12: (0, 6, 3, 9, 1, 7, 4, 10, 2, 8, 5, 11),
}

# Lengths L_PRS in symbols that each comb size may have, TS 38.211 clause 7.4.1.7.3: every subcarrier is sounded.
COMB_LENGTHS: dict[int, tuple[int, ...]] = {2: (2, 4, 6, 12), 4: (4, 12), 6: (6, 12), 12: (12,)}


@dataclass(frozen=True)
class PrsConfig:
    """One PRS resource: its position in the grid, counted from point A, where the carrier starts.

    The default `n_symbols` is the smallest allowed for the comb size: one pass over all subcarriers. By default
    (`carrier_rb`) the carrier ends with the PRS.

    Raises `ValueError` For a comb size, pair of comb size and length, offset, band, symbol or sequence ID
    outside of TS 38.211 clause 7.4.1.7 and TS 38.214 clause 5.1.6.5, and for a PRS outside the carrier.
    """

    n_rb: int = 264
    comb: int = 2
    numerology: int = 3
    rb_offset: int = 0
    re_offset: int = 0
    first_symbol: int = 0
    n_symbols: int | None = None
    carrier_rb: int | None = None
    cyclic_prefix: CyclicPrefix = "normal"

    def __post_init__(self) -> None:
        checks = {
            "comb": (self.comb in COMB_OFFSETS, "2, 4, 6 or 12 (TS 38.211 7.4.1.7.3)"),
            "numerology": (0 <= self.numerology <= 6, "0 to 6 (TS 38.211 4.2)"),
            "n_rb": (24 <= self.n_rb <= 272 and self.n_rb % 4 == 0, "24 to 272 in fours (TS 38.214 5.1.6.5)"),
            "rb_offset": (self.rb_offset >= 0, "0 or more"),
            "re_offset": (0 <= self.re_offset < self.comb, "0 to comb - 1 (TS 38.211 7.4.1.7.3)"),
        }
        for name, (valid, allowed) in checks.items():
            _require(valid, name, getattr(self, name), allowed)
        check_cyclic_prefix(self.cyclic_prefix, self.numerology)
        self._check_symbols()
        self._check_carrier()

    def _check_symbols(self) -> None:
        allowed = ", ".join(map(str, COMB_LENGTHS[self.comb]))
        _require(
            self.length in COMB_LENGTHS[self.comb], "n_symbols", self.length,
            f"{allowed} with comb {self.comb} (pairs of TS 38.211 7.4.1.7.3)",
        )  # fmt: skip
        last = self.symbols_per_slot - self.length
        _require(
            0 <= self.first_symbol <= last, "first_symbol", self.first_symbol,
            f"0 to {last}, so that {self.length} symbols stay within the slot",
        )  # fmt: skip

    def _check_carrier(self) -> None:
        end = self.rb_offset + self.n_rb
        _require(
            end <= self.n_carrier_rb <= 275, "rb_offset + n_rb", end,
            f"up to carrier_rb = {self.n_carrier_rb}, the PRS lies within the carrier of at most 275 RB"
            " (TS 38.211 4.4.2)",
        )  # fmt: skip

    @property
    def length(self) -> int:
        """Symbols of the resource, L_PRS."""
        return COMB_LENGTHS[self.comb][0] if self.n_symbols is None else self.n_symbols

    @property
    def n_carrier_rb(self) -> int:
        """Resource blocks of the carrier."""
        return self.rb_offset + self.n_rb if self.carrier_rb is None else self.carrier_rb

    @property
    def symbols(self) -> range:
        """OFDM symbols of the slot that carry the resource."""
        return range(self.first_symbol, self.first_symbol + self.length)

    @property
    def subcarrier_spacing_hz(self) -> float:
        """Subcarrier spacing 15 kHz * 2^mu."""
        return 15e3 * 2.0**self.numerology

    @property
    def symbols_per_slot(self) -> int:
        """OFDM symbols of a slot."""
        return SYMBOLS_PER_SLOT[self.cyclic_prefix]

    @property
    def symbol_s(self) -> float:
        """Duration of an OFDM symbol with a prefix of the usual length."""
        return (1 + PREFIX_SHARE[self.cyclic_prefix]) / self.subcarrier_spacing_hz

    @property
    def slots_per_frame(self) -> int:
        """Slots in a radio frame of 10 ms."""
        return int(10 * 2**self.numerology)

    @property
    def n_subcarriers(self) -> int:
        """Subcarriers in the band of the PRS, occupied by it or not."""
        return SUBCARRIERS_PER_RB * self.n_rb

    @property
    def n_carrier_subcarriers(self) -> int:
        """Subcarriers of the carrier."""
        return SUBCARRIERS_PER_RB * self.n_carrier_rb


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


def check_cyclic_prefix(cyclic_prefix: str, numerology: int) -> None:
    """Raise `ValueError` for an unknown prefix, or the extended one with another numerology than 2."""
    if cyclic_prefix not in SYMBOLS_PER_SLOT:
        raise ValueError(f"cyclic_prefix = '{cyclic_prefix}': allowed are 'normal' and 'extended'")
    if cyclic_prefix == "extended" and numerology != 2:
        raise ValueError(
            f"cyclic_prefix = 'extended' with numerology = {numerology}: allowed is numerology 2 alone"
            " (TS 38.211 Table 4.2-1)"
        )


def prs_c_init(sequence_id: int, slot: int, symbol: int, symbols_per_slot: int = 14) -> int:
    """Initialisation of the pseudo-random sequence of one OFDM symbol, TS 38.211 clause 7.4.1.7.2."""
    if not 0 <= sequence_id < 4096:
        raise ValueError(f"sequence_id = {sequence_id}: allowed is 0 to 4095 (TS 38.211 7.4.1.7.2)")
    low = sequence_id % 1024
    mixed = 2**10 * (symbols_per_slot * slot + symbol + 1) * (2 * low + 1)
    return (2**22 * (sequence_id // 1024) + mixed + low) % 2**31


def prs_symbols(config: PrsConfig, sequence_id: int, slot: int, symbol: int | None = None) -> ComplexArray:
    """QPSK symbols (subcarrier,) of one OFDM symbol of the PRS, |x| = 1, in ascending subcarrier order.

    `symbol` is the OFDM symbol in the slot, the resource's first by default. The sequence counts from point A,
    so a resource with an RB offset does not start at its first element.
    """
    symbol = config.first_symbol if symbol is None else symbol
    n_occupied = config.n_subcarriers // config.comb
    first = config.rb_offset * SUBCARRIERS_PER_RB // config.comb
    c_init = prs_c_init(sequence_id, slot, symbol, config.symbols_per_slot)
    bits = gold_sequence(c_init, 2 * (first + n_occupied))[2 * first :]
    signs = (1 - 2 * bits.astype(float)) / np.sqrt(2)
    return np.asarray(signs[0::2] + 1j * signs[1::2])


def prs_subcarriers(config: PrsConfig, symbol: int | None = None) -> IntArray:
    """Occupied subcarriers (subcarrier,) of one OFDM symbol, counted from point A, TS 38.211 clause 7.4.1.7.3.

    k = m K_comb + ((k_offset + k') mod K_comb).

    Raises `ValueError` if the symbol is not one of the resource.
    """
    symbol = config.first_symbol if symbol is None else symbol
    if symbol not in config.symbols:
        raise ValueError(f"symbol = {symbol}: the resource has {config.length} from {config.first_symbol}")
    k_prime = COMB_OFFSETS[config.comb][symbol - config.first_symbol]
    start = config.rb_offset * SUBCARRIERS_PER_RB
    return start + np.arange(0, config.n_subcarriers, config.comb) + (config.re_offset + k_prime) % config.comb


def prs_slot(config: PrsConfig, sequence_id: int, slot: int) -> ComplexArray:
    """Grid (symbol, subcarrier) of the whole carrier in one slot: the PRS, and zero elsewhere."""
    grid = np.zeros((config.symbols_per_slot, config.n_carrier_subcarriers), complex)
    for symbol in config.symbols:
        grid[symbol, prs_subcarriers(config, symbol)] = prs_symbols(config, sequence_id, slot, symbol)
    return grid


def prs_comb_pass(config: PrsConfig, sequence_id: int, slot: int) -> ComplexArray:
    """QPSK symbols (subcarrier,) over the whole band of the PRS, each from the first symbol that contains it.

    The first K_comb symbols of a resource contain every subcarrier once. This is the de-staggered pilot of a
    receiver that combines the symbols of a resource.
    """
    pilot = np.empty(config.n_subcarriers, complex)
    start = config.rb_offset * SUBCARRIERS_PER_RB
    for symbol in config.symbols[: config.comb]:
        pilot[prs_subcarriers(config, symbol) - start] = prs_symbols(config, sequence_id, slot, symbol)
    return pilot


def subcarrier_frequency_hz(config: PrsConfig, subcarrier: IntArray) -> FloatArray:
    """Frequency offset in Hz of subcarriers (counted from point A) from the centre of the carrier.

    TS 38.211 clause 5.3.1: subcarrier N/2 of the N of the carrier lies at the carrier frequency.
    """
    return np.asarray((subcarrier - config.n_carrier_subcarriers / 2) * config.subcarrier_spacing_hz)


def _require(valid: bool, name: str, value: object, allowed: str) -> None:
    if not valid:
        raise ValueError(f"PrsConfig.{name} = {value}: allowed is {allowed}")
