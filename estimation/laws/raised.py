"""The path by way of a point at a height of its own, as it looks to one who takes every path as level.

Points of ceilings, floors and walls scatter at any height. `estimation.laws.level` sees paths from above as over
upright surfaces: for such a point this gives a plan length that is too long, and with horizontal beams azimuths
that are too near the boresight. So do images of upright objects in floor and ceiling. These kernels predict what
is seen, so that the height can be estimated.
"""

from typing import NamedTuple

import numpy as np

from estimation.execution import compiled
from estimation.laws.plane import MIN_LENGTH_M, wrapped
from scenes.record import FloatArray

STEEPEST_SINE = 0.9995  # sines beyond are taken as this
RAISED_STD_M = 3.0  # of the prior of heights over the receiver


class PathHeights(NamedTuple):
    """Where paths begin and end: what the height of a point between needs."""

    difference_m: FloatArray  # (path,) height of the TX above the receiver
    boresight_rad: FloatArray  # (path, 2) as `raised_path` takes them


@compiled
def raised_range(tx: FloatArray, state: FloatArray, point: FloatArray, difference_m: float) -> float:
    """The first value of `raised_path`: range in m, the clock bias with it."""
    plan_tx = max(np.sqrt((point[0] - tx[0]) ** 2 + (point[1] - tx[1]) ** 2), MIN_LENGTH_M)
    plan_rx = max(np.sqrt((point[0] - state[0]) ** 2 + (point[1] - state[1]) ** 2), MIN_LENGTH_M)
    length = np.sqrt(plan_tx**2 + (point[2] - difference_m) ** 2) + np.sqrt(plan_rx**2 + point[2] ** 2)
    return float(np.sqrt(max(length**2 - difference_m**2, MIN_LENGTH_M**2)) + state[3])


@compiled
def cone_azimuth(boresight_rad: float, turn_cosine: float, sine: float) -> tuple[float, float]:
    """Azimuth that a panel shows for a sine of the cone angle, and the slope of the sine by it.

    `turn_cosine` is that of the true azimuth over the boresight: it tells front and back of the panel.
    """
    sine = min(max(sine, -STEEPEST_SINE), STEEPEST_SINE)
    opening, across = np.arcsin(sine), np.sqrt(1 - sine**2)
    if turn_cosine < 0:  # behind the panel
        opening, across = np.pi - opening, -across
    return wrapped(boresight_rad + opening), across


@compiled
def raised_path(
    tx: FloatArray,
    state: FloatArray,
    point: FloatArray,
    difference_m: float,
    boresight_rad: FloatArray,
    value: FloatArray,
    by_state: FloatArray,
    by_point: FloatArray,
) -> None:
    """Measurement (3,) with derivatives (3, 4) and (3, 3), all written, of the path by way of `point` (3,).

    `point` is x, y and the height over the receiver in m. The TX is `difference_m` higher than the receiver.
    `boresight_rad` (2,) are azimuths of the panels at departure and arrival in the frames of the devices, NaN at
    an end whose azimuths are no cone angles. Range and azimuths are those of `estimation.laws.level.plan_paths`.
    """
    # Of either end: direction to the point in the plan, height of the point above it, lengths and azimuth.
    tx_east, tx_north, tx_plan = _plan_leg(tx, point)
    rx_east, rx_north, rx_plan = _plan_leg(state, point)
    tx_up, rx_up = point[2] - difference_m, point[2]
    tx_leg, rx_leg = np.sqrt(tx_plan**2 + tx_up**2), np.sqrt(rx_plan**2 + rx_up**2)
    tx_cosine, rx_cosine = tx_plan / tx_leg, rx_plan / rx_leg
    length = tx_leg + rx_leg
    seen = np.sqrt(max(length**2 - difference_m**2, MIN_LENGTH_M**2))
    stretch = length / seen  # one over the cosine of a level path
    value[0] = seen + state[3]
    tx_azimuth = np.arctan2(point[1] - tx[1], point[0] - tx[0]) - tx[2]
    rx_azimuth = np.arctan2(point[1] - state[1], point[0] - state[0]) - state[2]
    value[1], tx_cos, tx_sin, tx_across = _cone(tx_azimuth, boresight_rad[0], tx_cosine, stretch)
    value[2], rx_cos, rx_sin, rx_across = _cone(rx_azimuth, boresight_rad[1], rx_cosine, stretch)
    for axis in range(6):  # x, y and heading of the receiver, then x, y and height of the point
        at_tx = _end_slopes(False, axis, tx_east / tx_plan, tx_north / tx_plan, tx_up, tx_plan, tx_leg)
        at_rx = _end_slopes(True, axis, rx_east / rx_plan, rx_north / rx_plan, rx_up, rx_plan, rx_leg)
        by_length = at_tx[0] + at_rx[0]
        by_stretch = -(difference_m**2) / seen**3 * by_length
        turn_tx, turn_rx = at_tx[2], at_rx[2]
        if not np.isnan(boresight_rad[0]):
            turn_tx = tx_cos * tx_cosine * stretch * at_tx[2]
            turn_tx = (turn_tx + tx_sin * (at_tx[1] * stretch + tx_cosine * by_stretch)) / tx_across
        if not np.isnan(boresight_rad[1]):
            turn_rx = rx_cos * rx_cosine * stretch * at_rx[2]
            turn_rx = (turn_rx + rx_sin * (at_rx[1] * stretch + rx_cosine * by_stretch)) / rx_across
        if axis < 3:
            by_state[0, axis], by_state[1, axis], by_state[2, axis] = stretch * by_length, turn_tx, turn_rx
        else:
            own = axis - 3
            by_point[0, own], by_point[1, own], by_point[2, own] = stretch * by_length, turn_tx, turn_rx
    by_state[0, 3], by_state[1, 3], by_state[2, 3] = 1.0, 0.0, 0.0


