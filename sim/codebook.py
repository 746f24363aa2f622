"""Codebooks: the beams of a device, over one or several panels, and their angular responses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from scenes.pose import wrap_angle
from scenes.record import ComplexArray, FloatArray, Record, array
from sim.array import element_amplitude, steering_vector


@dataclass(frozen=True)
class Codebook(Record):
    """Beams of a device, each a set of unit-norm weights on a panel turned to some azimuth.

    All panels share the device's phase centre (the array is turned mechanically, or panels are close).
    """

    element_position_m: FloatArray = array("element", "xyz", unit="m", doc="in the panel frame, boresight +x")
    element_pattern: str = array(dtype=str, doc="pattern of every element: 'tr38901' or 'isotropic'")
    carrier_hz: float = array(unit="Hz", doc="frequency the weights were made for")
    weights: ComplexArray = array("beam", "element", dtype=complex, doc="unit-norm beam weights")
    panel_azimuth_rad: FloatArray = array(
        "beam", unit="rad", doc="boresight of the beam's panel, device frame"
    )
    azimuth_rad: FloatArray = array("beam", unit="rad", doc="nominal pointing azimuth, device frame")
    elevation_rad: FloatArray = array("beam", unit="rad", doc="nominal pointing elevation")

    def __len__(self) -> int:
        return self.size("beam")


def steered_codebook(
    element_position_m: FloatArray,
    carrier_hz: float,
    *,
    panel_azimuth_rad: Sequence[float],
    beams_per_panel: int,
    sector_rad: float,
    element_pattern: str = "tr38901",
) -> Codebook:
    """Horizontal beams of every panel, uniform in the sine of azimuth over +-sector/2 of its boresight.

    The outermost beams lie half a step inside the sector's edges, so panels one sector apart share the horizon
    without doubling a beam. Beams are ordered by panel, then azimuth.

    Raises
    ------
    ValueError
        For no panels, no beams, or a sector outside (0, 180] deg.
    """
    if beams_per_panel < 1:
        raise ValueError(f"beams_per_panel = {beams_per_panel}: at least 1 beam is needed")
    if not len(panel_azimuth_rad):
        raise ValueError("panel_azimuth_rad is empty: at least 1 panel is needed")
    if not 0 < sector_rad <= np.pi:
        raise ValueError(f"sector = {np.rad2deg(sector_rad):g} deg: allowed is 0 to 180 deg, 0 excluded")
    edge = np.sin(sector_rad / 2)
    local = np.arcsin(edge * ((2 * np.arange(beams_per_panel) + 1) / beams_per_panel - 1))
    panel = np.repeat(np.asarray(panel_azimuth_rad, float), beams_per_panel)
    azimuth = np.tile(local, len(panel_azimuth_rad))
    steering = steering_vector(element_position_m, carrier_hz, azimuth, 0.0)
    return Codebook(
        element_position_m=element_position_m,
        element_pattern=element_pattern,
        carrier_hz=carrier_hz,
        weights=steering.conj() / np.sqrt(len(element_position_m)),
        panel_azimuth_rad=panel,
        azimuth_rad=wrap_angle(panel + azimuth),
        elevation_rad=np.zeros(len(panel)),
    )


def beam_response(codebook: Codebook, azimuth_rad: Any, elevation_rad: Any = 0.0) -> ComplexArray:
    """Angular response G (beam, direction) of every beam towards directions in the device frame.

    G(u) = g(u) w^T a(u): element amplitude, weights and steering vector, the G_TX and G_RX of equation (1).
    """
    azimuth, elevation = np.broadcast_arrays(np.atleast_1d(azimuth_rad), np.atleast_1d(elevation_rad))
    response = np.empty((len(codebook), len(azimuth)), complex)
    for panel in np.unique(codebook.panel_azimuth_rad):
        beams = codebook.panel_azimuth_rad == panel
        local = azimuth - panel
        steering = steering_vector(codebook.element_position_m, codebook.carrier_hz, local, elevation)
        amplitude = element_amplitude(codebook.element_pattern, local, elevation)
        response[beams] = codebook.weights[beams] @ steering.T * amplitude
    return response
