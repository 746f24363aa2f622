"""The beam sweep in a synchronised recording: pilots divided out, symbols and repetitions averaged."""

import numpy as np
from scipy.signal import CZT
from scipy.stats import gamma

from isac_arena.exchange.iq.config import RecordingConfig
from isac_arena.exchange.iq.samples import IqRecording
from isac_arena.exchange.iq.synchronise import Synchronisation, fft_size
from isac_arena.exchange.iq.times import Pilots, SweepTimes, prefix_s
from scenes.record import ComplexArray, FloatArray, IntArray
from sim.signal.power import dbm_to_mw


def cut_channel(
    recording: IqRecording, times: SweepTimes, pilots: Pilots, sync: Synchronisation, rate_hz: float
) -> tuple[ComplexArray, FloatArray]:
    """Samples over pilots (tx_beam, rx_beam, tone) and their noise power (rx_beam,), in units of the recording.

    NaN where no subcarrier between the pilots tells the noise.

    The FFT window starts half a prefix early. It follows the clock: the tones are those of the transmitter, seen
    with the receiver's sampling rate.
    """
    n_repetitions, n_tx, n_rx = times.slot.shape
    size, tones = fft_size(pilots, rate_hz), pilots.all_tones
    early_s = prefix_s(pilots.prs) / 2
    channel = np.zeros((n_tx, n_rx, len(tones)), complex)
    count = np.zeros(len(tones))
    power = np.zeros((n_tx, n_rx, len(pilots.unused_tones)))
    step_s = 1 / (rate_hz * (1 + sync.drift))
    for place, symbol in enumerate(pilots.symbols):
        mine = pilots.tones(symbol)
        seen = np.searchsorted(tones, mine)
        count[seen] += n_repetitions
        transform, beside = (
            _Tones(some, size, pilots.prs.subcarrier_spacing_hz, step_s, sync.cfo_hz)
            for some in (mine, pilots.unused_tones if len(pilots.unused_tones) else mine)
        )
        for repetition in range(n_repetitions):
            for beam in range(n_tx):
                start_s = times.start_s[repetition, beam, :, place]
                begin = np.floor((sync.offset_s + (1 + sync.drift) * (start_s - early_s)) * rate_hz).astype(int)
                late_s = (begin / rate_hz - sync.offset_s) / (1 + sync.drift) - start_s
                windows = recording.windows(begin, size)
                values = transform(windows, late_s, start_s)
                slots = times.slot[repetition, beam]
                sent = np.stack([pilots.of(beam, int(slot), symbol) for slot in slots])
                channel[beam][:, seen] += values * sent.conj()
                if place == 0 and len(pilots.unused_tones):
                    power[beam] += np.square(np.abs(beside(windows, late_s, start_s)))
    channel /= count
    channel *= np.sqrt(len(pilots.tones(pilots.symbols[0])))
    scale = len(pilots.tones(pilots.symbols[0])) / n_repetitions
    noise = np.median(power, axis=(0, 2)) * scale if power.size else np.full(n_rx, np.nan)
    return channel, noise / _median_share(n_repetitions) / count.mean()


class _Tones:
    """The transform of windows (row, sample) to evenly spaced tones, of a receiver with another clock."""

    def __init__(self, tones: IntArray, size: int, spacing_hz: float, step_s: float, cfo_hz: float) -> None:
        comb = int(tones[1] - tones[0])
        turn = 2j * np.pi * spacing_hz * step_s
        self._transform = CZT(size, len(tones), w=np.exp(-turn * comb), a=np.exp(turn * int(tones[0])))
        self._cfo_hz, self._tones_hz = cfo_hz, tones * spacing_hz
        self._steady = np.exp(-2j * np.pi * cfo_hz * step_s * np.arange(size))
        self._size = size

    def __call__(self, windows: ComplexArray, late_s: FloatArray, start_s: FloatArray) -> ComplexArray:
        """Tones (row, tone) of windows that start `late_s` (row,) after `start_s` (row,), the offset removed."""
        values = self._transform(windows * self._steady, axis=1) / self._size
        turn = self._tones_hz * late_s[:, None] + self._cfo_hz * (start_s + late_s)[:, None]
        return np.asarray(values * np.exp(-2j * np.pi * turn))


def _median_share(n: int) -> float:
    """Median of the mean of `n` exponential variables, over their mean."""
    return float(gamma.median(n) / n)


def scaled(
    channel: ComplexArray, noise: FloatArray, sent: ComplexArray, config: RecordingConfig
) -> tuple[ComplexArray, FloatArray]:
    """Samples (tx_beam, rx_beam, tone) in sqrt(mW) with the pilots `sent` (tx_beam, tone), and their noise power.

    Raises `ValueError` where the noise is not known.
    """
    unit_mw = dbm_to_mw(config.full_scale_dbm or 0.0)
    noise_mw = unit_mw * noise
    if config.noise_power_dbm is not None:
        noise_mw = np.full(len(noise), dbm_to_mw(config.noise_power_dbm))
    if not (np.isfinite(noise_mw) & (noise_mw > 0)).all():
        raise ValueError("recording.noise_power_dbm: is needed, no subcarrier between the pilots is unused")
    return (np.sqrt(unit_mw) * channel * sent[:, None, :]).astype(np.complex64), noise_mw
