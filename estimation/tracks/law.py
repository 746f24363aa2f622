"""What a direct echo measures of a mover: TX - mover - RX.

State of a mover: x, x', y, y', z in m and m/s; it moves in the plan. Measurement: length of the path in m without
clock bias, azimuth of departure in the TX frame, of arrival in the RX frame, and the rate of the length in m/s,
which is minus the wavelength times the Doppler shift. Horizontal beams see cone angles: sin(cone) = sin(azimuth)
cos(elevation) about the boresight of a panel. Lengths and rates are of the middle of the sweep, angles of the time
when the beams saw the echo.
"""

from dataclasses import dataclass

import numpy as np

from scenes.pose import wrap_angle
from scenes.record import FloatArray

N_STATE, N_MEASURED = 5, 4
POSITION, VELOCITY, HEIGHT = [0, 2], [1, 3], 4
NEAREST_M = 1e-3


@dataclass(frozen=True)
class EchoGeometry:
    """The ends of one echo, in the world frame; a boresight (device frame) that is NaN sees azimuths."""

    tx_m: FloatArray  # (xyz,)
    tx_heading_rad: float
    rx_m: FloatArray  # (xyz,) in the middle of the sweep
    rx_heading_rad: float
    rx_velocity_m_s: FloatArray  # (xyz,)
    boresight_rad: FloatArray  # (2,) of TX, RX
    seen_s: float


def echo_of(geometry: EchoGeometry, state: FloatArray) -> FloatArray:
    """Measurements (4, ...) of movers (5, ...)."""
    x, rate_x, y, rate_y, z = np.asarray(state, float)
    point, velocity = np.stack([x, y, z]), np.stack([rate_x, rate_y, 0 * z])
    own = geometry.rx_velocity_m_s.reshape(3, *([1] * (point.ndim - 1)))
    tx, rx = (end.reshape(own.shape) for end in (geometry.tx_m, geometry.rx_m))
    length_tx, length_rx = _length(point - tx), _length(point - rx)
    rate = (velocity * (point - tx)).sum(0) / length_tx + ((velocity - own) * (point - rx)).sum(0) / length_rx
    seen, rx_seen = point + geometry.seen_s * velocity, rx + geometry.seen_s * own
    aod = _angle(seen - tx, geometry.tx_heading_rad, geometry.boresight_rad[0])
    aoa = _angle(seen - rx_seen, geometry.rx_heading_rad, geometry.boresight_rad[1])
    return np.stack([length_tx + length_rx, aod, aoa, rate])


def residual(measured: FloatArray, predicted: FloatArray) -> FloatArray:
    """Measured minus predicted (4, ...), angles wrapped."""
    difference = np.asarray(measured - predicted, float)
    difference[1:3] = wrap_angle(difference[1:3])
    return difference


def _angle(ray: FloatArray, heading_rad: float, boresight_rad: float) -> FloatArray:
    azimuth = np.arctan2(ray[1], ray[0]) - heading_rad
    if np.isnan(boresight_rad):
        return np.asarray(wrap_angle(azimuth))
    sine = np.sin(azimuth - boresight_rad) * np.hypot(ray[0], ray[1]) / _length(ray)
    return np.asarray(wrap_angle(boresight_rad + np.arcsin(sine)))


def _length(ray: FloatArray) -> FloatArray:
    return np.asarray(np.maximum(np.sqrt((ray**2).sum(axis=0)), NEAREST_M))
