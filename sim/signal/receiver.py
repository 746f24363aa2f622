"""The receiver: link budget, thermal noise and clock.

Samples are scaled so that |y|^2 is the power received in all occupied subcarriers together: the transmit power
is spread over them evenly, and the noise is that of their summed bandwidth.
"""

from __future__ import annotations

import numpy as np
from scipy.constants import Boltzmann

from scenes.record import ComplexArray, FloatArray
from sim.signal.gaussian import add_circular_gaussian

REFERENCE_TEMPERATURE_K = 290.0


def dbm_to_mw(power_dbm: float) -> float:
    """Power in mW."""
    return float(10 ** (power_dbm / 10))


def noise_power_mw(bandwidth_hz: float, noise_figure_db: float) -> float:
    """Thermal noise power k T0 B F in mW of one combined sample; unit-norm beam weights leave it unchanged."""
    return float(Boltzmann * REFERENCE_TEMPERATURE_K * bandwidth_hz * 1e3 * 10 ** (noise_figure_db / 10))


def add_noise(samples: ComplexArray, power_mw: FloatArray, rng: np.random.Generator) -> ComplexArray:
    """Samples (tx_beam, rx_beam, subcarrier), in place, plus circular Gaussian noise of `power_mw` (rx_beam,).

    Every beam pair is measured in its own OFDM symbol, so the noise is independent between pairs.
    """
    for beam in samples:  # one beam's noise stays in the cache
        add_circular_gaussian(beam, power_mw, rng)
    return samples
