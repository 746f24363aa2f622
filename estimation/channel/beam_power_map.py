"""The beam power map: the received power of every beam pair at one stop."""

from dataclasses import dataclass

import numpy as np

from scenes.record import FloatArray, Record, array
from sim.observation import BeamSweep


@dataclass(frozen=True)
class BeamPowerMap(Record):
    """Beam reference signal received power (BRSRP) of one stop."""

    stop: int = array(dtype=int, doc="index of the receiver stop")
    tx_azimuth_rad: FloatArray = array("tx_beam", unit="rad", doc="pointing azimuth of TX beams, TX frame")
    rx_azimuth_rad: FloatArray = array("rx_beam", unit="rad", doc="pointing azimuth of RX beams, RX frame")
    power_dbm: FloatArray = array("tx_beam", "rx_beam", unit="dBm", doc="mean power over the subcarriers")


def summed_power(sweep: BeamSweep) -> FloatArray:
    """Power in mW (tx_beam, rx_beam) of every beam pair, summed over the subcarriers."""
    samples = sweep.samples
    power = np.einsum("mnk,mnk->mn", samples.real, samples.real, dtype=np.float64)
    power += np.einsum("mnk,mnk->mn", samples.imag, samples.imag, dtype=np.float64)
    return np.asarray(power)


def beam_power_map(sweep: BeamSweep) -> BeamPowerMap:
    """Mean of |y|^2 over the subcarriers, per beam pair."""
    return BeamPowerMap(
        stop=sweep.stop,
        tx_azimuth_rad=sweep.tx_codebook.azimuth_rad,
        rx_azimuth_rad=sweep.rx_codebook.azimuth_rad,
        power_dbm=10 * np.log10(summed_power(sweep) / sweep.samples.shape[-1]),
    )
