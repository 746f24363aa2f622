"""Candidates for paths: delays and directions at which the amplitudes of many beam pairs rise together.

The sum over beam pairs of amplitudes |r| with the weights |G_TX| |G_RX| is the limit of the likelihood ratio for
strong pairs (log I0(x) ~ x). It is separable over the two ends, hence two matrix products, and nearly Gaussian for
noise alone. It only proposes; the likelihood decides.
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from estimation.channel.incoherent.grid_kernels import cell_amplitudes, column_maxima
from estimation.channel.incoherent.spectrum import DelaySpectrum
from estimation.channel.model.alike import alike_directions
from estimation.channel.model.apparent import cone_angles
from estimation.channel.model.manifold import Manifold
from scenes.pose import wrap_angle
from scenes.record import ComplexArray, FloatArray, IntArray, Record, array

_NOISE_STD = np.sqrt(1 - np.pi / 4)  # of the amplitude of unit noise
_DELAYS_AT_ONCE = 128
_HIDDEN = 0.4  # of a candidate's level: allowed for candidates of its delay in other directions
_ALIKE = 0.8  # of the magnitudes over all beams, above which directions are tried for each other
_SIDE_LOBE_MARGIN = 1.6  # by which a candidate must exceed the side lobes of stronger ones


@dataclass(frozen=True)
class Candidates(Record):
    """Candidate places of paths, strongest first."""

    delay_bins: FloatArray = array("candidate", doc="delay in bins")
    tx_direction: IntArray = array("candidate", dtype=int, doc="index of the direction of departure")
    rx_direction: IntArray = array("candidate", dtype=int, doc="index of the direction of arrival")
    level: FloatArray = array("candidate", doc="summed amplitude in standard deviations of noise")

    def __len__(self) -> int:
        return self.size("candidate")


@dataclass(frozen=True)
class Screen:
    """Search directions of both ends and the weight of every beam for each, of unit norm."""

    tx_angles: FloatArray  # (direction, angle)
    rx_angles: FloatArray
    tx_weight: FloatArray  # (direction, tx_beam), float32
    rx_weight: FloatArray
    tx_twin: IntArray  # (direction, place) directions elsewhere whose magnitudes are alike, padded with itself
    rx_twin: IntArray

    @classmethod
    def make(
        cls, tx: Manifold, rx: Manifold, tx_grid: FloatArray, rx_grid: FloatArray, noise_mw: FloatArray
    ) -> Self:
        """Screen for directions (direction, angle) of both ends; `noise_mw` is (rx_beam,)."""
        tx_weight = _weights(np.abs(tx.response(tx_grid)))
        rx_weight = _weights(np.abs(rx.response(rx_grid)) / np.sqrt(noise_mw))
        return cls(
            tx_angles=tx_grid,
            rx_angles=rx_grid,
            tx_weight=tx_weight,
            rx_weight=rx_weight,
            tx_twin=_twins(tx, tx_grid, tx_weight),
            rx_twin=_twins(rx, rx_grid, rx_weight),
        )

    def twins(self, tx_direction: int, rx_direction: int) -> FloatArray:
        """Angles (place, departure and arrival) of a pair of directions, first, and of all that are alike."""
        tx, rx = np.unique(self.tx_twin[tx_direction]), np.unique(self.rx_twin[rx_direction])
        tx, rx = (
            tx[np.argsort(tx != tx_direction, kind="stable")],
            rx[np.argsort(rx != rx_direction, kind="stable")],
        )
        return np.column_stack(
            [np.repeat(self.tx_angles[tx], len(rx), axis=0), np.tile(self.rx_angles[rx].T, len(tx)).T]
        )

    def levels(self, value: ComplexArray, noise_mw: FloatArray, sign: float) -> tuple[FloatArray, IntArray]:
        """Highest level over directions, and its place, (delay,) each, at bins and half way to the next in turn.

        `value` is (tx_beam, rx_beam, bin), one bin more than are searched; `noise_mw` (rx_beam,) its noise.
        """
        n_tx, n_rx, n = value.shape
        amplitude = np.empty((n_tx, n_rx, 2, n - 1), np.float32)
        cell_amplitudes(value, (1 / np.sqrt(noise_mw)).astype(np.float32), sign, amplitude)
        n_delays, (tx, rx) = 2 * (n - 1), (len(self.tx_weight), len(self.rx_weight))
        # First the end whose product with all samples, and that of the other end after it, take fewer operations.
        if rx * n_tx * (n_rx + tx) < tx * n_rx * (n_tx + rx):
            half = self.rx_weight @ amplitude.reshape(n_tx, n_rx, n_delays)
            summed = self.tx_weight @ half.reshape(n_tx, -1)
        else:
            half = self.tx_weight @ amplitude.reshape(n_tx, -1)
            summed = self.rx_weight @ half.reshape(tx, n_rx, n_delays)
        level, place = column_maxima(summed.reshape(-1, n_delays))
        return _interleaved(level / _NOISE_STD), _interleaved(place)

    def all_levels(self, spectrum: DelaySpectrum) -> tuple[FloatArray, IntArray]:
        """`levels` of a whole spectrum, (2 bin,) each, a few delays at a time."""
        parts = []
        for first in range(0, spectrum.n_bins, _DELAYS_AT_ONCE):
            value = spectrum.value[:, :, first : first + _DELAYS_AT_ONCE + 1]
            if first + _DELAYS_AT_ONCE >= spectrum.n_bins:  # the last bin's neighbour is the first
                value = np.concatenate([value, spectrum.value[:, :, :1]], axis=2)
            # Relative to the first subcarrier, the phase of a path changes by nearly pi from bin to bin.
            parts.append(self.levels(value, spectrum.noise_mw, -1.0))
        level, place = zip(*parts, strict=True)
        return np.concatenate(level), np.concatenate(place)

    def candidates(
        self, level: FloatArray, place: IntArray, delay_bins: FloatArray, lowest: float, most: int
    ) -> Candidates:
        """Peaks over delay that are no side lobes of stronger ones, strongest first, up to a largest number.

        `level` and `place` are those of `levels`; `delay_bins` (delay,) may have gaps. None is below `lowest`.
        """
        before, after = np.roll(level, 1), np.roll(level, -1)
        peak = np.flatnonzero((level >= lowest) & (level >= before) & (level > after))
        peak = peak[np.argsort(-level[peak], kind="stable")]
        tx, rx = np.divmod(place, len(self.rx_angles))
        expected = np.zeros(len(peak))
        chosen: list[int] = []
        for index, at in enumerate(peak.tolist()):
            if len(chosen) == most:
                break
            if level[at] < _SIDE_LOBE_MARGIN * expected[index]:
                continue
            chosen.append(at)
            distance = np.abs(delay_bins[peak] - delay_bins[at])
            similarity = (self.tx_weight[tx[peak]] @ self.tx_weight[tx[at]]) * (
                self.rx_weight[rx[peak]] @ self.rx_weight[rx[at]]
            )
            similarity[(distance > 0.5)] = np.maximum(similarity[distance > 0.5], _HIDDEN)
            expected += level[at] * similarity / np.maximum(1.0, np.pi * distance)
        at_peaks = np.array(chosen, int)
        return Candidates(delay_bins[at_peaks], tx[at_peaks], rx[at_peaks], level[at_peaks])


def _interleaved(values: NDArray[Any]) -> NDArray[Any]:
    """Values at all bins and then at all half bins, in order of delay."""
    return values.reshape(2, -1).T.ravel()


def _twins(manifold: Manifold, angles: FloatArray, weight: FloatArray) -> IntArray:
    """Of every direction those with like magnitudes and that of the same cone at the horizon, (direction, place).

    Reflections from above and below in the same cell change the magnitudes, not the cone.
    """
    if manifold.n_angles == 1:
        return np.arange(len(angles))[:, None]
    cone, _ = cone_angles(angles[:, 0], angles[:, 1], manifold.best_panel_rad(angles))
    level = np.abs(angles[:, 1])
    at_horizon = np.flatnonzero(level == level.min())
    nearest = np.abs(wrap_angle(cone[:, None] - angles[at_horizon, 0])).argmin(axis=1)
    return np.column_stack([alike_directions(manifold, angles, weight @ weight.T, _ALIKE), at_horizon[nearest]])


def _weights(amplitude: FloatArray) -> FloatArray:
    norm = np.linalg.norm(amplitude, axis=1, keepdims=True)
    return np.asarray(amplitude / np.maximum(norm, 1e-300), np.float32)
