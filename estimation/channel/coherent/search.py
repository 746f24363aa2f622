"""Search for paths: a matched-filter spectrum over delay and angles, its peaks, and the removal of side lobes."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from estimation.channel.model.alike import alike_directions, padded_rows
from estimation.channel.model.compress import CompressedSweep
from estimation.channel.model.kernels import dirichlet
from estimation.channel.model.manifold import CELL, Manifold
from estimation.channel.model.path_model import PathParameters, no_paths, response_energies, responses
from estimation.channel.model.spectrum import cell_power, local_maxima, times, with_neighbours
from estimation.channel.model.turns import SweepTurns
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray

NEIGHBOUR_COHERENCE = 0.5  # of directions about half a resolution cell apart: grid neighbours
CLOSE_BINS = 1.5
FILTER_REACH_BINS = 24  # of the response between two bins that is summed: 99.2 % of its energy
BINS_AT_ONCE = 64
USUAL = 0.9  # of the directions have smaller rates of turns than that taken for all
CELLS_AT_ONCE = 1 << 18  # spectrum cells held at a time
ROUNDING = 1e-3  # of powers in single precision


@dataclass(frozen=True)
class DirectionGrid:
    """Directions searched at one end.

    Attributes
    ----------
    angle_rad : (direction, angle)
    matched : (direction, rank) conjugate responses of unit norm, single precision, real if the responses are
    neighbour : (direction, place) neighbouring directions, padded with the direction itself
    envelope : (direction, direction) largest side lobe around the first direction of a path near the second
    close : (direction, direction) whether two are within about one and a half resolution cells
    twin : (direction, place) directions elsewhere that respond alike, padded with the direction itself
    """

    angle_rad: FloatArray
    matched: ComplexArray | FloatArray
    neighbour: IntArray
    envelope: FloatArray
    close: BoolArray
    twin: IntArray


@dataclass(frozen=True)
class SpectrumPeaks:
    """Local maxima of the spectrum, strongest first: indices on the grids, delay in bins, filter output, turns."""

    tx: IntArray
    rx: IntArray
    delay_bins: FloatArray
    value: ComplexArray
    doppler_turns: FloatArray

    def __len__(self) -> int:
        return len(self.tx)

    def take(self, index: IntArray | BoolArray | slice) -> SpectrumPeaks:
        """Some of the peaks."""
        return SpectrumPeaks(*(getattr(self, spec.name)[index] for spec in fields(self)))


def direction_grid(manifold: Manifold, oversampling: float) -> DirectionGrid:
    """Grid over all directions that the beams cover, `oversampling` per resolution cell."""
    angles = manifold.grid(oversampling)
    response = manifold.response(angles)
    unit = response / np.linalg.norm(response, axis=1, keepdims=True)
    matched = unit.real.astype(np.float32) if manifold.is_real else unit.conj().astype(np.complex64)
    coherence = np.abs(unit @ unit.conj().T)
    next_to = coherence >= NEIGHBOUR_COHERENCE
    neighbour = padded_rows([np.flatnonzero(row) for row in next_to])
    envelope = coherence[neighbour].max(axis=1)
    twin = alike_directions(manifold, angles, coherence, NEIGHBOUR_COHERENCE)
    close = np.linalg.matrix_power(next_to.astype(float), round(1.5 * oversampling)) > 0
    return DirectionGrid(angles, matched, neighbour, envelope, close, twin)


class SpectrumSearch:
    """The search of one compressed sweep: matched-filter spectra of its samples or of residuals."""

    def __init__(
        self, sweep: CompressedSweep, grids: tuple[DirectionGrid, DirectionGrid], oversampling: int
    ) -> None:
        self.sweep, self.grids = sweep, grids
        parts = np.arange(oversampling) / oversampling
        self._delay_bins = (sweep.position[:, None] + parts).ravel()
        # At whole bins the response is a single bin, so only the delays in between need a product.
        apart, weight = (sweep.position - sweep.position[0]).tobytes(), sweep.weight.tobytes()
        self._between = [_matched_delays(apart, weight, part, sweep.n_subcarriers) for part in parts[1:]]
        self.turns = searched_turns(sweep.turns, grids, oversampling)
        (tx, n_tx), (rx, n_rx) = (grid.matched.shape for grid in grids)
        # The end whose product with all samples, and that of the other end after it, take fewer operations.
        self._rx_first = rx * n_tx * (n_rx + tx) < tx * n_rx * (n_tx + rx)

    def peaks(self, parts: FloatArray, level: float, share: float = 0.0) -> SpectrumPeaks:
        """Local maxima of the spectrum of samples given as parts (part, tx_rank, rx_rank, bin), strongest first.

        They are above `level`, and have at least this `share` of the largest amplitude. The spectrum is the power
        of a path at each place in units of the noise. It is computed a few delays at a time, and with a share only
        where it may be large enough: no direction has more power than all samples of a delay together.
        """
        fine, (first, second) = self._delay_filtered(parts), self._in_order
        n_at_once = max(8, CELLS_AT_ONCE // (len(first.angle_rad) * len(second.angle_rad)))
        needed = np.arange(fine.shape[2])
        if share:
            most = cell_power(fine).sum(axis=(0, 1))
            strong = self._strongest_turn(fine[..., [most.argmax()]])[1].max()
            level = max(level, share**2 * float(strong))
            needed = np.flatnonzero(with_neighbours(most * (1 + ROUNDING) >= level))
        found = []
        for start in range(0, len(needed), n_at_once):
            low, high = max(0, start - 1), min(len(needed), start + n_at_once + 1)
            value, power, best = self._strongest_turn(np.ascontiguousarray(fine[..., needed[low:high]]))
            i, j, d = local_maxima(power, first.neighbour, second.neighbour, np.float32(level)).T
            inside = (d + low >= start) & (d + low < start + n_at_once)
            i, j, d = i[inside], j[inside], d[inside]
            turns = self.turns[best[i, j, d]] if best is not None else np.zeros((len(i), 0))
            tx, rx = (j, i) if self._rx_first else (i, j)
            delay_bins = self._delay_bins[needed[d + low]]
            found.append(SpectrumPeaks(tx, rx, delay_bins, value[i, j, d].astype(complex), turns))
        peaks = _joined(found) if found else _no_peaks(self.turns)
        peaks = peaks.take(np.abs(peaks.value) >= share * np.abs(peaks.value).max(initial=0.0))
        return peaks.take(np.argsort(-np.abs(peaks.value), kind="stable"))

    def paths(self, peaks: SpectrumPeaks) -> PathParameters:
        """Paths at the grid points of peaks, with the matched amplitudes there."""
        tx, rx = self.grids
        if not len(peaks):
            return no_paths(self.sweep)
        aod = _at_horizon(tx.angle_rad[peaks.tx], self.sweep.tx)
        aoa = _at_horizon(rx.angle_rad[peaks.rx], self.sweep.rx)
        paths = PathParameters(peaks.delay_bins, aod, aoa, peaks.value, peaks.doppler_turns)
        return replace(paths, amplitude=peaks.value / np.sqrt(response_energies(responses(self.sweep, paths))))

    def with_twins(self, peaks: SpectrumPeaks) -> tuple[SpectrumPeaks, IntArray]:
        """Every peak, and the same at each twin of its two directions; and the number (peak,) of its original."""
        own = np.arange(len(peaks))
        found, origin = [peaks], [own]
        for name, grid in zip(("tx", "rx"), self.grids, strict=True):
            twin = grid.twin[getattr(peaks, name)][:, 1:]
            row, place = np.nonzero(twin != getattr(peaks, name)[:, None])
            found.append(replace(peaks.take(row), **{name: twin[row, place]}))
            origin.append(row)
        return _joined(found), np.concatenate(origin)

    @property
    def _in_order(self) -> tuple[DirectionGrid, DirectionGrid]:
        """The grids in the order in which the axes of a spectrum are."""
        return self.grids[::-1] if self._rx_first else self.grids

    def _strongest_turn(self, fine: ComplexArray) -> tuple[ComplexArray, FloatArray, IntArray | None]:
        """Spectrum (direction, direction, delay) and its power, largest over the searched turns.

        The last result is the number of the turns (direction, direction, delay), None if none are searched.
        """
        turns = self.sweep.turns
        if turns is None:
            value = self._spectrum(fine)
            return value, cell_power(value), None
        largest: tuple[ComplexArray, FloatArray, IntArray] | None = None
        for number, turn in enumerate(self.turns):
            tx, rx = (turns.wave(turn[None], is_tx=is_tx)[0].conj() for is_tx in (True, False))
            value = self._spectrum(fine * (tx[:, None] * rx).astype(np.complex64)[..., None])
            power = cell_power(value)
            if largest is None:
                largest = value, power, np.zeros(power.shape, np.int64)
                continue
            more = power > largest[1]
            for kept, new in zip(largest[:2], (value, power), strict=True):
                np.copyto(kept, new, where=more)
            largest[2][more] = number
        assert largest is not None
        return largest

    def _spectrum(self, fine: ComplexArray) -> ComplexArray:
        """Filter output (direction, direction, delay) of samples (tx_rank, rx_rank, delay), axes `_in_order`."""
        first, second = (grid.matched for grid in self._in_order)
        samples = fine.swapaxes(0, 1) if self._rx_first else fine
        n, _, n_delays = samples.shape
        beams = times(first, np.ascontiguousarray(samples).reshape(n, -1))
        return times(second, beams.reshape(len(first), -1, n_delays))

    def _delay_filtered(self, parts: FloatArray) -> ComplexArray:
        """Samples (tx_rank, rx_rank, delay) matched to all delays of the grid."""
        n_bins = parts.shape[3]
        rows = parts.reshape(-1, n_bins)
        fine: FloatArray = np.empty((len(rows), n_bins, 1 + len(self._between)), np.float32)
        fine[..., 0] = rows
        for start in range(0, n_bins, BINS_AT_ONCE):
            end = min(n_bins, start + BINS_AT_ONCE)
            near = slice(max(0, start - FILTER_REACH_BINS), end + FILTER_REACH_BINS)
            for k, matched in enumerate(self._between):
                fine[:, start:end, k + 1] = rows[:, near] @ matched[near, start:end]
        real, imaginary = fine.reshape(*parts.shape[:3], -1)
        return np.asarray(real + 1j * imaginary)


def searched_turns(
    turns: SweepTurns | None, grids: tuple[DirectionGrid, DirectionGrid], oversampling: float
) -> FloatArray:
    """Doppler shifts (shift, 1) in turns that are searched; none of them zero."""
    if turns is None:
        return np.zeros((0, 1))
    step = CELL / oversampling / turn_rate(turns, grids)
    half = max(1, int(np.ceil(turns.most / step)))
    return np.asarray(step * (np.arange(-half, half) + 0.5)[:, None])


def turn_rate(turns: SweepTurns, grids: tuple[DirectionGrid, DirectionGrid]) -> float:
    """Length on the manifold per turn that few directions of both ends exceed."""
    tx, rx = (grid.matched for grid in grids)
    ends = ((tx, rx[:1] * 0), (tx[:1] * 0, rx))
    return float(np.linalg.norm([np.quantile(turns.rates(*end), USUAL) for end in ends]))


def without_side_lobes(
    peaks: SpectrumPeaks, grids: tuple[DirectionGrid, DirectionGrid], margin: float, at_most: int
) -> SpectrumPeaks:
    """Peaks, from the strongest down, that exceed `margin` times all side lobes of the peaks kept before.

    Side lobes of several paths are added in amplitude, as if they were in phase. Of peaks close to each other on
    all axes only the strongest is kept: the residual of a misplaced path has two.
    """
    tx, rx = grids
    amplitude, explained = np.abs(peaks.value), np.zeros(len(peaks))
    kept: list[int] = []
    for index in range(len(peaks)):
        if len(kept) == at_most:
            break
        if amplitude[index] <= margin * explained[index]:
            continue
        kept.append(index)
        distance = np.abs(peaks.delay_bins - peaks.delay_bins[index])
        lobe = 1 / np.maximum(1.0, distance)
        lobe *= tx.envelope[peaks.tx, peaks.tx[index]] * rx.envelope[peaks.rx, peaks.rx[index]]
        is_close = tx.close[peaks.tx, peaks.tx[index]] & rx.close[peaks.rx, peaks.rx[index]]
        explained += amplitude[index] * np.where(is_close & (distance <= CLOSE_BINS), 1.0, lobe)
    return peaks.take(np.array(kept, int))


def _joined(peaks: list[SpectrumPeaks]) -> SpectrumPeaks:
    return SpectrumPeaks(*(np.concatenate([getattr(p, f.name) for p in peaks]) for f in fields(SpectrumPeaks)))


def _at_horizon(angles_rad: FloatArray, manifold: Manifold) -> FloatArray:
    """Directions of the grid with as many angles as the manifold has: hidden elevations start at zero."""
    return np.pad(angles_rad, ((0, 0), (0, manifold.n_angles - angles_rad.shape[1])))


@lru_cache(maxsize=16)
def _matched_delays(apart: bytes, weight: bytes, part: float, n_subcarriers: int) -> FloatArray:
    """Responses of unit norm (bin, delay), single precision, to the delays `part` of a bin after every bin.

    Only distances count, so one table serves all stops with equally spaced bins of equal weights; both are bytes.
    """
    position = np.frombuffer(apart, int)
    response = dirichlet(position, position + part, n_subcarriers)[:, 0] * np.frombuffer(weight)
    return np.asarray((response / np.linalg.norm(response, axis=1, keepdims=True)).T.astype(np.float32))


def _no_peaks(turns: FloatArray) -> SpectrumPeaks:
    none = np.zeros(0, int)
    return SpectrumPeaks(none, none, np.zeros(0), np.zeros(0, complex), np.zeros((0, turns.shape[1])))
