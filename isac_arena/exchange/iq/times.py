"""When every symbol of a sweep is sent, and which pilots it carries: TS 38.211 clauses 5.3.1 and 7.4.1.7."""

from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from isac_arena.exchange.iq.config import RecordingConfig
from isac_arena.exchange.path_columns import read_columns
from isac_arena.exchange.table import MeasuredTable, table_of
from scenes.inputs import check_input
from scenes.record import ComplexArray, FloatArray, IntArray
from sim.config import WaveformConfig
from sim.signal.waveform.occasions import sweep_occasions
from sim.signal.waveform.ofdm import cp_lengths
from sim.signal.waveform.prs import PREFIX_SHARE, SUBCARRIERS_PER_RB, PrsConfig, prs_subcarriers, prs_symbols
from sim.signal.waveform.schedule import sent_slots

PAIRS = ("tx_beam", "rx_beam", "start_s", "slot")  # columns of a table of beam pairs
LATEST_S, LATEST_SLOT = 1e4, 10**8
N_FFT = 4096  # prefixes are whole samples with it


@dataclass(frozen=True)
class SweepTimes:
    """Start of the useful part of every symbol, in s of the schedule, and the slot (in the frame) that sends it.

    `start_s` is (repetition, tx_beam, rx_beam, symbol), `slot` (repetition, tx_beam, rx_beam).
    """

    start_s: FloatArray
    slot: IntArray


