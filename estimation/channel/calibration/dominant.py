"""Dominant paths, found without beam patterns: single paths in their delay cell over all beam pairs."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy.fft

from estimation.channel.model.delay import OVERSAMPLING, hann_window, parabola_peak
from scenes.record import ComplexArray, FloatArray, IntArray, Record, array
from sim.observation import BeamSweep

REACH = 5 * OVERSAMPLING  # bins to either side without other paths: the Hann main lobe, and a guard
FREE_DB = 20.0  # another path there must be this far below
NOISE_STD = 4.0  # standard deviations of the summed noise power up to which it counts as noise
KEPT_PURITY = 0.97  # of complex beam-pair matrices, above which phases count as coherent


@dataclass(frozen=True)
class DominantPaths(Record):
    """Single paths in their delay cells: complex amplitude of every beam pair in units of its noise.

    A single path gives a matrix of rank 1. Purity is the share of the first singular value in the power above
    noise.
    """

    amplitude: ComplexArray = array("path", "tx_beam", "rx_beam", dtype="complex64", doc="over noise")
    rx_noise: FloatArray = array("rx_beam", unit="sqrt(mW)", doc="noise amplitude of the RX beams")

    def __len__(self) -> int:
        return self.size("path")

    @property
    def snr(self) -> FloatArray:
        """Power (path,) of every path, summed over beam pairs, over the noise power of one beam pair."""
        return np.asarray(np.linalg.norm(self.amplitude.astype(complex), axis=(1, 2)) ** 2)

    def purity(self, is_coherent: bool) -> FloatArray:
        """Share (path,) of the first singular value in the power above noise."""
        value = np.linalg.svd(self._matrix(is_coherent), compute_uv=False)
        n_pairs = self.amplitude[0].size if len(self) else 0
        noise = n_pairs if is_coherent else 0.5 * n_pairs  # magnitudes of weak pairs hold half of it
        return np.asarray(value[:, 0] ** 2 / np.maximum((value**2).sum(axis=1) - noise, value[:, 0] ** 2))

    def phases_may_be_coherent(self) -> bool:
        """Whether most of these paths have rank 1 with their phases; it does not reveal a slow drift."""
        return bool(len(self) and np.median(self.purity(True)) >= KEPT_PURITY)

    def pure(self, is_coherent: bool, min_purity: float) -> Self:
        """The paths whose purity is that of a single path."""
        return self.take("path", self.purity(is_coherent) >= min_purity)

    def vectors(self, is_coherent: bool) -> tuple[ComplexArray, ComplexArray]:
        """Unit responses of TX (path, tx_beam) and RX (path, rx_beam), without the RX noise weights."""
        left, _, right = np.linalg.svd(self._matrix(is_coherent), full_matrices=False)
        rx = right[:, 0] * self.rx_noise
        return left[:, :, 0], rx / np.linalg.norm(rx, axis=1, keepdims=True)

    def _matrix(self, is_coherent: bool) -> ComplexArray:
        if is_coherent:
            return np.asarray(self.amplitude, complex)
        power = np.square(np.abs(self.amplitude.astype(complex)))
        return np.asarray(np.sqrt(np.maximum(power - 1, 0)), complex)


def dominant_paths(sweep: BeamSweep, min_snr_db: float) -> DominantPaths:
    """Paths of a stop of at least `min_snr_db` in their best beam pair, with no other path near in delay."""
    n = sweep.samples.shape[-1]
    window = hann_window(n)
    noise = sweep.noise_power_mw * (window**2).sum() / n**2
    total, best = _delay_profile(sweep, window, noise)
    n_pairs = sweep.size("tx_beam") * sweep.size("rx_beam")
    bins = _isolated(total - n_pairs, NOISE_STD * np.sqrt(n_pairs), best, 10 ** (min_snr_db / 10))
    offset = np.array([parabola_peak(np.log(np.roll(total, 2 - b)[:5]), 2) for b in bins])
    turn = 2j * np.pi * np.outer(np.arange(n), (bins + offset) / (OVERSAMPLING * n))
    wave = (np.exp(turn) * (window / n)[:, None]).astype(np.complex64)
    amplitude = np.stack([(s * x.conj()) @ wave for s, x in zip(sweep.samples, sweep.prs_symbol, strict=True)])
    return DominantPaths(amplitude=np.moveaxis(amplitude, 2, 0) / np.sqrt(noise), rx_noise=np.sqrt(noise))


def _delay_profile(sweep: BeamSweep, window: FloatArray, noise_mw: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Power over noise (delay,), summed over beam pairs, and of the best beam pair."""
    n = len(window)
    total, best = np.zeros(OVERSAMPLING * n), np.zeros(OVERSAMPLING * n)
    for samples, symbols in zip(sweep.samples, sweep.prs_symbol, strict=True):
        descrambled = samples * (symbols.conj() * (window / n)).astype(np.complex64)
        response = scipy.fft.ifft(descrambled, OVERSAMPLING * n, axis=-1, norm="forward", overwrite_x=True)
        snr = (response.real**2 + response.imag**2) / noise_mw[:, None]
        total += snr.sum(axis=0)
        best = np.maximum(best, snr.max(axis=0))
    return total, best


def _isolated(total: FloatArray, noise: float, best: FloatArray, min_snr: float) -> IntArray:
    """Bins of the peaks of the total power (delay,) without another peak or shoulder in their neighbourhood.

    Noise alone changes the total by less than `noise`.
    """
    neighbour = np.maximum(np.roll(total, 1), np.roll(total, -1))
    near_best = np.maximum(np.maximum(np.roll(best, 1), np.roll(best, -1)), best)
    peak = np.flatnonzero((total >= neighbour) & (near_best >= min_snr))
    reach = np.arange(-REACH, REACH + 1)
    around = total[(peak[:, None] + reach) % len(total)]
    outside = np.abs(reach) > 2 * OVERSAMPLING
    level = around[:, outside].max(axis=1) if len(peak) else np.zeros(0)
    return peak[level <= np.maximum(total[peak] * 10 ** (-FREE_DB / 10), noise)]
