"""The reflection law in the plane: delay and angles of an incidence point (IP), and its equation for the RX state.

A compiled kernel computes one path and writes into given arrays, so that a loop over paths allocates nothing. The
functions for arrays call these kernels and broadcast over leading axes. Lengths replace times, so that all
quantities have similar sizes: range = c * delay and bias = c * clock bias, both in metres.

- TX: a `scenes.pose.Pose`, of which x, y and the heading count, or rows (..., 3) of x, y in m and heading in rad.
- RX state (..., 4): x, y in m, heading in rad, clock bias in m. A state that several TX share has a clock bias for
  each; `state_columns` are those that the paths of a TX depend on.
- measurement (..., 3): range in m (clock bias included), azimuth of departure in the TX frame and azimuth of
  arrival in the RX frame, both in rad.
"""

from dataclasses import dataclass

import numpy as np

from estimation.execution import compiled, over_rows
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle
from scenes.record import FloatArray, IntArray

MIN_LENGTH_M = 1e-6  # lower limit of lengths in denominators
FEASIBLE_STDS = 2.0  # of the angles, by which an IP may be outside the devices' rays


@dataclass(frozen=True)
class Prediction:
    """A predicted measurement and its derivatives."""

    value: FloatArray  # (..., 3) in m, rad, rad; angles in [-pi, pi)
    by_state: FloatArray  # (..., 3, 4)
    by_landmark: FloatArray  # (..., 3, parameter), by the reflector: an IP, walls or a circle


def measurement_vectors(
    delay_s: FloatArray, aod_azimuth_rad: FloatArray, aoa_azimuth_rad: FloatArray
) -> FloatArray:
    """Measurement vectors (path, 3) in (m, rad, rad) from delays in s and azimuths in rad."""
    return np.stack([SPEED_OF_LIGHT_M_S * delay_s, aod_azimuth_rad, aoa_azimuth_rad], axis=-1)


def range_covariance(covariance: FloatArray) -> FloatArray:
    """Covariance (..., 3, 3) in (m, rad, rad)^2 from one in (s, rad, rad)^2."""
    scale = np.array([SPEED_OF_LIGHT_M_S, 1.0, 1.0])
    return covariance * np.outer(scale, scale)


def tx_row(tx: Pose | FloatArray) -> FloatArray:
    """[x, y, heading] (..., 3) of the TX, as the kernels take it."""
    return np.array([*tx.position_m[:2], tx.heading_rad], float) if isinstance(tx, Pose) else tx


def state_columns(tx: IntArray) -> IntArray:
    """Columns (..., 4) of a state that the paths of TX (...) depend on: x, y, heading and their clock bias."""
    return np.concatenate([np.broadcast_to(np.arange(3), (*tx.shape, 3)), 3 + tx[..., None]], axis=-1)


def bounce(tx: Pose | FloatArray, rx_state: FloatArray, point_m: FloatArray) -> Prediction:
    """Single bounce at each IP (..., 2), g of equation (3) of the paper, with derivatives by state and IP."""
    return Prediction(*over_rows(_bounces, (tx_row(tx), 1), (rx_state, 1), (point_m, 1)))


def predict_bounce(tx: Pose | FloatArray, rx_state: FloatArray, point_m: FloatArray) -> FloatArray:
    """Measurement (..., 3) of the single bounce at each IP (..., 2)."""
    return bounce(tx, rx_state, point_m).value


def bounce_jacobian_point(tx: Pose | FloatArray, rx_state: FloatArray, point_m: FloatArray) -> FloatArray:
    """Derivative (..., 3, 2) of `predict_bounce` with respect to the IP."""
    return bounce(tx, rx_state, point_m).by_landmark


def bounce_jacobian_rx(tx: Pose | FloatArray, rx_state: FloatArray, point_m: FloatArray) -> FloatArray:
    """Derivative (..., 3, 4) of `predict_bounce` with respect to the RX state."""
    return bounce(tx, rx_state, point_m).by_state


