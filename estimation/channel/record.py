"""The channel estimate: paths of one stop as the receiver knows them."""

from __future__ import annotations

from dataclasses import dataclass

from scenes.record import BoolArray, FloatArray, Record, array


@dataclass(frozen=True)
class ChannelEstimate(Record):
    """Estimated paths of one stop, sorted by delay; zero paths are valid.

    Angles are in the devices' own frames: departure relative to the TX heading, arrival relative to the RX
    heading (the RX heading itself is unknown to the estimator). Delays contain the unknown clock bias.
    """

    stop: int = array(dtype=int, doc="index of the receiver stop")
    delay_s: FloatArray = array("path", unit="s", doc="time of arrival, clock bias included")
    aod_azimuth_rad: FloatArray = array("path", unit="rad", doc="azimuth of departure in the TX frame")
    aoa_azimuth_rad: FloatArray = array("path", unit="rad", doc="azimuth of arrival in the RX frame")
    power_dbm: FloatArray = array("path", unit="dBm", doc="received power in the best beam pair")
    beam_loss_db: FloatArray = array(
        "path",
        unit="dB",
        doc="nominal gain of the best beam pair below the peak of its panels; 0 where unknown",
    )
    snr_db: FloatArray = array(
        "path", unit="dB", doc="SNR in the best beam pair after summing the subcarriers"
    )
    covariance: FloatArray = array(
        "path",
        "parameter",
        "parameter2",
        unit="(s, rad, rad)^2",
        doc="of delay, departure and arrival azimuth",
    )
    is_los: BoolArray = array("path", dtype=bool, doc="the path taken as line of sight: at most one")

    def __len__(self) -> int:
        return self.size("path")
