"""Antenna arrays: element positions, element patterns, tapers, panel orientation and steering vectors.

Arrays lie in the y-z plane of their panel frame and look along +x. A plane wave to or from direction u has
phase exp(+j k r.u) at an element at r, relative to the array centre, which is the phase reference.
"""

import warnings
from typing import Any, Literal

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S, azimuth_elevation, direction
from scenes.record import ComplexArray, FloatArray

ElementPattern = Literal["tr38901", "isotropic"]
Taper = Literal["uniform", "taylor", "chebyshev"]


def upa_positions_m(rows: int, columns: int, carrier_hz: float, spacing_wavelengths: float = 0.5) -> FloatArray:
    """Element positions (element, xyz) in m of a uniform planar array centred on the origin, looking along +x."""
    if rows < 1 or columns < 1:
        raise ValueError(f"rows, columns = {rows}, {columns}: a planar array has at least 1 row and 1 column")
    spacing = spacing_wavelengths * SPEED_OF_LIGHT_M_S / carrier_hz
    y = (np.arange(columns) - (columns - 1) / 2) * spacing
    z = (np.arange(rows) - (rows - 1) / 2) * spacing
    grid_z, grid_y = np.meshgrid(z, y, indexing="ij")
    return np.stack([np.zeros(rows * columns), grid_y.ravel(), grid_z.ravel()], axis=1)


def upa_taper(rows: int, columns: int, taper: Taper, side_lobe_db: float = 30.0) -> FloatArray:
    """Amplitudes (element,) of a planar array, largest 1, for side lobes `side_lobe_db` below the main lobe.

    The product of one window along rows and one along columns: 'uniform', 'chebyshev' (Dolph, all side lobes
    equal) or 'taylor' (four nearly equal side lobes, then decreasing).

    Raises `ValueError` for another taper name or a side-lobe level outside 15 to 80 dB.
    """
    if taper == "uniform":
        return np.ones(rows * columns)
    if not 15 <= side_lobe_db <= 80:
        raise ValueError(f"taper_side_lobe_db = {side_lobe_db:g}: allowed is 15 to 80 dB")
    from scipy.signal import windows  # noqa: PLC0415  (slow to import)

    if taper == "taylor":
        along = [windows.get_window(("taylor", 4, side_lobe_db), n, fftbins=False) for n in (rows, columns)]
    elif taper == "chebyshev":
        with warnings.catch_warnings():  # scipy warns about low side lobes, for spectral analysis only
            warnings.simplefilter("ignore", UserWarning)
            along = [windows.chebwin(n, side_lobe_db) if n > 2 else np.ones(n) for n in (rows, columns)]
    else:
        raise ValueError(f"taper = '{taper}': allowed are 'uniform', 'taylor' and 'chebyshev'")
    amplitude = np.outer(*along).ravel()
    return np.asarray(amplitude / amplitude.max())


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
    phase = 2 * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S * direction(azimuth_rad, elevation_rad)
    waves = []
    for axis in range(3):  # a planar array has few distinct coordinates along each axis
        coordinate, index = np.unique(position_m[:, axis], return_inverse=True)
        if coordinate.any():
            waves.append(_waves(phase[..., axis], coordinate).take(index, axis=-1))
    steering = waves.pop() if waves else np.ones((*phase.shape[:-1], len(position_m)), complex)
    for wave in waves:
        steering *= wave
    return np.asarray(steering)


def _waves(phase: FloatArray, coordinate: FloatArray) -> ComplexArray:
    """exp(+j phase coordinate) (..., coordinate); powers of one step if the coordinates have equal spacing."""
    step = np.diff(coordinate)
    is_even = len(step) > 2 and np.ptp(step) < 1e-9 * step[0]
    turn = phase[..., None] * (np.array([coordinate[0], np.mean(step)]) if is_even else coordinate)
    wave = phasors(turn)
    if not is_even:
        return wave
    powers = np.empty((*phase.shape, len(coordinate)), complex)
    powers[..., :1], powers[..., 1:] = wave[..., :1], wave[..., 1:]
    return np.asarray(np.cumprod(powers, axis=-1, out=powers))


def phasors(phase_rad: FloatArray) -> ComplexArray:
    """exp(+j phase) (...): sine and cosine are faster than a complex exponential."""
    wave = np.empty(phase_rad.shape, complex)
    np.cos(phase_rad, out=wave.real)
    np.sin(phase_rad, out=wave.imag)
    return wave


def panel_axes(panel_azimuth_rad: float, panel_tilt_rad: float) -> FloatArray:
    """Axes (xyz of the panel, xyz of the device) of a panel at an azimuth, tilted up by `panel_tilt_rad`.

    Row 0 is the boresight, row 1 the array's horizontal axis, row 2 its column axis.
    """
    boresight = direction(panel_azimuth_rad, panel_tilt_rad)
    column = direction(panel_azimuth_rad, panel_tilt_rad + np.pi / 2)
    return np.stack([boresight, np.cross(column, boresight), column])


def to_panel(
    azimuth_rad: Any, elevation_rad: Any, panel_azimuth_rad: float, panel_tilt_rad: float
) -> tuple[FloatArray, FloatArray]:
    """Azimuth and elevation in the panel frame of directions in the device frame."""
    if panel_tilt_rad == 0:
        return np.asarray(azimuth_rad) - panel_azimuth_rad, np.asarray(elevation_rad)
    return azimuth_elevation(
        direction(azimuth_rad, elevation_rad) @ panel_axes(panel_azimuth_rad, panel_tilt_rad).T
    )


def from_panel(
    azimuth_rad: Any, elevation_rad: Any, panel_azimuth_rad: float, panel_tilt_rad: float
) -> tuple[FloatArray, FloatArray]:
    """Azimuth and elevation in the device frame of directions in the panel frame."""
    if panel_tilt_rad == 0:
        return np.asarray(azimuth_rad) + panel_azimuth_rad, np.asarray(elevation_rad)
    return azimuth_elevation(direction(azimuth_rad, elevation_rad) @ panel_axes(panel_azimuth_rad, panel_tilt_rad))


def vertical_polarisation(
    azimuth_rad: Any, elevation_rad: Any, panel_azimuth_rad: float, panel_tilt_rad: float, slant_rad: float
) -> FloatArray:
    """Vertical part, -1 to 1, of the field of an element towards directions in the device frame.

    TR 38.901 clauses 7.1.3 and 7.3.2 (model 2): cos(slant + psi), with psi the angle by which the panel's tilt
    rotates the polarisation of the element relative to the vertical of the device in that direction. The
    horizontal part is not used: path gains are for vertical to vertical polarisation only.
    """
    if panel_tilt_rad == 0:
        return np.full(np.broadcast(azimuth_rad, elevation_rad).shape, np.cos(slant_rad))
    axes = panel_axes(panel_azimuth_rad, panel_tilt_rad)
    local = to_panel(azimuth_rad, elevation_rad, panel_azimuth_rad, panel_tilt_rad)
    up = direction(azimuth_rad, np.asarray(elevation_rad) + np.pi / 2)
    local_up = direction(local[0], np.asarray(local[1]) + np.pi / 2) @ axes
    left = np.stack([-np.sin(azimuth_rad), np.cos(azimuth_rad), np.zeros(np.shape(azimuth_rad))], axis=-1)
    psi = np.arctan2(-(local_up * left).sum(axis=-1), (local_up * up).sum(axis=-1))
    return np.asarray(np.cos(slant_rad + psi))
