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
def cone_azimuth(boresight_rad: float, turn_rad: float, sine: float) -> tuple[float, float]:
    """Azimuth that a panel shows for a sine of the cone angle, and the slope of the sine by it.

    `turn_rad` is the true azimuth over the boresight: it tells front and back of the panel.
    """
    sine = min(max(sine, -STEEPEST_SINE), STEEPEST_SINE)
    opening, across = np.arcsin(sine), np.sqrt(1 - sine**2)
    if np.cos(turn_rad) < 0:  # behind the panel
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
    leg, cosine, azimuth = np.empty(2), np.empty(2), np.empty(2)
    # Derivatives by x, y and heading of the receiver, then by x, y and height of the point.
    by_leg, by_cosine, by_azimuth = np.zeros((2, 6)), np.zeros((2, 6)), np.zeros((2, 6))
    for end in range(2):
        device = tx if end == 0 else state
        up = point[2] - difference_m if end == 0 else point[2]
        east, north = point[0] - device[0], point[1] - device[1]
        plan = max(np.sqrt(east**2 + north**2), MIN_LENGTH_M)
        leg[end] = np.sqrt(plan**2 + up**2)
        cosine[end] = plan / leg[end]
        azimuth[end] = np.arctan2(north, east) - device[2]
        for axis, along, across in ((0, east / plan, -north / plan), (1, north / plan, east / plan)):
            by_leg[end, 3 + axis] = cosine[end] * along
            by_cosine[end, 3 + axis] = up**2 / leg[end] ** 3 * along
            by_azimuth[end, 3 + axis] = across / plan
        by_leg[end, 5], by_cosine[end, 5] = up / leg[end], -plan * up / leg[end] ** 3
    for by_own in (by_leg, by_cosine, by_azimuth):
        by_own[1, :2] = -by_own[1, 3:5]
    by_azimuth[1, 2] = -1.0
    length = leg[0] + leg[1]
    seen = np.sqrt(max(length**2 - difference_m**2, MIN_LENGTH_M**2))
    stretch = length / seen  # one over the cosine of a level path
    slope = np.empty((3, 6))
    slope[0] = stretch * (by_leg[0] + by_leg[1])
    by_stretch = -(difference_m**2) / seen**3 * (by_leg[0] + by_leg[1])
    value[0] = seen + state[3]
    for end in range(2):
        if np.isnan(boresight_rad[end]):
            value[end + 1], slope[end + 1] = wrapped(azimuth[end]), by_azimuth[end]
            continue
        turn = wrapped(azimuth[end] - boresight_rad[end])
        value[end + 1], across = cone_azimuth(boresight_rad[end], turn, np.sin(turn) * cosine[end] * stretch)
        slope[end + 1] = np.cos(turn) * cosine[end] * stretch * by_azimuth[end]
        slope[end + 1] += np.sin(turn) * (by_cosine[end] * stretch + cosine[end] * by_stretch)
        slope[end + 1] /= across
    by_state[:, :3], by_state[:, 3], by_point[:] = slope[:, :3], 0.0, slope[:, 3:]
    by_state[0, 3] = 1.0


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
        value[end + 1], across = cone_azimuth(boresight_rad[end], turn, np.sin(turn) * cosine)
        by_point[end + 1] = (np.cos(turn) * cosine * by_azimuth[end] + np.sin(turn) * by_cosine) / across
