"""Interference of another TX on the same resource elements, whitened over the RX beams.

The pilots of two TX have no relation. After division by the pilot of the sweep, the other TX is noise in every
delay, of another level in every RX beam. Each RX beam has symbols of its own: the errors of two are independent.
"""

from dataclasses import replace

import numpy as np

from estimation.channel.model.delay import hann_window
from scenes.record import FloatArray
from sim.observation import BeamSweep


def whitened(sweep: BeamSweep) -> BeamSweep:
    """The sweep with the noise power per RX beam that the samples show, at least the nominal one."""
    return replace(sweep, noise_power_mw=np.maximum(sweep.noise_power_mw, shown_noise_mw(sweep)))


def shown_noise_mw(sweep: BeamSweep) -> FloatArray:
    """Noise and interference per sample (rx_beam,) in mW, the mean over the TX beams.

    That of a beam pair is the median power over delay, which few paths do not change; the power of noise is
    exponential, with a median of log 2 of its mean.
    """
    n = sweep.samples.shape[2]
    window = hann_window(n)
    window = window / np.sqrt(np.mean(window**2))
    level = np.zeros(sweep.samples.shape[1])
    for samples, pilot in zip(sweep.samples, sweep.prs_symbol, strict=True):
        taps = np.fft.ifft(samples * (pilot.conj() * window), axis=1)
        level += n * np.median(np.square(np.abs(taps)), axis=1) / np.log(2)
    return np.asarray(level / len(sweep.samples))
