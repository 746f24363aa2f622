"""Poses and angles: the position of a device and the heading of its array frame."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from scenes.record import FloatArray, Record, array

LARGEST_LENGTH_M = 1e6  # of any input: the square of a larger one loses the centimetres
SPEED_OF_LIGHT_M_S = 299_792_458.0


@dataclass(frozen=True)
class Pose(Record):
    """Position and heading of a device in the world frame (right-handed, z up)."""

    position_m: FloatArray = array("xyz", unit="m", doc="position in the world frame")
    heading_rad: float = array(unit="rad", doc="azimuth of the device's x axis, from world +x counter-clockwise")


def wrap_angle(angle_rad: Any) -> Any:
    """Angle(s) wrapped to [-pi, pi)."""
    return (np.asarray(angle_rad) + np.pi) % (2 * np.pi) - np.pi


def within_poles(angles_rad: FloatArray) -> FloatArray:
    """The same directions (direction, 1 or 2) of azimuth, and of elevation if given, without any over a pole."""
    if angles_rad.shape[1] == 1:
        return angles_rad
    azimuth, elevation = angles_rad.T
    turned = wrap_angle(elevation)
    is_over = np.abs(turned) > np.pi / 2
    folded = np.where(is_over, np.copysign(np.pi, turned) - turned, elevation)
    return np.stack([np.where(is_over, azimuth + np.pi, azimuth), folded], axis=1)


def direction(azimuth_rad: Any, elevation_rad: Any = 0.0) -> FloatArray:
    """Unit vector(s) (..., xyz) of azimuth (from +x counter-clockwise) and elevation (from horizontal)."""
    azimuth, elevation = np.broadcast_arrays(np.asarray(azimuth_rad, float), np.asarray(elevation_rad, float))
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)


def azimuth_elevation(vector: Any) -> tuple[FloatArray, FloatArray]:
    """Azimuth and elevation in rad of vector(s) (..., xyz); the inverse of `direction`."""
    v = np.asarray(vector, float)
    return np.arctan2(v[..., 1], v[..., 0]), np.arctan2(v[..., 2], np.hypot(v[..., 0], v[..., 1]))
