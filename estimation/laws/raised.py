"""The path by way of a point at a height of its own, as it looks to one who takes every path as level.

Points of ceilings, floors and walls scatter at any height. `estimation.laws.level` sees paths from above as over
upright surfaces: for such a point this gives a plan length that is too long, and with horizontal beams azimuths
that are too near the boresight. This kernel predicts what is seen, so that the height can be estimated.
"""

import numpy as np

from estimation.execution import compiled
from estimation.laws.plane import MIN_LENGTH_M, wrapped
from scenes.record import FloatArray

STEEPEST_SINE = 0.9995  # sines beyond are taken as this


@compiled
def raised_range(tx: FloatArray, state: FloatArray, point: FloatArray, difference_m: float) -> float:
    """The first value of `raised_path`: range in m, the clock bias with it."""
    plan_tx = max(np.sqrt((point[0] - tx[0]) ** 2 + (point[1] - tx[1]) ** 2), MIN_LENGTH_M)
    plan_rx = max(np.sqrt((point[0] - state[0]) ** 2 + (point[1] - state[1]) ** 2), MIN_LENGTH_M)
    length = np.sqrt(plan_tx**2 + (point[2] - difference_m) ** 2) + np.sqrt(plan_rx**2 + point[2] ** 2)
    return float(np.sqrt(max(length**2 - difference_m**2, MIN_LENGTH_M**2)) + state[3])


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
        flat = np.sin(turn) * cosine[end] * stretch
        sine = min(max(flat, -STEEPEST_SINE), STEEPEST_SINE)
        opening = np.arcsin(sine)
        across = np.sqrt(1 - sine**2)
        if np.cos(turn) < 0:  # behind the panel
            opening, across = np.pi - opening, -across
        value[end + 1] = wrapped(boresight_rad[end] + opening)
        slope[end + 1] = np.cos(turn) * cosine[end] * stretch * by_azimuth[end]
        slope[end + 1] += np.sin(turn) * (by_cosine[end] * stretch + cosine[end] * by_stretch)
        slope[end + 1] /= across
    by_state[:, :3], by_state[:, 3], by_point[:] = slope[:, :3], 0.0, slope[:, 3:]
    by_state[0, 3] = 1.0
