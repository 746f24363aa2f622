"""Detection: peaks of the delay-resolved beam power that neither noise nor side lobes explain."""

from dataclasses import dataclass

import numpy as np

from estimation.channel.model.delay import OVERSAMPLING, DelayPower, window_response
from estimation.channel.power.beams import BeamAxis
from scenes.record import FloatArray, IntArray, Record, array


@dataclass(frozen=True)
class Peaks(Record):
    """Cells of the power cube, strongest first."""

    tx_beam: IntArray = array("peak", dtype=int, doc="TX beam index")
    rx_beam: IntArray = array("peak", dtype=int, doc="RX beam index")
    delay: IntArray = array("peak", dtype=int, doc="delay bin index")
    snr: FloatArray = array("peak", doc="power over noise power of the cell")

    def __len__(self) -> int:
        return self.size("peak")


def noise_threshold(n_cells: float, false_alarm_probability: float) -> float:
    """SNR that noise alone exceeds in any of `n_cells` independent cells with the given probability.

    The power of complex Gaussian noise is exponential: P_fa = 1 - (1 - exp(-T))^n.
    """
    return float(-np.log(-np.expm1(np.log1p(-false_alarm_probability) / n_cells)))


def local_maxima(power: DelayPower, tx: BeamAxis, rx: BeamAxis, threshold: float) -> Peaks:
    """Cells above `threshold` (SNR) that no neighbour in beam, beam and delay exceeds, strongest first.

    Neighbouring beams are the next in pointing azimuth, around the circle if the axis is closed.
    """
    snr = power.snr
    m, n, d = np.nonzero(snr > threshold)
    value = snr[m, n, d]
    keep = np.ones(len(value), bool)
    for step_m in (-1, 0, 1):
        neighbour_m = tx.neighbour(m, step_m)
        for step_n in (-1, 0, 1):
            neighbour_n = rx.neighbour(n, step_n)
            for step_d in (-1, 0, 1):
                if step_m or step_n or step_d:
                    keep &= value >= snr[neighbour_m, neighbour_n, (d + step_d) % snr.shape[2]]
    order = np.lexsort([d[keep], n[keep], m[keep], -value[keep]])
    chosen = np.flatnonzero(keep)[order]
    return Peaks(tx_beam=m[chosen], rx_beam=n[chosen], delay=d[chosen], snr=value[chosen].astype(float))


class SideLobeEnvelope:
    """Largest amplitude that the accepted paths can cause in other cells.

    It follows from beam patterns and window. Amplitudes of paths are added, since their phases are unknown.
    """

    def __init__(self, tx: BeamAxis, rx: BeamAxis, n_delays: int) -> None:
        self._tx, self._rx, self._n_delays = tx, rx, n_delays
        self._paths: list[tuple[float, FloatArray, FloatArray, float]] = []

    def add(self, snr: float, aod_azimuth_rad: float, aoa_azimuth_rad: float, delay_bin: float) -> None:
        """Add a path with this peak SNR, angles and (fractional) delay bin."""
        tx_amplitude = self._tx.relative_amplitude(aod_azimuth_rad)
        rx_amplitude = self._rx.relative_amplitude(aoa_azimuth_rad)
        self._paths.append((np.sqrt(snr), tx_amplitude, rx_amplitude, delay_bin))

    def contributions(self, tx_beam: IntArray, rx_beam: IntArray, delay: FloatArray) -> FloatArray:
        """Amplitude (path, cell) of every accepted path in the given cells, in units of the noise amplitude."""
        rows = [
            amplitude
            * tx_amplitude[tx_beam]
            * rx_amplitude[rx_beam]
            * window_response(self._offset_bins(delay - delay_bin), self._n_delays // OVERSAMPLING)
            for amplitude, tx_amplitude, rx_amplitude, delay_bin in self._paths
        ]
        return np.stack(rows) if rows else np.zeros((0, len(tx_beam)))

    def _offset_bins(self, difference: FloatArray) -> FloatArray:
        half = self._n_delays / 2
        return np.asarray(((difference + half) % self._n_delays - half) / OVERSAMPLING)
