"""The channel estimate: paths of one stop as the receiver knows them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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


def check_estimate(estimate: ChannelEstimate, period_s: float) -> None:
    """Refuse an estimate that breaks the promises of the record.

    `period_s` is the delay after which a comb of subcarriers repeats; no delay can be told beyond it.

    Raises
    ------
    ValueError
        Where a value is not finite, a delay lies beyond +-`period_s` (ns for s), paths are not sorted by delay, a
        covariance is not symmetric and positive definite, or several paths are called line of sight; the message
        names stop, field and value.
    """
    where = f"stop {estimate.stop}: "
    for name in ("delay_s", "aod_azimuth_rad", "aoa_azimuth_rad", "power_dbm", "covariance"):
        value = getattr(estimate, name)
        if not np.isfinite(value).all():
            raise ValueError(f"{where}{name} = {value[~np.isfinite(value)][0]}: must be finite")
    late = np.abs(estimate.delay_s) > period_s
    if late.any():
        raise ValueError(f"{where}delay_s = {estimate.delay_s[late][0]:g}: must be within +-{period_s:.3g} s")
    if (np.diff(estimate.delay_s) < 0).any():
        raise ValueError(f"{where}delay_s is not sorted: paths must come in order of delay")
    symmetric = np.allclose(estimate.covariance, np.swapaxes(estimate.covariance, 1, 2))
    # Delays in ns and angles in rad have comparable sizes, so that the eigenvalues can be judged.
    scale = np.array([1e9, 1.0, 1.0])
    if not symmetric or (np.linalg.eigvalsh(estimate.covariance * scale[:, None] * scale) <= 0).any():
        raise ValueError(f"{where}covariance: every matrix must be symmetric and positive definite")
    if estimate.is_los.sum() > 1:
        raise ValueError(
            f"{where}is_los = {int(estimate.is_los.sum())} paths: at most one can be line of sight"
        )
