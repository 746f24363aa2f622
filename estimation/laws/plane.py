"""The reflection law in the plane: delay and angles of an incidence point (IP), and what they say of the RX.

All functions work on arrays of paths and broadcast over leading axes. Lengths replace times, so that every
quantity has a similar size: range = c * delay and bias = c * clock bias, both in metres.

- TX: a `scenes.pose.Pose`; only x, y and the heading are used.
- RX state (..., 4): x, y in m, heading in rad, clock bias in m.
- measurement (..., 3): range in m (clock bias included), azimuth of departure in the TX frame and azimuth of
  arrival in the RX frame, both in rad.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle
from scenes.record import FloatArray


def measurements(delay_s: FloatArray, aod_azimuth_rad: FloatArray, aoa_azimuth_rad: FloatArray) -> FloatArray:
    """Measurement vectors (path, 3) in (m, rad, rad) from delays in s and azimuths in rad."""
    return np.stack([SPEED_OF_LIGHT_M_S * delay_s, aod_azimuth_rad, aoa_azimuth_rad], axis=-1)


def range_covariance(covariance: FloatArray) -> FloatArray:
    """Covariance (..., 3, 3) in (m, rad, rad)^2 from one in (s, rad, rad)^2."""
    scale = np.array([SPEED_OF_LIGHT_M_S, 1.0, 1.0])
    return covariance * np.outer(scale, scale)


def predict_bounce(tx: Pose, rx_state: FloatArray, point_m: FloatArray) -> FloatArray:
    """Measurement (..., 3) of the single bounce at each IP (..., 2): g of equation (3)."""
    from_tx, from_rx = point_m - tx.position_m[:2], point_m - rx_state[..., :2]
    return np.stack(
        [
            _norm(from_tx) + _norm(from_rx) + rx_state[..., 3],
            wrap_angle(_azimuth(from_tx) - tx.heading_rad),
            wrap_angle(_azimuth(from_rx) - rx_state[..., 2]),
        ],
        axis=-1,
    )


def bounce_jacobian_point(tx: Pose, rx_state: FloatArray, point_m: FloatArray) -> FloatArray:
    """Derivative (..., 3, 2) of `predict_bounce` with respect to the IP."""
    from_tx, from_rx = point_m - tx.position_m[:2], point_m - rx_state[..., :2]
    unit_tx, turn_tx = _unit_and_turn(from_tx)
    unit_rx, turn_rx = _unit_and_turn(from_rx)
    return np.stack(np.broadcast_arrays(unit_tx + unit_rx, turn_tx, turn_rx), axis=-2)


def bounce_jacobian_rx(tx: Pose, rx_state: FloatArray, point_m: FloatArray) -> FloatArray:
    """Derivative (..., 3, 4) of `predict_bounce` with respect to the RX state."""
    unit_rx, turn_rx = _unit_and_turn(point_m - rx_state[..., :2])
    jacobian = np.zeros((*unit_rx.shape[:-1], 3, 4))
    jacobian[..., 0, :2] = -unit_rx
    jacobian[..., 2, :2] = -turn_rx
    jacobian[..., 2, 2] = -1.0
    jacobian[..., 0, 3] = 1.0
    return jacobian


def predict_los(tx: Pose, rx_state: FloatArray) -> FloatArray:
    """Measurement (..., 3) of the line of sight."""
    from_tx = rx_state[..., :2] - tx.position_m[:2]
    azimuth = _azimuth(from_tx)
    return np.stack(
        [
            _norm(from_tx) + rx_state[..., 3],
            wrap_angle(azimuth - tx.heading_rad),
            wrap_angle(azimuth + np.pi - rx_state[..., 2]),
        ],
        axis=-1,
    )


def los_jacobian_rx(tx: Pose, rx_state: FloatArray) -> FloatArray:
    """Derivative (..., 3, 4) of `predict_los` with respect to the RX state."""
    unit, turn = _unit_and_turn(rx_state[..., :2] - tx.position_m[:2])
    jacobian = np.zeros((*unit.shape[:-1], 3, 4))
    jacobian[..., 0, :2] = unit
    jacobian[..., 1, :2] = turn
    jacobian[..., 2, :2] = turn
    jacobian[..., 2, 2] = -1.0
    jacobian[..., 0, 3] = 1.0
    return jacobian


def residual(measured: FloatArray, predicted: FloatArray) -> FloatArray:
    """Measured minus predicted (..., 3), the angles wrapped to [-pi, pi)."""
    difference = measured - predicted
    difference[..., 1:] = wrap_angle(difference[..., 1:])
    return difference


def ray_directions(
    tx: Pose, heading_rad: FloatArray | float, measured: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Unit vectors (..., 2) in the world frame: u leaves the TX, v leaves the RX towards the IP."""
    departure = tx.heading_rad + measured[..., 1]
    arrival = heading_rad + measured[..., 2]
    return _unit_vector(departure), _unit_vector(arrival)