def predict_los(tx: Pose | FloatArray, rx_state: FloatArray) -> FloatArray:
    """Measurement (..., 3) of the line of sight."""
    return over_rows(_los_paths, (tx_row(tx), 1), (rx_state, 1))[0]


def los_jacobian_rx(tx: Pose | FloatArray, rx_state: FloatArray) -> FloatArray:
    """Derivative (..., 3, 4) of `predict_los` with respect to the RX state."""
    return over_rows(_los_paths, (tx_row(tx), 1), (rx_state, 1))[1]


def residual(measured: FloatArray, predicted: FloatArray) -> FloatArray:
    """Measured minus predicted, the azimuths wrapped to [-pi, pi).

    Measurements are (..., 3), or (..., 5) with the elevations of `estimation.laws.space`.
    """
    difference = measured - predicted
    difference[..., 1:3] = wrap_angle(difference[..., 1:3])
    return np.asarray(difference)


def ray_directions(
    tx: Pose | FloatArray, heading_rad: FloatArray | float, measured: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Unit vectors (..., 2) in the world frame: u leaves the TX, v leaves the RX towards the IP."""
    departure = tx_row(tx)[..., 2] + measured[..., 1]
    arrival = heading_rad + measured[..., 2]
    return _unit_vector(departure), _unit_vector(arrival)


@dataclass(frozen=True)
class BounceEquation:
    """The scalar equation for the RX state from a single bounce whose IP is eliminated.

    At a given heading it is linear in z = [x, y, bias]: `row` (..., 3) times z equals `right_side` (...) in m.
    The row is [-sin s, cos s, -sin delta] with s = (arrival + departure) / 2 and
    delta = (arrival - departure) / 2 in world azimuths: the component across u + v of the vector loop
    p_TX + gamma (range - bias) u = p_RX + (1 - gamma) (range - bias) v.
    """

    row: FloatArray
    right_side: FloatArray
    along: FloatArray  # cos delta = |u + v| / 2

    def residual_m(self, z: FloatArray) -> FloatArray:
        """Residual (...) of the equation at z = [x, y, bias] (..., 3), in m."""
        return np.asarray(np.einsum("...i,...i->...", self.row, z) - self.right_side)


def bounce_equation(
    tx: Pose | FloatArray, heading_rad: FloatArray | float, measured: FloatArray
) -> BounceEquation:
    """The equation of each path (..., 3) as a single bounce, at given RX headings."""
    source = tx_row(tx)
    departure = source[..., 2] + measured[..., 1]
    arrival = heading_rad + measured[..., 2]
    s, delta = (arrival + departure) / 2, (arrival - departure) / 2
    row = np.stack([-np.sin(s), np.cos(s), -np.sin(delta)], axis=-1)
    right_side = row[..., 0] * source[..., 0] + row[..., 1] * source[..., 1] + row[..., 2] * measured[..., 0]
    return BounceEquation(row, right_side, np.cos(delta))


def bounce_fraction(
    tx: Pose | FloatArray, equation: BounceEquation, z: FloatArray, range_m: FloatArray
) -> FloatArray:
    """Share gamma (...) of the path length between TX and IP: 0 to 1 for a physical single bounce.

    NaN where the rays are parallel (u + v = 0) or the length without the bias is zero.
    """
    # t = (u + v) / |u + v| completes the row's normal to a right-handed frame.
    source = tx_row(tx)
    x, y = z[..., 0] - source[..., 0], z[..., 1] - source[..., 1]
    offset = x * equation.row[..., 1] - y * equation.row[..., 0]
    span = 2 * (range_m - z[..., 2]) * equation.along
    parallel = np.abs(span) < 1e-12
    return np.where(parallel, np.nan, 0.5 + offset / np.where(parallel, 1.0, span))


def start_point(tx: Pose | FloatArray, rx_state: FloatArray, measured: FloatArray) -> FloatArray:
    """Midpoint (..., 2) of the points that each ray reaches with its share of the path length.

    For noise-free paths it is the IP. The share is limited to [0.02, 0.98] (0.5 for parallel rays), so that the
    point is never on a device.
    """
    source = tx_row(tx)
    equation = bounce_equation(source, rx_state[..., 2], measured)
    z = rx_state[..., [0, 1, 3]]
    share = np.nan_to_num(bounce_fraction(source, equation, z, measured[..., 0]), nan=0.5)
    share = np.clip(share, 0.02, 0.98)[..., None]
    length = np.maximum(measured[..., 0] - rx_state[..., 3], 0.1)[..., None]
    u, v = ray_directions(source, rx_state[..., 2], measured)
    return (source[..., :2] + share * length * u + rx_state[..., :2] + (1 - share) * length * v) / 2


def bounce_gap(
    tx: Pose | FloatArray, rx_state: FloatArray, measured: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Residual of `BounceEquation` in m with its derivatives, and the position of the IP between the rays.

    Returns
    -------
    value_m, by_state, by_measurement, place_m
        (...), (..., 4), (..., 3) and (..., 2): the displacement from TX to RX along u + v, and the length times
        cos delta. The IP is between the devices' rays where the first is smaller than the second.
    """
    value, by_state, by_measurement, place = over_rows(_bounce_gaps, (tx_row(tx), 1), (rx_state, 1), (measured, 1))
    return value, by_state, by_measurement, place


def lit_normals(point_m: FloatArray, tx: Pose | FloatArray, rx_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Azimuth (...) of the outward normal of a surface that reflects at points (..., 2).

    The normal bisects the rays to TX and RX. Also its derivative (..., 2) by the point, in rad / m.
    """
    azimuth, slope = over_rows(_lit_normals, (point_m, 1), (tx_row(tx)[..., :2], 1), (rx_m, 1))
    return azimuth, slope


@compiled
def wrapped(angle: float) -> float:
    """An angle wrapped to [-pi, pi)."""
    from_back = angle + np.pi
    if not 0.0 <= from_back < 2 * np.pi:  # most angles need no division
        from_back %= 2 * np.pi
    return from_back - np.pi


@compiled
def unit(x: float, y: float) -> tuple[float, float, float]:
    """Unit vector along (x, y), and the length, at least `MIN_LENGTH_M`."""
    length = max(np.sqrt(x * x + y * y), MIN_LENGTH_M)
    return x / length, y / length, length


@compiled
def bisector(x: float, y: float, t: FloatArray, r: FloatArray) -> float:
    """Azimuth of the bisector of the directions from (x, y) to TX t and RX r."""
    ax, ay, _ = unit(t[0] - x, t[1] - y)
    bx, by, _ = unit(r[0] - x, r[1] - y)
    return float(np.arctan2(ay + by, ax + bx))


@compiled
def los_path(tx: FloatArray, state: FloatArray, value: FloatArray, by_state: FloatArray) -> None:
    """Measurement (3,) of the line of sight and its derivative (3, 4); azimuths are not wrapped."""
    ux, uy, length = unit(state[0] - tx[0], state[1] - tx[1])
    azimuth = np.arctan2(state[1] - tx[1], state[0] - tx[0])
    value[0] = length + state[3]
    value[1] = azimuth - tx[2]
    value[2] = azimuth + np.pi - state[2]
    by_state[:] = 0.0
    by_state[0, 0], by_state[0, 1], by_state[0, 3] = ux, uy, 1.0
    for a in (1, 2):
        by_state[a, 0], by_state[a, 1] = -uy / length, ux / length
    by_state[2, 2] = -1.0


@compiled
def mirror_departure(offset: float, value: FloatArray, by_state: FloatArray) -> float:
    """Departure that a flat array reports from behind it: mirrored at its plane, in place; the sign of the slopes.

    `offset` is that of the heading of the TX, whose measured departures it is added to.
    """
    if np.cos(value[1] - offset) >= 0:
        return 1.0
    value[1] = np.pi - value[1] + 2 * offset
    by_state[1] *= -1.0
    return -1.0


@compiled
def bounce_path(
    tx: FloatArray,
    state: FloatArray,
    point: FloatArray,
    value: FloatArray,
    by_state: FloatArray,
    by_point: FloatArray,
) -> None:
    """Single bounce at an IP (2,): measurement (3,), derivatives (3, 4) and (3, 2); azimuths are not wrapped."""
    ux, uy, from_tx = unit(point[0] - tx[0], point[1] - tx[1])
    vx, vy, from_rx = unit(point[0] - state[0], point[1] - state[1])
    value[0] = from_tx + from_rx + state[3]
    value[1] = np.arctan2(uy, ux) - tx[2]
    value[2] = np.arctan2(vy, vx) - state[2]
    by_point[0, 0], by_point[0, 1] = ux + vx, uy + vy
    by_point[1, 0], by_point[1, 1] = -uy / from_tx, ux / from_tx
    by_point[2, 0], by_point[2, 1] = -vy / from_rx, vx / from_rx
    by_state[:] = 0.0
    by_state[0, 0], by_state[0, 1], by_state[0, 3] = -vx, -vy, 1.0
    by_state[2, 0], by_state[2, 1], by_state[2, 2] = vy / from_rx, -vx / from_rx, -1.0


@compiled
def bounce_gap_path(
    tx: FloatArray, state: FloatArray, measured: FloatArray, by_state: FloatArray, by_measurement: FloatArray
) -> tuple[float, float, float]:
    """`bounce_gap` of one path: value and place in m are returned, derivatives (4,) and (3,) written."""
    departure, arrival = tx[2] + measured[1], state[2] + measured[2]
    s, delta = (arrival + departure) / 2, (arrival - departure) / 2
    a, b, c = -np.sin(s), np.cos(s), -np.sin(delta)
    dx, dy, length = state[0] - tx[0], state[1] - tx[1], measured[0] - state[3]
    along, reach = dx * b - dy * a, length * np.cos(delta)
    by_measurement[0], by_measurement[1], by_measurement[2] = -c, -(along + reach) / 2, -(along - reach) / 2
    by_state[0], by_state[1], by_state[2], by_state[3] = a, b, by_measurement[2], c
    return a * dx + b * dy - c * length, along, reach


@compiled
def _bounces(tx: FloatArray, state: FloatArray, point: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    n = len(state)
    value, by_state, by_point = np.empty((n, 3)), np.empty((n, 3, 4)), np.empty((n, 3, 2))
    for i in range(n):
        bounce_path(tx[i], state[i], point[i], value[i], by_state[i], by_point[i])
        value[i, 1], value[i, 2] = wrapped(value[i, 1]), wrapped(value[i, 2])
    return value, by_state, by_point


@compiled
def _los_paths(tx: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    value, by_state = np.empty((len(state), 3)), np.empty((len(state), 3, 4))
    for i in range(len(state)):
        los_path(tx[i], state[i], value[i], by_state[i])
        value[i, 1], value[i, 2] = wrapped(value[i, 1]), wrapped(value[i, 2])
    return value, by_state


@compiled
def _bounce_gaps(
    tx: FloatArray, state: FloatArray, measured: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    n = len(state)
    value, place, by_state, by_measured = np.empty(n), np.empty((n, 2)), np.empty((n, 4)), np.empty((n, 3))
    for i in range(n):
        value[i], place[i, 0], place[i, 1] = bounce_gap_path(
            tx[i], state[i], measured[i], by_state[i], by_measured[i]
        )
    return value, by_state, by_measured, place


@compiled
def _lit_normals(point: FloatArray, t: FloatArray, r: FloatArray) -> tuple[FloatArray, FloatArray]:
    azimuth, slope = np.empty(len(point)), np.empty((len(point), 2))
    for i in range(len(point)):
        ax, ay, at = unit(t[i, 0] - point[i, 0], t[i, 1] - point[i, 1])
        bx, by, br = unit(r[i, 0] - point[i, 0], r[i, 1] - point[i, 1])
        azimuth[i] = bisector(point[i, 0], point[i, 1], t[i], r[i])
        slope[i, 0], slope[i, 1] = (ay / at + by / br) / 2, -(ax / at + bx / br) / 2
    return azimuth, slope


def _unit_vector(azimuth_rad: FloatArray) -> FloatArray:
    return np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], axis=-1)
