"""The reflection law in space: delay and angles of an incidence point (IP), and its equations for the RX state.

As `estimation.laws.plane`, but devices have heights and directions have elevations. Arrays are upright: azimuths
turn with the heading, elevations are those of the world. Functions broadcast over leading axes, lengths replace
times.

- TX: a `scenes.pose.Pose`; position and heading are used.
- RX state (..., 5): x, y, z in m, heading in rad, clock bias in m.
- measurement (..., 5): range in m (clock bias included), azimuth of departure in the TX frame and of arrival in
  the RX frame, elevation of departure and of arrival, in rad: the order of a channel estimate's covariance.
"""

from dataclasses import dataclass

import numpy as np

from estimation.laws import plane
from estimation.laws.plane import MIN_LENGTH_M
from scenes.pose import Pose, direction, wrap_angle
from scenes.record import FloatArray

N_STATE = N_MEASURED = 5
_TINY = 1e-12
residual = plane.residual  # azimuths have the same places as in the plane


def predict_bounce(tx: Pose, state: FloatArray, point_m: FloatArray) -> FloatArray:
    """Measurement (..., 5) of the single bounce at each IP (..., 3)."""
    from_tx, from_rx = point_m - tx.position_m, point_m - state[..., :3]
    return _measurement(tx, state, _length(from_tx) + _length(from_rx), from_tx, from_rx)


def bounce_jacobian_point(tx: Pose, state: FloatArray, point_m: FloatArray) -> FloatArray:
    """Derivative (..., 5, 3) of `predict_bounce` by the IP."""
    unit_tx, azimuth_tx, elevation_tx = _gradients(point_m - tx.position_m)
    unit_rx, azimuth_rx, elevation_rx = _gradients(point_m - state[..., :3])
    rows = (unit_tx + unit_rx, azimuth_tx, azimuth_rx, elevation_tx, elevation_rx)
    return np.stack(np.broadcast_arrays(*rows), axis=-2)


def bounce_jacobian_rx(tx: Pose, state: FloatArray, point_m: FloatArray) -> FloatArray:
    """Derivative (..., 5, 5) of `predict_bounce` by the RX state."""
    unit, azimuth, elevation = _gradients(point_m - state[..., :3])
    jacobian = np.zeros((*unit.shape[:-1], N_MEASURED, N_STATE))
    jacobian[..., 0, :3], jacobian[..., 2, :3], jacobian[..., 4, :3] = -unit, -azimuth, -elevation
    jacobian[..., 2, 3], jacobian[..., 0, 4] = -1.0, 1.0
    return jacobian


def predict_los(tx: Pose, state: FloatArray) -> FloatArray:
    """Measurement (..., 5) of the line of sight."""
    from_tx = state[..., :3] - tx.position_m
    return _measurement(tx, state, _length(from_tx), from_tx, -from_tx)


def los_jacobian_rx(tx: Pose, state: FloatArray) -> FloatArray:
    """Derivative (..., 5, 5) of `predict_los` by the RX state."""
    unit, azimuth, elevation = _gradients(state[..., :3] - tx.position_m)
    jacobian = np.zeros((*unit.shape[:-1], N_MEASURED, N_STATE))
    jacobian[..., 0, :3], jacobian[..., 1, :3], jacobian[..., 2, :3] = unit, azimuth, azimuth
    jacobian[..., 3, :3], jacobian[..., 4, :3] = elevation, -elevation
    jacobian[..., 2, 3], jacobian[..., 0, 4] = -1.0, 1.0
    return jacobian


@dataclass(frozen=True)
class BounceEquations:
    """The two equations for the RX state from a single bounce whose IP is eliminated, with exact derivatives.

    With unit rays u from the TX and v from the RX, length L = range - bias and d = p_RX - p_TX, the IP is on
    both rays where m = d + L v = gamma L (u + v). So m has no component along two normals of eta = u + v: the
    horizontal one, z x eta over its length, and the one that completes the frame. Where rays and devices are in
    one horizontal plane, the first is `estimation.laws.plane.BounceEquation` and the second the difference of
    heights.
    """

    value_m: FloatArray  # (..., 2)
    by_measurement: FloatArray  # (..., 2, 5)
    by_state: FloatArray  # (..., 2, 5)
    fraction: FloatArray  # (...) gamma: share of the length between TX and IP
    length_m: FloatArray  # (...) L
    opening: FloatArray  # (...) |u + v|


