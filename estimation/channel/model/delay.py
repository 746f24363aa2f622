"""From samples to delay: descrambled, windowed and transformed, one power profile per beam pair."""

from dataclasses import dataclass

import numpy as np

from scenes.record import FloatArray, Record, array
from sim.observation import BeamSweep

OVERSAMPLING = 2


@dataclass(frozen=True)
class DelayPower(Record):
    """Power of every beam pair over delay, in units of the noise power of its RX beam.

    Subcarriers are summed coherently: for one path it is the SNR after processing. The period is 1 / comb spacing.
    """

    snr: FloatArray = array("tx_beam", "rx_beam", "delay", dtype=np.float32, doc="power over noise power")
    delay_s: FloatArray = array("delay", unit="s", doc="delay of each bin")
    noise_power_mw: FloatArray = array("rx_beam", unit="mW", doc="noise power per delay bin")
    rms_bandwidth_hz: float = array(unit="Hz", doc="root mean square bandwidth of the windowed band")


def hann_window(n: int) -> FloatArray:
    """Hann window (subcarrier,) without the zero end points, scaled to unit mean."""
    window = np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2
    return np.asarray(window / window.mean())


def window_response(offset_bins: FloatArray, n: int) -> FloatArray:
    """Amplitude of the Hann window's delay response at offsets in (not oversampled) delay bins, 1 at zero.

    H(x) = sinc(x) + (sinc(x - 1) + sinc(x + 1)) / 2 up to sign, the transform of a raised cosine; end effects of
    order 1/n are neglected. `n` bounds the response from below by the leakage of a window of n points.
    """
    x = np.abs(offset_bins)
    response = np.abs(np.sinc(x) + 0.5 * (np.sinc(x - 1) + np.sinc(x + 1)))
    return np.asarray(np.maximum(response, 1.0 / n**2))


def delay_power(sweep: BeamSweep) -> DelayPower:
    """Power over delay (tx_beam, rx_beam, delay) from the samples alone.

    The known PRS is divided out. The band is Hann-windowed against delay side lobes and zero-padded to an
    oversampling of 2. The noise level of every RX beam is estimated from the data: the median over all beam pairs
    and delays of an exponential variable is ln 2 times its mean, and paths fill only a small share of the delays.
    """
    from scipy.fft import ifft  # noqa: PLC0415  (slow to import)

    n = sweep.samples.shape[-1]
    spacing = float(sweep.frequency_offset_hz[1] - sweep.frequency_offset_hz[0])
    window = hann_window(n)
    n_fft = OVERSAMPLING * n
    snr = np.empty((sweep.size("tx_beam"), sweep.size("rx_beam"), n_fft), np.float32)
    for beam, (samples, symbols) in enumerate(zip(sweep.samples, sweep.prs_symbol, strict=True)):
        descrambled = samples * (symbols.conj() * (window / n)).astype(np.complex64)
        response = ifft(descrambled, n_fft, axis=-1, norm="forward", overwrite_x=True)
        snr[beam] = response.real**2 + response.imag**2
    noise_power_mw = np.median(snr, axis=(0, 2)).astype(float) / np.log(2)
    snr /= noise_power_mw.astype(np.float32)[:, None]
    return DelayPower(
        snr=snr,
        delay_s=np.arange(n_fft) / (n_fft * spacing),
        noise_power_mw=noise_power_mw,
        rms_bandwidth_hz=_rms_bandwidth_hz(window, spacing),
    )


def match_delay(power: DelayPower, tx_beam: int, rx_beam: int, delay: int) -> tuple[float, float]:
    """Offset in bins of a peak from its delay bin, and its misfit to the window's response.

    The offset is the vertex of a parabola through the log power of three bins, nearly exact for a Hann window.
    The misfit is the mean square difference in amplitude over the main lobe, relative to the peak.
    """
    reach = np.arange(-2 * OVERSAMPLING + 1, 2 * OVERSAMPLING)
    profile = power.snr[tx_beam, rx_beam, (delay + reach) % power.snr.shape[2]].astype(float)
    offset = parabola_peak(np.log(profile), len(reach) // 2)
    model = window_response((reach - offset) / OVERSAMPLING, power.snr.shape[2] // OVERSAMPLING)
    amplitude = np.sqrt(profile)
    scale = (amplitude @ model) / (model @ model)
    misfit = ((amplitude - scale * model) ** 2).sum() / (len(reach) - 2)
    return offset, float(misfit / scale**2)


def parabola_peak(values: FloatArray, index: int) -> float:
    """Offset in samples, within +-1/2, of the vertex of a parabola through a sample and its two neighbours."""
    if not 0 < index < len(values) - 1:
        return 0.0
    left, centre, right = values[index - 1 : index + 2]
    curvature = left - 2 * centre + right
    return float(np.clip(0.5 * (left - right) / curvature, -0.5, 0.5)) if curvature < 0 else 0.0


def _rms_bandwidth_hz(window: FloatArray, spacing_hz: float) -> float:
    frequency = (np.arange(len(window)) - (len(window) - 1) / 2) * spacing_hz
    return float(np.sqrt((window * frequency**2).sum() / window.sum()))
