"""The result of every maximum-likelihood method: the paths of one stop with their covariances."""

from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self

import numpy as np

from estimation.channel.correlation import CorrelatedPaths
from scenes.record import BoolArray, FloatArray, Record, array

FitStatus = Literal["ok", "no_paths", "no_signal"]


@dataclass(frozen=True)
class PathFit(Record):
    """Paths of one stop, sorted by delay; zero paths are valid.

    An end has one angle (azimuth, or the cone angle if its beams do not resolve elevation) or two (azimuth,
    elevation). `status` is 'ok' if paths were found, 'no_paths' if nothing exceeds the
    noise, 'no_signal' if all samples are zero.
    """

    delay_s: FloatArray = array("path", unit="s", doc="time of arrival, clock bias included")
    aod_rad: FloatArray = array("path", "aod_angle", unit="rad", doc="departure in the TX frame")
    aoa_rad: FloatArray = array("path", "aoa_angle", unit="rad", doc="arrival in the RX frame")
    amplitude: FloatArray = array("path", unit="sqrt(mW)", doc="|xi|, at the elements of both ends, per sample")
    phase_rad: FloatArray = array("path", unit="rad", doc="phase of xi, NaN if it is not observed")
    snr_db: FloatArray = array("path", unit="dB", doc="SNR in the best beam pair, subcarriers summed")
    covariance: FloatArray = array(
        "path",
        "parameter",
        "parameter2",
        unit="(s, rad, ...)^2",
        doc="of delay, departure angles, arrival angles and, where estimated, Doppler shift",
    )
    unresolved_probability: FloatArray = array("path", doc="probability that the path stands for several")
    is_weak: BoolArray = array("path", dtype=bool, doc="a sum of weak fields, or not resolved")
    doppler_hz: FloatArray = array(
        "path", "doppler", unit="Hz", doc="one shift or none; exactly zero: no evidence of motion, not estimated"
    )
    seen_s: FloatArray = array(
        "path", unit="s", doc="when its energy arrives, since the middle of the sweep: angles are of that time"
    )
    status: FitStatus = array(dtype=str, doc="ok, no_paths or no_signal")
    correlated: CorrelatedPaths | None = field(default=None, kw_only=True)  # None: the method does not tell

    def __len__(self) -> int:
        return self.size("path")

    def take(self, axis: str, index: Any) -> Self:
        """As `Record.take`."""
        taken = super().take(axis, index)
        if axis != "path" or self.correlated is None:
            return taken
        return replace(taken, correlated=self.correlated.of_paths(len(self), index))


def empty_fit(n_aod_angles: int, n_aoa_angles: int, status: FitStatus) -> PathFit:
    """A fit without paths, for ends with these numbers of angles."""
    n_parameters = 1 + n_aod_angles + n_aoa_angles
    return PathFit(
        delay_s=np.zeros(0),
        aod_rad=np.zeros((0, n_aod_angles)),
        aoa_rad=np.zeros((0, n_aoa_angles)),
        amplitude=np.zeros(0),
        phase_rad=np.zeros(0),
        snr_db=np.zeros(0),
        covariance=np.zeros((0, n_parameters, n_parameters)),
        unresolved_probability=np.zeros(0),
        is_weak=np.zeros(0, bool),
        doppler_hz=np.zeros((0, 0)),
        seen_s=np.zeros(0),
        status=status,
    )