def bounce_equations(tx: Pose, state: FloatArray, measured: FloatArray) -> BounceEquations:
    """The equations of paths (..., 5) as single bounces at RX states (..., 5)."""
    u, u_azimuth, u_elevation = _ray(tx.heading_rad + measured[..., 1], measured[..., 3])
    v, v_azimuth, v_elevation = _ray(state[..., 3] + measured[..., 2], measured[..., 4])
    u, u_azimuth, u_elevation, v, v_azimuth, v_elevation = np.broadcast_arrays(
        u, u_azimuth, u_elevation, v, v_azimuth, v_elevation
    )
    # For opposite rays eta is zero: a tiny vector along the mean azimuth keeps the normals defined.
    middle = (tx.heading_rad + measured[..., 1] + state[..., 3] + measured[..., 2]) / 2
    mean_ray = np.stack([np.cos(middle), np.sin(middle), np.zeros_like(middle)], axis=-1)
    eta = u + v
    eta = eta + np.where(_dot(eta, mean_ray) < 0, -_TINY, _TINY)[..., None] * mean_ray
    level = np.maximum(np.hypot(eta[..., 0], eta[..., 1]), 1e-12)
    opening = np.maximum(_length(eta), 1e-12)
    first = np.stack([-eta[..., 1], eta[..., 0], np.zeros_like(level)], axis=-1) / level[..., None]
    normal = np.stack([first, np.cross(eta, first) / opening[..., None]], axis=-2)
    length = measured[..., 0] - state[..., 4]
    loop = state[..., :3] - tx.position_m + length[..., None] * v
    value = np.einsum("...ni,...i->...n", normal, loop)
    reach = _dot(eta, loop) / opening**2  # gamma L
    lean = eta[..., 2] / opening / level  # rotation of the normals about eta per step of eta along the first

    def by(step: FloatArray, eta_step: FloatArray) -> FloatArray:
        """Change (..., 2) of the values when the loop changes by `step` and eta by `eta_step`."""
        change = np.einsum("...ni,...i->...n", normal, step - reach[..., None] * eta_step)
        turn = lean * _dot(first, eta_step)
        return np.asarray(change + turn[..., None] * np.stack([value[..., 1], -value[..., 0]], axis=-1))

    none, along = np.zeros_like(v), length[..., None]
    by_measurement = np.stack(
        [
            by(v, none),
            by(none, u_azimuth),
            by(along * v_azimuth, v_azimuth),
            by(none, u_elevation),
            by(along * v_elevation, v_elevation),
        ],
        axis=-1,
    )
    by_state = np.concatenate([normal, by_measurement[..., 2, None], -by_measurement[..., 0, None]], axis=-1)
    return BounceEquations(
        value, by_measurement, by_state, reach / np.where(np.abs(length) < 1e-9, 1e-9, length), length, opening
    )


def start_point(tx: Pose, state: FloatArray, measured: FloatArray) -> FloatArray:
    """Midpoint (..., 3) of the points that each ray reaches with its share of the length; exact without noise.

    The share is limited to [0.02, 0.98] (0.5 for opposite rays), so that the point is never on a device.
    """
    equations = bounce_equations(tx, state, measured)
    share = np.where(equations.opening < 1e-9, 0.5, np.clip(equations.fraction, 0.02, 0.98))[..., None]
    length = np.maximum(equations.length_m, 0.1)[..., None]
    u = direction(tx.heading_rad + measured[..., 1], measured[..., 3])
    v = direction(state[..., 3] + measured[..., 2], measured[..., 4])
    return np.asarray((tx.position_m + share * length * u + state[..., :3] + (1 - share) * length * v) / 2)


def _measurement(
    tx: Pose, state: FloatArray, length_m: FloatArray, from_tx: FloatArray, from_rx: FloatArray
) -> FloatArray:
    parts = (
        length_m + state[..., 4],
        wrap_angle(np.arctan2(from_tx[..., 1], from_tx[..., 0]) - tx.heading_rad),
        wrap_angle(np.arctan2(from_rx[..., 1], from_rx[..., 0]) - state[..., 3]),
        np.arctan2(from_tx[..., 2], np.hypot(from_tx[..., 0], from_tx[..., 1])),
        np.arctan2(from_rx[..., 2], np.hypot(from_rx[..., 0], from_rx[..., 1])),
    )
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def _gradients(vector: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gradients (..., 3) of length, azimuth and elevation of a vector, lengths limited to at least 1 um."""
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    level2 = np.maximum(x**2 + y**2, MIN_LENGTH_M**2)
    length2 = level2 + z**2
    level = np.sqrt(level2)
    unit = vector / np.sqrt(length2)[..., None]
    azimuth = np.stack([-y / level2, x / level2, np.zeros_like(x)], axis=-1)
    elevation = np.stack([-x * z / level, -y * z / level, level], axis=-1) / length2[..., None]
    return unit, azimuth, elevation


def _ray(azimuth_rad: FloatArray, elevation_rad: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit vectors (..., 3) of a direction and their derivatives by azimuth and elevation."""
    ca, sa = np.cos(azimuth_rad), np.sin(azimuth_rad)
    ce, se = np.broadcast_arrays(np.cos(elevation_rad), np.sin(elevation_rad))
    zero = np.zeros(np.broadcast_shapes(ca.shape, ce.shape))
    return (
        np.stack([ce * ca, ce * sa, zero + se], axis=-1),
        np.stack([-ce * sa, ce * ca, zero], axis=-1),
        np.stack([-se * ca, -se * sa, zero + ce], axis=-1),
    )


def _length(vector: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(_dot(vector, vector)))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...i,...i->...", *np.broadcast_arrays(a, b)))
