"""Antenna arrays: element positions, element patterns and steering vectors.

Arrays lie in the y-z plane of their panel frame and look along +x. A plane wave to or from direction u has
phase exp(+j k r.u) at an element at r, relative to the array centre, which is the phase reference.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S, direction
from scenes.record import ComplexArray, FloatArray

ElementPattern = Literal["tr38901", "isotropic"]


def upa_positions_m(
    rows: int, columns: int, carrier_hz: float, spacing_wavelengths: float = 0.5
) -> FloatArray:
    """Element positions (element, xyz) in m of a uniform planar array centred on the origin, looking along +x."""
    if rows < 1 or columns < 1:
        raise ValueError(f"rows, columns = {rows}, {columns}: a planar array has at least 1 row and 1 column")
    spacing = spacing_wavelengths * SPEED_OF_LIGHT_M_S / carrier_hz
    y = (np.arange(columns) - (columns - 1) / 2) * spacing
    z = (np.arange(rows) - (rows - 1) / 2) * spacing
    grid_z, grid_y = np.meshgrid(z, y, indexing="ij")
    return np.stack([np.zeros(rows * columns), grid_y.ravel(), grid_z.ravel()], axis=1)


def element_amplitude(pattern: str, azimuth_rad: Any, elevation_rad: Any) -> FloatArray:
    """Amplitude gain of one element towards directions in the panel frame.

    'isotropic' is 1 everywhere. 'tr38901' is TR 38.901 Table 7.3-1: 8 dBi, 65 deg half-power beam width in
    both planes, 30 dB side-lobe limit and front-to-back ratio.

    Raises `ValueError` for another pattern name.
    """
    azimuth, elevation = np.broadcast_arrays(np.asarray(azimuth_rad, float), np.asarray(elevation_rad, float))
    if pattern == "isotropic":
        return np.ones(azimuth.shape)
    if pattern != "tr38901":
        raise ValueError(f"element_pattern = '{pattern}': allowed are 'tr38901' and 'isotropic'")
    wrapped_deg = np.rad2deg((azimuth + np.pi) % (2 * np.pi) - np.pi)
    vertical_db = np.minimum(12 * (np.rad2deg(elevation) / 65) ** 2, 30)
    horizontal_db = np.minimum(12 * (wrapped_deg / 65) ** 2, 30)
    gain_db = 8 - np.minimum(vertical_db + horizontal_db, 30)
    return np.asarray(10 ** (gain_db / 20))


def steering_vector(
    position_m: FloatArray, carrier_hz: float, azimuth_rad: Any, elevation_rad: Any
) -> ComplexArray:
    """Phases exp(+j k r.u) (..., element) of the elements at `position_m` for directions in the panel frame."""
    wavenumber = 2 * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S
    return np.exp(1j * wavenumber * direction(azimuth_rad, elevation_rad) @ position_m.T)
