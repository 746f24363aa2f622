"""Paths over upright surfaces, seen from above: plan lengths and true azimuths from heights that are known.

Upright surfaces keep the vertical component of a direction. So a path with the height difference dz between its
ends and the length l has the plan length L = sqrt(l^2 - dz^2), and everywhere the elevation of cosine L / l.
Horizontal beams show the cone angle about the boresight of a panel: sin(cone) = sin(azimuth) L / l.
"""

from typing import NamedTuple

import numpy as np

from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray

LEVEL_SHARE = 1e-3  # shortest plan length as a share of the length: a path straight up has no plan path
CONE_STDS = 3.0  # standard deviations by which a cone may seem too wide
STEEPEST_SINE = 0.9995  # sines beyond are taken as this


class LevelPaths(NamedTuple):
    """Paths seen from above.

    Attributes
    ----------
    value : (..., 3) plan length in m, azimuths of departure and arrival in rad
    slope : (..., 3, 4) over the length in m, both observed azimuths, and the height difference in m
    is_possible : (...) whether the path is long enough for its height difference, and its cones narrow enough
    """

    value: FloatArray
    slope: FloatArray
    is_possible: BoolArray


def plan_paths(
    length_m: FloatArray,
    azimuth_rad: FloatArray,
    boresight_rad: FloatArray,
    is_cone: BoolArray,
    std_rad: FloatArray,
    difference_m: FloatArray,
) -> LevelPaths:
    """Paths seen from above; impossible ones get a plan length of 1 m.

    Parameters
    ----------
    length_m, difference_m
        (...) lengths without clock bias, and height differences: both broadcast.
    azimuth_rad, boresight_rad, std_rad
        (..., 2) at departure and arrival: observed azimuths, boresights of their panels, standard deviations.
    is_cone
        (2,) whether the azimuths observed at an end are cone angles.
    """
    length, difference = np.broadcast_arrays(np.asarray(length_m, float), np.asarray(difference_m, float))
    square = length**2 - difference**2
    is_possible = (length > 0) & (square > (LEVEL_SHARE * length) ** 2)
    plan = np.sqrt(np.where(is_possible, square, 1.0))
    value, slope = np.empty((*length.shape, 3)), np.zeros((*length.shape, 3, 4))
    value[..., 0], slope[..., 0, 0], slope[..., 0, 3] = plan, length / plan, -difference / plan
    for end in range(2):
        axis, turn = end + 1, wrap_angle(azimuth_rad[..., end] - boresight_rad[..., end])
        if not is_cone[end]:
            value[..., axis], slope[..., axis, axis] = azimuth_rad[..., end], 1.0
            continue
        sine = np.sin(turn) * length / plan
        is_possible = is_possible & (np.abs(sine) < 1 + CONE_STDS * std_rad[..., end])
        clipped = np.clip(sine, -STEEPEST_SINE, STEEPEST_SINE)
        across = np.sqrt(1 - clipped**2)
        value[..., axis] = wrap_angle(boresight_rad[..., end] + np.arcsin(clipped))
        slope[..., axis, 0] = -np.sin(turn) * difference**2 / plan**3 / across
        slope[..., axis, axis] = np.cos(turn) * length / plan / across
        slope[..., axis, 3] = np.sin(turn) * length * difference / plan**3 / across
    return LevelPaths(value, slope, is_possible)


def nearest_boresight(azimuth_rad: FloatArray, panel_rad: FloatArray) -> FloatArray:
    """Boresight (path,) of the panel (panel,) nearest to each azimuth (path,)."""
    panels = np.unique(panel_rad)
    return np.asarray(panels[np.abs(wrap_angle(azimuth_rad[:, None] - panels)).argmin(axis=1)])