@dataclass(frozen=True)
class Pilots:
    """The pilots of a recording: a reference grid, or the PRS of a waveform.

    `tones` (tone,) are the subcarriers of the samples of a sweep, from the centre of the carrier.
    """

    prs: PrsConfig
    is_combined: bool
    sequence_ids: list[int]
    grid: ComplexArray | None = None  # (tx_beam, subcarrier)

    @property
    def symbols(self) -> list[int]:
        """Symbols of the slot that are used."""
        used = self.prs.length if self.is_combined and self.grid is None else 1
        return list(self.prs.symbols[:used])

    def tones(self, symbol: int) -> IntArray:
        """Subcarriers (tone,) of a symbol that carry pilots, from the centre of the carrier."""
        found = prs_subcarriers(self.prs, symbol) if self.grid is None else np.flatnonzero(self.grid[0])
        return np.asarray(found - self.prs.n_carrier_subcarriers // 2)

    def of(self, tx_beam: int, slot: int, symbol: int) -> ComplexArray:
        """Pilots (tone,), |x| = 1."""
        if self.grid is None:
            return prs_symbols(self.prs, self.sequence_ids[tx_beam], slot % self.prs.slots_per_frame, symbol)
        sent = self.grid[tx_beam, np.flatnonzero(self.grid[0])]
        return np.asarray(sent / np.abs(sent))

    @property
    def all_tones(self) -> IntArray:
        """Subcarriers of a sweep: of the first symbol, or the whole band where combs are combined."""
        first = self.tones(self.symbols[0])
        if len(self.symbols) == 1:
            return first
        start = self.prs.rb_offset * SUBCARRIERS_PER_RB - self.prs.n_carrier_subcarriers // 2
        return start + np.arange(self.prs.n_subcarriers)

    @property
    def unused_tones(self) -> IntArray:
        """Subcarriers of the first symbol between those with pilots; none where all have them."""
        used = self.tones(self.symbols[0])
        return used[:-1] + 1 if used[1] - used[0] > 1 else used[:0]

    def sent(self, slot: IntArray) -> ComplexArray:
        """Pilots (tx_beam, tone) of all tones for TX beams that are sent in slots (tx_beam,)."""
        found = np.zeros((len(slot), len(self.all_tones)), complex)
        for symbol in reversed(self.symbols):
            seen = np.searchsorted(self.all_tones, self.tones(symbol))
            for beam, one in enumerate(slot):
                found[beam, seen] = self.of(beam, int(one), symbol)
        return found


def pilots(waveform: WaveformConfig, config: RecordingConfig, folder: Path, n_tx: int) -> Pilots:
    """The pilots of a recording; `ValueError` where the reference or the sequences do not fit the waveform."""
    ids = config.sequence_ids or [beam % 4096 for beam in range(n_tx)]
    if len(ids) != n_tx:
        raise ValueError(f"recording.sequence_ids: has {len(ids)} values, the TX has {n_tx} beams")
    if config.reference is None:
        return Pilots(waveform.prs, waveform.combine_symbols, ids)
    file = folder / config.reference
    grid = _grid(file)
    shape = (n_tx, waveform.prs.n_carrier_subcarriers)
    used = grid != 0 if grid.ndim == 2 else np.zeros((1, 1), bool)
    if grid.shape != shape or used[0].sum() < 2 or np.any(used != used[0]) or not np.isfinite(grid).all():
        raise ValueError(
            f"{file}: grid: must be {shape} and finite, with pilots on the same subcarriers of all beams"
        )
    if len(set(np.diff(np.flatnonzero(used[0])))) > 1:
        raise ValueError(f"{file}: grid: pilots must be evenly spaced")
    return Pilots(waveform.prs, False, ids, grid)


def _grid(file: Path) -> ComplexArray:
    """The array `grid` of a .npz file; `ValueError`, one line, where it holds none."""
    check_input(file)
    try:
        with np.load(file, allow_pickle=False) as stored:
            return np.asarray(stored["grid"], complex)
    except (KeyError, TypeError, ValueError, BadZipFile) as error:
        raise ValueError(f"{file}: holds no grid (tx_beam, subcarrier) of numbers") from error


def sweep_times(
    waveform: WaveformConfig, config: RecordingConfig, folder: Path, n_tx: int, n_rx: int
) -> SweepTimes:
    """The times of a sweep: of a table of beam pairs, of the PRS schedule, or one pair right after the other.

    Raises `ValueError` where the table misses a beam pair.
    """
    prs = waveform.prs
    used = prs.length if waveform.combine_symbols else 1
    if config.pairs is not None:
        start, slot = _table(folder / config.pairs, n_tx, n_rx, prs.slots_per_frame)
        return SweepTimes(start[..., None] + _in_burst(prs, slot, used), slot)
    occasions = sweep_occasions(waveform, n_tx, n_rx)
    if waveform.schedule is not None:
        slot_s = 1e-3 / 2**prs.numerology
        first = int(sent_slots(waveform.schedule.of_resource(prs.numerology), 1).min())
        slot = first + np.rint(occasions.time_s / slot_s).astype(int)
        start = _slot_start_s(prs, slot)[..., None] + _in_slot(prs, slot)[..., prs.first_symbol :][..., :used]
        return SweepTimes(start, slot)
    slot = np.repeat(occasions.slot[:, :, None], n_rx, axis=2)
    in_burst = _in_burst(prs, slot, used)
    length = (in_burst[..., -1] + 1 / prs.subcarrier_spacing_hz).ravel()
    order = np.argsort(occasions.time_s.ravel())
    begin = np.empty(len(order))
    begin[order] = np.concatenate([[0.0], np.cumsum(length[order])[:-1]])
    return SweepTimes(begin.reshape(slot.shape)[..., None] + in_burst, slot)


def _prefix_s(prs: PrsConfig, slot: IntArray) -> FloatArray:
    """Prefixes (..., symbol) of slots."""
    per_frame = [cp_lengths(prs.numerology, one, N_FFT, prs.cyclic_prefix) for one in range(prs.slots_per_frame)]
    return np.asarray(np.stack(per_frame)[slot % prs.slots_per_frame] / (N_FFT * prs.subcarrier_spacing_hz))


def _in_slot(prs: PrsConfig, slot: IntArray) -> FloatArray:
    """Start of the useful part of every symbol (..., symbol) after the start of its slot."""
    prefix = _prefix_s(prs, slot)
    return np.asarray(np.cumsum(prefix, axis=-1) + np.arange(prefix.shape[-1]) / prs.subcarrier_spacing_hz)


def _in_burst(prs: PrsConfig, slot: IntArray, used: int) -> FloatArray:
    """Start of the useful part of the first symbols of a resource after the start of its first prefix."""
    prefix = _prefix_s(prs, slot)[..., prs.first_symbol :][..., :used]
    return np.asarray(np.cumsum(prefix, axis=-1) + np.arange(used) / prs.subcarrier_spacing_hz)


def _slot_start_s(prs: PrsConfig, slot: IntArray) -> FloatArray:
    """Start of slots: subframes take 1 ms, the slots in them are not equally long."""
    per_subframe = 2**prs.numerology
    lengths = _in_slot(prs, np.arange(per_subframe))[:, -1] + 1 / prs.subcarrier_spacing_hz
    begin = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    return np.asarray(1e-3 * (slot // per_subframe) + begin[slot % per_subframe])


def _table(file: Path, n_tx: int, n_rx: int, slots_per_frame: int) -> tuple[FloatArray, IntArray]:
    """Start (1, tx_beam, rx_beam) in s and slot of every pair in a table; `ValueError` as of `MeasuredTable`."""
    table = table_of(file, read_columns(file), PAIRS)
    tx, rx = (_whole(table, name, n - 1) for name, n in (("tx_beam", n_tx), ("rx_beam", n_rx)))
    start_s = table.needed({"start_s": 1.0})
    bad = np.flatnonzero((start_s < 0) | (start_s > LATEST_S))
    if len(bad):
        raise table.wrong(int(bad[0]), "start_s", start_s[bad[0]], f"must be within 0 and {LATEST_S:g} s")
    start, slot = np.full((1, n_tx, n_rx), np.nan), np.zeros((1, n_tx, n_rx), int)
    for row, pair in enumerate(zip(tx, rx, strict=True)):
        if np.isfinite(start[0][pair]):
            raise table.wrong(row, "tx_beam, rx_beam", f"{pair[0]}, {pair[1]}", "is in another row already")
        start[0][pair] = start_s[row]
    slot[0, tx, rx] = _whole(table, "slot", LATEST_SLOT) if table.has("slot") else tx % slots_per_frame
    if np.isnan(start).any():
        one = np.argwhere(np.isnan(start[0]))[0]
        raise ValueError(
            f"{file}: the pair of TX beam {one[0]} and RX beam {one[1]} is missing: all {n_tx} x {n_rx} are needed"
        )
    return start, slot


def _whole(table: MeasuredTable, name: str, most: int) -> IntArray:
    value = table.needed({name: 1.0})
    bad = np.flatnonzero((value != np.round(value)) | (value < 0) | (value > most))
    if len(bad):
        raise table.wrong(int(bad[0]), name, value[bad[0]], f"must be a whole number from 0 to {most}")
    return value.astype(int)


def prefix_s(prs: PrsConfig) -> float:
    """The usual length of a cyclic prefix."""
    return PREFIX_SHARE[prs.cyclic_prefix] / prs.subcarrier_spacing_hz
