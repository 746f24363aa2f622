"""Timing, carrier frequency offset and sampling offset of a recording, from its strongest beam pairs.

The fractional frequency offset turns the end of a symbol against its prefix (van de Beek, Sandell and Borjesson,
1997). The whole subcarriers of the offset are those at which the pilots correlate best. The arrivals of the pilots
over the sweep lie on a line: its offset is the timing, its slope the sampling offset (Theil, 1950; Sen, 1968).
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from scipy.stats import theilslopes

from isac_arena.exchange.iq.config import RecordingConfig
from isac_arena.exchange.iq.samples import IqRecording
from isac_arena.exchange.iq.times import Pilots, SweepTimes, prefix_s
from scenes.record import ComplexArray, FloatArray, IntArray

STRONGEST = 96  # beam pairs that are correlated
DECIDING = 16  # of them, for the whole subcarriers of the offset
LEAST_PEAK = 8.0  # correlation over its median magnitude: below there is no signal
SHARE = 1e-3  # of the strongest correlation, of the arrivals that make the line
LEAD_S = 100e-9  # delay that the strongest path gets: others may come before it
LEAST_ARRIVALS = 3


@dataclass(frozen=True)
class Synchronisation:
    """Clock and carrier of the receiver against the schedule.

    What the schedule has at t is at `offset_s` + (1 + `drift`) t in the recording, and tones of the baseband are
    `cfo_hz` too high. `n_arrivals` beam pairs tell.
    """

    offset_s: float
    drift: float
    cfo_hz: float
    n_arrivals: int = 0

    def shifted(self, offset_s: float) -> "Synchronisation":
        """The same with a later zero."""
        return replace(self, offset_s=self.offset_s + offset_s)


def fft_size(pilots: Pilots, sample_rate_hz: float) -> int:
    """Samples of the useful part of a symbol; `ValueError` where these are not whole, or too few."""
    spacing_hz, n_tones = pilots.prs.subcarrier_spacing_hz, pilots.prs.n_carrier_subcarriers
    size = sample_rate_hz / spacing_hz
    if abs(size - round(size)) > 1e-6 or round(size) < n_tones:
        raise ValueError(
            f"recording.sample_rate_hz = {sample_rate_hz:g}: must be a whole multiple of the subcarrier spacing of"
            f" {spacing_hz:g} Hz, at least {n_tones} times it; resample the recording"
        )
    return round(size)


def synchronise(
    recording: IqRecording, times: SweepTimes, pilots: Pilots, config: RecordingConfig, rate_hz: float
) -> Synchronisation:
    """Timing, frequency and drift; `ValueError` where no pilots are found."""
    size = fft_size(pilots, rate_hz)
    first = times.start_s[0, :, :, 0].ravel()
    slot = times.slot[0].ravel()
    tx = np.repeat(np.arange(times.slot.shape[1]), times.slot.shape[2])
    search = int(np.ceil(config.search_us * 1e-6 * rate_hz))
    prefix = int(prefix_s(pilots.prs) * rate_hz)
    begin = np.floor((config.start_s + first) * rate_hz).astype(int) - search - prefix
    length = size + prefix + 2 * search
    chosen = _strongest(recording, begin, length)
    windows = recording.windows(begin[chosen], length)
    spacing_hz = pilots.prs.subcarrier_spacing_hz
    fraction = _fraction(windows, size, prefix) if config.largest_cfo_hz else 0.0
    time = np.arange(length) / rate_hz
    windows = windows * np.exp(-2j * np.pi * fraction * spacing_hz * time).astype(np.complex64)
    waves = np.stack([_wave(pilots, int(tx[one]), int(slot[one]), size) for one in chosen])
    whole, heights, lags = _correlated(windows, waves, round(config.largest_cfo_hz / spacing_hz))
    used = np.flatnonzero(heights > max(LEAST_PEAK, np.sqrt(SHARE) * heights.max()))
    if not len(used):
        raise ValueError(
            f"recording: no pilots within {config.search_us:g} us of recording.start_s = {config.start_s:g}: the"
            f" best correlation is {heights.max():.2g} times its background, {LEAST_PEAK:g} are needed"
        )
    cfo_hz = (whole + fraction) * spacing_hz
    at, arrival = first[chosen][used], (begin[chosen][used] + lags[used]) / rate_hz
    drift, offset = _line(at, arrival - at, heights[used], is_steady=config.largest_drift_ppm == 0)
    if abs(drift) > config.largest_drift_ppm * 1e-6:
        raise ValueError(f"recording.largest_drift_ppm: the sampling rate is off by {1e6 * drift:.3g} ppm")
    lead_s = min(LEAD_S, prefix_s(pilots.prs) / 4)
    return Synchronisation(offset - lead_s, drift, cfo_hz, len(used))


def _strongest(recording: IqRecording, begin: IntArray, length: int) -> IntArray:
    """Numbers of the windows with most energy."""
    energy = [
        float(np.square(np.abs(recording.windows(begin[k : k + 1], length))).sum()) for k in range(len(begin))
    ]
    return np.sort(np.argsort(energy)[::-1][:STRONGEST])


def _fraction(windows: ComplexArray, size: int, prefix: int) -> float:
    """The frequency offset in subcarriers, between -1/2 and 1/2, from prefixes and the ends that they repeat."""
    lagged = windows[:, size:].astype(complex) * windows[:, :-size].conj()
    total = np.cumsum(np.pad(lagged, ((0, 0), (1, 0))), axis=1)
    sums = total[:, prefix:] - total[:, :-prefix]
    best = np.take_along_axis(sums, np.abs(sums).argmax(axis=1)[:, None], axis=1)
    return float(np.angle(best.sum()) / (2 * np.pi))


def _wave(pilots: Pilots, tx_beam: int, slot: int, size: int) -> ComplexArray:
    """The useful part (sample,) of the first symbol of a TX beam."""
    symbol = pilots.symbols[0]
    spectrum = np.zeros(size, complex)
    spectrum[pilots.tones(symbol) % size] = pilots.of(tx_beam, slot, symbol)
    return np.asarray(scipy.fft.ifft(spectrum, norm="ortho"))


def _correlated(windows: ComplexArray, waves: ComplexArray, most: int) -> tuple[int, FloatArray, IntArray]:
    """Whole subcarriers of the offset; peak over background and lag (window,) of the correlation there."""
    length, size = windows.shape[1], waves.shape[1]
    spectra = scipy.fft.fft(windows, axis=1)
    strongest = np.argsort(np.square(np.abs(windows)).sum(axis=1))[::-1][:DECIDING]

    def peaks(rows: IntArray, shift: int) -> tuple[FloatArray, FloatArray, IntArray]:
        turned = waves[rows] * np.exp(2j * np.pi * shift * np.arange(size) / size)
        found = np.abs(scipy.fft.ifft(spectra[rows] * scipy.fft.fft(turned, length, axis=1).conj(), axis=1))
        found = found[:, : length - size + 1]
        lag = found.argmax(axis=1)
        return found.max(axis=1), np.median(found, axis=1), lag

    shifts = range(-most, most + 1)
    whole = shifts[int(np.argmax([np.square(peaks(strongest, shift)[0]).sum() for shift in shifts]))]
    height, background, lag = peaks(np.arange(len(windows)), whole)
    return whole, height / np.maximum(background, np.finfo(float).tiny), lag


def _line(at_s: FloatArray, late_s: FloatArray, height: FloatArray, *, is_steady: bool) -> tuple[float, float]:
    """Slope and offset of arrivals; few of them, or those of a steady clock, have no slope."""
    if is_steady or len(at_s) < LEAST_ARRIVALS or np.ptp(at_s) == 0:
        return 0.0, float(late_s[np.argmax(height)])
    slope = float(theilslopes(late_s, at_s).slope)
    return slope, float(np.median(late_s - slope * at_s))
