"""Beams of one panel: steered, DFT, the 63 of the Campus Arena measurement, hierarchical, or given weights.

Every function returns unit-norm weights and the pointing direction of each beam in the panel frame. `shaped_beams`
then applies an amplitude taper and phase shifters with few bits.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scenes.record import ComplexArray, FloatArray, Record, array
from sim.signal.arrays.array import element_amplitude, steering_vector

CAMPUS_BEAMS = 63
CAMPUS_STEP_RAD = np.deg2rad(90.0 / 62)
POINTING_GRID_RAD = np.deg2rad(1.0)


@dataclass(frozen=True)
class PanelBeams(Record):
    """Beams of one panel, pointing directions in the panel frame."""

    weights: ComplexArray = array("beam", "element", dtype=complex, doc="unit-norm beam weights")
    azimuth_rad: FloatArray = array("beam", unit="rad", doc="pointing azimuth")
    elevation_rad: FloatArray = array("beam", unit="rad", doc="pointing elevation")

    def __len__(self) -> int:
        return self.size("beam")


def steered_beams(
    position_m: FloatArray, carrier_hz: float, azimuth_rad: FloatArray, elevation_rad: FloatArray
) -> PanelBeams:
    """Beams (beam,) whose phases add up towards the given directions: w = a(u)* / sqrt(N)."""
    steering = steering_vector(position_m, carrier_hz, azimuth_rad, elevation_rad)
    return PanelBeams(steering.conj() / np.sqrt(len(position_m)), azimuth_rad, elevation_rad)


def sine_spaced_azimuths(n_beams: int, sector_rad: float) -> FloatArray:
    """Azimuths (beam,) uniform in the sine over +-sector/2, the outermost half a step inside the edges.

    So panels that are one sector apart cover the horizon without duplicate beams.

    Raises `ValueError` for no beams, or a sector outside (0, 180] deg.
    """
    if n_beams < 1:
        raise ValueError(f"beams_per_panel = {n_beams}: at least 1 beam is needed")
    if not 0 < sector_rad <= np.pi:
        raise ValueError(f"sector = {np.rad2deg(sector_rad):g} deg: allowed is 0 to 180 deg, 0 excluded")
    edge = np.sin(sector_rad / 2)
    return np.asarray(np.arcsin(edge * ((2 * np.arange(n_beams) + 1) / n_beams - 1)))


def direction_grid(azimuth_rad: FloatArray, elevation_rad: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """Every azimuth at every elevation, as two arrays (beam,), ordered by elevation, then azimuth."""
    elevations = np.asarray(elevation_rad, float)
    return np.tile(azimuth_rad, len(elevations)), np.repeat(elevations, len(azimuth_rad))


def campus_azimuths(sector_rad: float = np.pi / 2) -> FloatArray:
    """Azimuths (beam,) of the Campus Arena codebook: 63 over +-45 deg in steps of 1.45 deg, beam 31 at boresight.

    If the array is rotated in steps below 90 deg, only the beams within +-sector/2 are needed.
    """
    azimuth = (np.arange(CAMPUS_BEAMS) - CAMPUS_BEAMS // 2) * CAMPUS_STEP_RAD
    return np.asarray(azimuth[np.abs(azimuth) <= sector_rad / 2 + 1e-9])


def dft_beams(position_m: FloatArray, carrier_hz: float, rows: int, columns: int) -> PanelBeams:
    """The orthogonal DFT beams of a half-wavelength planar array, ordered by elevation, then azimuth.

    Direction cosines are multiples of 2/columns along y and 2/rows along z, broadside included; beams outside
    the visible half space are omitted.
    """
    y, z = (2 * np.arange(-(n // 2), (n + 1) // 2) / n for n in (columns, rows))
    grid_z, grid_y = (grid.ravel() for grid in np.meshgrid(z, y, indexing="ij"))
    visible = grid_y**2 + grid_z**2 < 1
    elevation = np.arcsin(grid_z[visible])
    return steered_beams(position_m, carrier_hz, np.arcsin(grid_y[visible] / np.cos(elevation)), elevation)


def hierarchical_beams(
    position_m: FloatArray, carrier_hz: float, columns: int, n_levels: int, sector_rad: float
) -> PanelBeams:
    """Levels of 1, 2, 4, ... 2^(n_levels - 1) horizontal beams, every level covering the sector.

    Wide beams use fewer active columns: n neighbouring columns at half a wavelength are 2/n wide in the
    sine of azimuth (DEACT, Z. Xiao et al., IEEE Trans. Wireless Commun. 15(5), 2016). Beam b of level s has the
    children 2b and 2b + 1 of level s + 1; the levels are in order. All rows are active.

    Raises `ValueError` for no levels, or more than the array has columns for.
    """
    edge = np.sin(sector_rad / 2)
    finest = int(np.floor(np.log2(columns * edge + 0.5))) + 1
    if not 1 <= n_levels <= max(finest, 1):
        raise ValueError(
            f"hierarchy_levels = {n_levels}: allowed is 1 to {max(finest, 1)}, no beam is narrower than that of"
            f" {columns} columns"
        )
    column = np.arange(len(position_m)) % columns
    levels = []
    for level in range(n_levels):
        azimuth = sine_spaced_azimuths(2**level, sector_rad)
        n_active = min(columns, max(1, round(2**level / edge)))
        first = (columns - n_active) // 2
        active = ((column >= first) & (column < first + n_active)).astype(float)
        steering = steering_vector(position_m, carrier_hz, azimuth, 0.0)
        levels.append((azimuth, unit_norm(steering.conj() * active)))
    azimuth = np.concatenate([level[0] for level in levels])
    return PanelBeams(np.concatenate([level[1] for level in levels]), azimuth, np.zeros(len(azimuth)))


def beams_from_weights(
    position_m: FloatArray, carrier_hz: float, weights: ComplexArray, element_pattern: str
) -> PanelBeams:
    """Beams of given weights (beam, element), normalised; each one points to its maximum on a 1 deg grid.

    Raises `ValueError` if there are no beams, a beam has no weights, or the number of weights differs from the
    number of elements.
    """
    if weights.ndim != 2 or not len(weights):
        raise ValueError(f"weights: shape {weights.shape}, needed is (beam, element) with at least 1 beam")
    if weights.shape[1] != len(position_m):
        raise ValueError(
            f"weights: {weights.shape[1]} per beam, the array has {len(position_m)} elements: they must agree"
        )
    unit = unit_norm(weights)
    half = np.arange(-90, 91) * POINTING_GRID_RAD
    azimuth, elevation = direction_grid(half, half.tolist())
    amplitude = element_amplitude(element_pattern, azimuth, elevation)
    steering = steering_vector(position_m, carrier_hz, azimuth, elevation)
    strength = np.round(np.abs(unit @ steering.T) * amplitude, 9)
    # Among directions of equal strength (a single row or column has many) the one nearest to boresight.
    nearest = np.argsort(azimuth**2 + elevation**2, kind="stable")
    best = nearest[np.argmax(strength[:, nearest], axis=1)]
    return PanelBeams(unit, azimuth[best], elevation[best])


def shaped_beams(beams: PanelBeams, taper: FloatArray | None = None, phase_bits: int | None = None) -> PanelBeams:
    """The beams with an amplitude taper (element,) and with phases rounded to multiples of 2 pi / 2^phase_bits."""
    weights = beams.weights
    if taper is not None:
        weights = weights * taper
    if phase_bits is not None:
        weights = quantised_phase(weights, phase_bits)
    return PanelBeams(unit_norm(weights), beams.azimuth_rad, beams.elevation_rad)


def quantised_phase(weights: ComplexArray, bits: int) -> ComplexArray:
    """Weights with their amplitudes kept and their phases rounded to multiples of 2 pi / 2^bits.

    Raises `ValueError` for less than 1 bit.
    """
    if bits < 1:
        raise ValueError(f"phase_bits = {bits}: a phase shifter has at least 1 bit")
    step = 2 * np.pi / 2**bits
    return np.asarray(np.abs(weights) * np.exp(1j * step * np.round(np.angle(weights) / step)))


def unit_norm(weights: ComplexArray) -> ComplexArray:
    """Weights (beam, element) scaled to norm 1 per beam.

    Raises `ValueError` naming the first beam whose weights are all zero or not finite.
    """
    norm = np.linalg.norm(weights, axis=1, keepdims=True)
    bad = np.flatnonzero(~np.isfinite(norm[:, 0]) | (norm[:, 0] == 0))
    if len(bad):
        raise ValueError(f"weights: beam {bad[0]} has none, every beam needs finite weights that are not all zero")
    return np.asarray(weights / norm)
