"""A beam pair of a sweep as time-domain I/Q samples."""

import numpy as np

from scenes.record import ComplexArray
from sim.observation import BeamSweep
from sim.signal.waveform.ofdm import cp_lengths, modulate
from sim.signal.waveform.prs import SUBCARRIERS_PER_RB, PrsConfig, prs_comb_pass, prs_subcarriers, prs_symbols


def received_grid(sweep: BeamSweep, prs: PrsConfig, slot: int, tx_beam: int, rx_beam: int) -> ComplexArray:
    """Received resource elements (symbol, subcarrier) of one beam pair over the carrier, zero outside the PRS.

    One symbol if beam pairs take one symbol. If they combine a resource, the first K_comb symbols, which contain
    every subcarrier once. The sum of |a|^2 over a symbol is its power in mW.

    Raises `ValueError` if the sweep has no such beams, or used another PRS.
    """
    _check_beam("tx_beam", tx_beam, sweep.samples.shape[0])
    _check_beam("rx_beam", rx_beam, sweep.samples.shape[1])
    samples = sweep.samples[tx_beam, rx_beam]
    n_occupied = prs.n_subcarriers // prs.comb
    if len(samples) not in (n_occupied, prs.n_subcarriers):
        raise ValueError(f"samples: {len(samples)} subcarriers, this PRS has {n_occupied} or {prs.n_subcarriers}")
    is_single = len(samples) == n_occupied
    expected = prs_symbols(prs, tx_beam % 4096, slot) if is_single else prs_comb_pass(prs, tx_beam % 4096, slot)
    if not np.allclose(expected, sweep.prs_symbol[tx_beam], atol=1e-6):
        raise ValueError(f"prs_symbol: beam {tx_beam} did not send this PRS in slot {slot}")
    start = prs.rb_offset * SUBCARRIERS_PER_RB
    symbols = prs.symbols[: 1 if is_single else prs.comb]
    grid = np.zeros((len(symbols), prs.n_carrier_subcarriers), np.complex64)
    for row, symbol in zip(grid, symbols, strict=True):
        occupied = prs_subcarriers(prs, symbol)
        row[occupied] = (samples if is_single else samples[occupied - start]) / np.sqrt(n_occupied)
    return grid


def received_samples(
    sweep: BeamSweep, prs: PrsConfig, slot: int, tx_beam: int, rx_beam: int, n_fft: int = 4096
) -> ComplexArray:
    """Samples (sample,) in sqrt(mW) of one beam pair: its symbols after their cyclic prefixes.

    Mean |s|^2 over a symbol is the received power. Only the occupied subcarriers contain noise; the other
    subcarriers are zero. Raises `ValueError` as `received_grid` does.
    """
    grid = received_grid(sweep, prs, slot, tx_beam, rx_beam)
    prefixes = cp_lengths(prs.numerology, slot, n_fft, prs.cyclic_prefix)
    prefixes = prefixes[prs.symbols[0] : prs.symbols[0] + len(grid)]
    return modulate(grid, prefixes, n_fft)


def _check_beam(name: str, beam: int, n_beams: int) -> None:
    if not 0 <= beam < n_beams:
        raise ValueError(f"{name} = {beam}: allowed is 0 to {n_beams - 1}")
