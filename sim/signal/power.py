"""Powers of the signal and of thermal noise.

Samples are scaled so that |y|^2 is the power received in all occupied subcarriers together: the transmit power
is spread over them evenly, and the noise is that of their summed bandwidth.
"""

BOLTZMANN_J_K = 1.380649e-23
REFERENCE_TEMPERATURE_K = 290.0


def dbm_to_mw(power_dbm: float) -> float:
    """Power in mW."""
    return float(10 ** (power_dbm / 10))


def noise_power_mw(bandwidth_hz: float, noise_figure_db: float) -> float:
    """Thermal noise power k T0 B F in mW of one combined sample; unit-norm beam weights leave it unchanged."""
    return float(BOLTZMANN_J_K * REFERENCE_TEMPERATURE_K * bandwidth_hz * 1e3 * 10 ** (noise_figure_db / 10))