@compiled
def _plan_leg(device: FloatArray, point: FloatArray) -> tuple[float, float, float]:
    """Way east and north from a device to a point, and its length in the plan."""
    east, north = point[0] - device[0], point[1] - device[1]
    return east, north, max(np.sqrt(east**2 + north**2), MIN_LENGTH_M)


@compiled
def _cone(
    azimuth: float, boresight_rad: float, cosine: float, stretch: float
) -> tuple[float, float, float, float]:
    """Azimuth as it is seen; cosine and sine of the turn off the boresight, and the slope of `cone_azimuth`."""
    if np.isnan(boresight_rad):
        return wrapped(azimuth), 1.0, 0.0, 1.0
    turn = wrapped(azimuth - boresight_rad)
    turn_cosine, turn_sine = np.cos(turn), np.sin(turn)
    seen, across = cone_azimuth(boresight_rad, turn_cosine, turn_sine * cosine * stretch)
    return seen, turn_cosine, turn_sine, across


@compiled
def _end_slopes(
    is_rx: bool, axis: int, east: float, north: float, up: float, plan: float, leg: float
) -> tuple[float, float, float]:
    """Derivatives of the leg of an end, of its cosine and of its azimuth by one of the six axes of `raised_path`.

    `east` and `north` are the unit vector from the end to the point in the plan.
    """
    if axis == 2:
        return 0.0, 0.0, -1.0 if is_rx else 0.0
    if axis == 5:
        return up / leg, -plan * up / leg**3, 0.0
    if axis < 2 and not is_rx:
        return 0.0, 0.0, 0.0
    sign = -1.0 if axis < 2 else 1.0  # the receiver moves against the point
    along, across = (east, -north) if axis in (0, 3) else (north, east)
    return sign * (plan / leg * along), sign * (up**2 / leg**3 * along), sign * (across / plan)


@compiled
def image_path(
    tx: FloatArray,
    state: FloatArray,
    point: FloatArray,
    boresight_rad: FloatArray,
    value: FloatArray,
    by_point: FloatArray,
) -> None:
    """Measurement (3,) with derivative (3, 3), both written, of the path by an upright edge and floor or ceiling.

    `point` (3,) is x and y in m, and v^2 - d^2 in m^2: v is the way up and down, d the height difference of the
    devices. At 0 the path is level. The rest is as for `raised_path`.
    """
    azimuth, by_azimuth, by_plan, plan = np.empty(2), np.zeros((2, 3)), np.zeros(3), 0.0
    for end in range(2):
        device = tx if end == 0 else state
        east, north = point[0] - device[0], point[1] - device[1]
        leg = max(np.sqrt(east**2 + north**2), MIN_LENGTH_M)
        plan += leg
        azimuth[end] = np.arctan2(north, east) - device[2]
        by_plan[0] += east / leg
        by_plan[1] += north / leg
        by_azimuth[end, 0], by_azimuth[end, 1] = -north / leg**2, east / leg**2
    seen = np.sqrt(max(plan**2 + point[2], MIN_LENGTH_M**2))
    cosine = plan / seen
    by_seen = cosine * by_plan
    by_seen[2] = 0.5 / seen
    by_cosine = (by_plan - cosine * by_seen) / seen
    value[0], by_point[0] = seen + state[3], by_seen
    for end in range(2):
        if np.isnan(boresight_rad[end]):
            value[end + 1], by_point[end + 1] = wrapped(azimuth[end]), by_azimuth[end]
            continue
        turn = wrapped(azimuth[end] - boresight_rad[end])
        value[end + 1], across = cone_azimuth(boresight_rad[end], np.cos(turn), np.sin(turn) * cosine)
        by_point[end + 1] = (np.cos(turn) * cosine * by_azimuth[end] + np.sin(turn) * by_cosine) / across
