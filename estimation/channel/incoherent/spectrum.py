"""The delay spectrum of a sweep in units of its noise, and windows of it around the delays of paths.

With the phase reference at the centre of the band a path at delay x (in bins of 1 / bandwidth) has the
real spectrum

    v_n(x) = sin(pi (n - x)) / (sqrt(K) sin(pi (n - x) / K)),    sum_n v_n^2 = K,

so that the spectrum of a beam pair is mu_n = a v_n(x), a the path's amplitude in that pair over the noise.
"""

from dataclasses import dataclass

import numpy as np
import scipy.fft

from estimation.channel.incoherent.grid_kernels import waves_and_slopes
from estimation.channel.model.compress import LEAST_NOISE, NOISE_CELLS
from scenes.record import ComplexArray, FloatArray, IntArray
from sim.observation import BeamSweep

MARGIN_BINS = 48  # of delay around every path in its fit: 0.3 % of a standard deviation is lost
_MEDIAN = np.log(2)  # of a unit exponential
_NOISE_SAMPLES = 25_000  # per RX beam: they determine its noise level to 1 %
_TRUSTED_SHARE = (0.05, 0.95)  # of samples below the nominal median, within which the noise level is reliable


@dataclass(frozen=True)
class DelaySpectrum:
    """Unitary delay spectrum (tx_beam, rx_beam, delay) of the descrambled samples.

    `value` is in sqrt(mW), complex64, its phase relative to the first subcarrier; `noise_mw` (rx_beam,) is the
    measured noise power of each of its entries, infinite for a beam whose samples are all zero. Bins are periodic,
    `bin_s` apart.
    """

    value: ComplexArray
    noise_mw: FloatArray
    bin_s: float

    @property
    def n_bins(self) -> int:
        """Number of delay bins, equal to that of the subcarriers."""
        return int(self.value.shape[2])

    def window(self, bins: IntArray) -> ComplexArray:
        """Samples (pair, bin) at some delay bins in units of the noise, pairs ordered by TX beam.

        Bins may be outside of 0 to K - 1: v_n changes its sign from one period to the next if K is even.
        """
        inside = bins % self.n_bins
        # The phase is relative to the centre of the band here; v_n changes sign with the period if K is even.
        turn = np.exp(-1j * np.pi * (self.n_bins - 1) / self.n_bins * bins)
        scale = (turn / np.sqrt(self.noise_mw)[:, None]).astype(np.complex64)
        n_pairs = self.value.shape[0] * self.value.shape[1]
        return np.asarray((self.value[:, :, inside] * scale).reshape(n_pairs, len(bins)))


def delay_spectrum(sweep: BeamSweep) -> DelaySpectrum:
    """Delay spectrum of a sweep, the known PRS divided out.

    The noise level of every RX beam is estimated from a quantile: if x is the median expected for the nominal
    level and F the share of samples whose power is below x, sigma^2 = -x / log(1 - F). Paths hardly affect it,
    since they fill few of the delays. If the nominal level is far off, the median is used; with few samples, the
    nominal level.

    Raises `ValueError` for samples that are not finite.
    """
    n = sweep.samples.shape[2]
    spacing_hz = float(np.ptp(sweep.frequency_offset_hz)) / (n - 1)
    step = max(1, sweep.samples.shape[0] * n // _NOISE_SAMPLES)
    value: ComplexArray = np.empty(sweep.samples.shape, np.complex64)
    nominal_mw = sweep.noise_power_mw.astype(float)
    limit = np.sqrt(nominal_mw * _MEDIAN).astype(np.float32)
    below = np.zeros(value.shape[1])
    descrambled = np.empty(value.shape[1:], np.complex64)
    for block, samples, symbols in zip(value, sweep.samples, sweep.prs_symbol, strict=True):
        with np.errstate(invalid="ignore"):
            np.multiply(samples, symbols.conj(), out=descrambled)
            block[:] = scipy.fft.ifft(descrambled, axis=-1, norm="ortho", overwrite_x=True)
        below += np.count_nonzero(np.abs(block[:, ::step]) < limit[:, None], axis=1)
    bad = np.argwhere(~np.isfinite(value[:, :, 0]))  # one bad sample affects all delays of its pair
    if len(bad):
        pair = tuple(bad[0].tolist())
        raise ValueError(f"BeamSweep.samples at stop {sweep.stop}: beam pair {pair} is not finite")
    noise_mw, n_counted = nominal_mw, value.shape[0] * len(range(0, n, step))
    if value.shape[0] * n >= NOISE_CELLS:
        noise_mw = _measured_noise_mw(value, nominal_mw, below / n_counted)
    is_dead = [count == n_counted and not value[:, j].any() for j, count in enumerate(below)]
    return DelaySpectrum(value, np.where(is_dead, np.inf, noise_mw), 1 / (n * spacing_hz))


def _measured_noise_mw(value: ComplexArray, nominal_mw: FloatArray, share: FloatArray) -> FloatArray:
    """Noise power (rx_beam,) from the `share` of samples below the median of the nominal level."""
    low, high = _TRUSTED_SHARE
    trusted = (share > low) & (share < high)
    noise_mw = -_MEDIAN * nominal_mw / np.log1p(-np.where(trusted, share, 0.5))
    for beam in np.flatnonzero(~trusted):
        noise_mw[beam] = np.median(np.abs(value[:, beam]).astype(float) ** 2) / _MEDIAN
    return np.asarray(np.maximum(noise_mw, LEAST_NOISE * nominal_mw))


def delay_waves(bins: IntArray, delay_bins: FloatArray, n_bins: int) -> tuple[FloatArray, FloatArray]:
    """Spectra v_n(x) (bin, delay) of paths at delays x in bins, and their derivatives over x.

    Bins and delays are less than one period apart.
    """
    value, slope = waves_and_slopes(bins, delay_bins, n_bins)
    return value, slope


def window_bins(delay_bins: FloatArray, n_bins: int) -> IntArray:
    """Delay bins (bin,) around the delays, ascending, within the period that begins an eighth below zero."""
    reach = np.arange(-MARGIN_BINS, MARGIN_BINS + 2)
    bins = np.unique(np.rint(delay_bins).astype(int)[:, None] + reach)
    first = -(n_bins // 8)
    return bins[(bins >= first) & (bins < first + n_bins)]