@dataclass(frozen=True)
class BounceEquation:
    """The scalar equation a single bounce leaves on the RX state once its IP is eliminated.

    Given the heading it is linear in z = [x, y, bias]: `row` (..., 3) times z equals `right_side` (...) in m.
    The row is [-sin s, cos s, -sin delta] with s = (arrival + departure) / 2 and
    delta = (arrival - departure) / 2 in world azimuths: the component across u + v of the vector loop
    p_TX + gamma (range - bias) u = p_RX + (1 - gamma) (range - bias) v.
    """

    row: FloatArray
    right_side: FloatArray
    along: FloatArray  # cos delta = |u + v| / 2

    def residual_m(self, z: FloatArray) -> FloatArray:
        """How far z = [x, y, bias] (..., 3) is from fulfilling the equation, in m."""
        return np.asarray(np.einsum("...i,...i->...", self.row, z) - self.right_side)


def bounce_equation(tx: Pose, heading_rad: FloatArray | float, measured: FloatArray) -> BounceEquation:
    """The equation of each path (..., 3) as a single bounce, for the RX heading(s) given."""
    departure = tx.heading_rad + measured[..., 1]
    arrival = heading_rad + measured[..., 2]
    s, delta = (arrival + departure) / 2, (arrival - departure) / 2
    row = np.stack([-np.sin(s), np.cos(s), -np.sin(delta)], axis=-1)
    x_tx, y_tx = tx.position_m[:2]
    right_side = row[..., 0] * x_tx + row[..., 1] * y_tx + row[..., 2] * measured[..., 0]
    return BounceEquation(row, right_side, np.cos(delta))


def bounce_fraction(
    tx: Pose,
    equation: BounceEquation,
    z: FloatArray,
    range_m: FloatArray,
) -> FloatArray:
    """Share gamma (...) of the path length between TX and IP: 0 to 1 for a physical single bounce.

    NaN where the rays are parallel (u + v = 0) or no length is left after the bias.
    """
    # t = (u + v) / |u + v| completes the row's normal to a right-handed frame.
    x, y = z[..., 0] - tx.position_m[0], z[..., 1] - tx.position_m[1]
    offset = x * equation.row[..., 1] - y * equation.row[..., 0]
    span = 2 * (range_m - z[..., 2]) * equation.along
    parallel = np.abs(span) < 1e-12
    return np.where(parallel, np.nan, 0.5 + offset / np.where(parallel, 1.0, span))


def start_point(tx: Pose, rx_state: FloatArray, measured: FloatArray) -> FloatArray:
    """Midpoint (..., 2) of the points that each ray reaches with its share of the path length.

    For noise-free paths it is the IP. The share is kept inside [0.02, 0.98] (0.5 for parallel rays), so the
    point never falls on a device.
    """
    equation = bounce_equation(tx, rx_state[..., 2], measured)
    z = rx_state[..., [0, 1, 3]]
    share = np.nan_to_num(bounce_fraction(tx, equation, z, measured[..., 0]), nan=0.5)
    share = np.clip(share, 0.02, 0.98)[..., None]
    length = np.maximum(measured[..., 0] - rx_state[..., 3], 0.1)[..., None]
    u, v = ray_directions(tx, rx_state[..., 2], measured)
    return (tx.position_m[:2] + share * length * u + rx_state[..., :2] + (1 - share) * length * v) / 2


def _norm(vector: FloatArray) -> FloatArray:
    return np.hypot(vector[..., 0], vector[..., 1])


def _azimuth(vector: FloatArray) -> FloatArray:
    return np.arctan2(vector[..., 1], vector[..., 0])


def _unit_vector(azimuth_rad: FloatArray) -> FloatArray:
    return np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], axis=-1)


def _unit_and_turn(vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gradients of length and azimuth of a vector (..., 2), the length kept above 1 um."""
    length = np.maximum(_norm(vector), 1e-6)[..., None]
    unit = vector / length
    turned = np.stack([-unit[..., 1], unit[..., 0]], axis=-1)
    return unit, turned / length
