"""Codebooks: the beams of a device, over one or several panels, and their angular responses."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from scenes.pose import wrap_angle
from scenes.record import ComplexArray, FloatArray, Record, array
from sim.signal.arrays.array import element_amplitude, from_panel, steering_vector, to_panel, vertical_polarisation
from sim.signal.arrays.beams import PanelBeams, sine_spaced_azimuths, steered_beams


@dataclass(frozen=True)
class Codebook(Record):
    """Beams of a device; each one is a set of weights on a panel with an azimuth and a tilt.

    All panels share the phase centre of the device (one rotating array, or panels close together).

    Raises `ValueError` if a beam has no weights, or they do not fit the elements.
    """

    element_position_m: FloatArray = array("element", "xyz", unit="m", doc="in the panel frame, boresight +x")
    element_pattern: str = array(dtype=str, doc="pattern of every element: 'tr38901' or 'isotropic'")
    polarisation_slant_rad: float = array(unit="rad", doc="slant of every element's polarisation, 0 vertical")
    carrier_hz: float = array(unit="Hz", doc="design frequency of the weights")
    weights: ComplexArray = array("beam", "element", dtype=complex, doc="beam weights, nominally of unit norm")
    panel_azimuth_rad: FloatArray = array("beam", unit="rad", doc="boresight of the beam's panel, device frame")
    panel_tilt_rad: FloatArray = array("beam", unit="rad", doc="elevation of the panel's boresight")
    azimuth_rad: FloatArray = array("beam", unit="rad", doc="nominal pointing azimuth, device frame")
    elevation_rad: FloatArray = array("beam", unit="rad", doc="nominal pointing elevation")

    def __post_init__(self) -> None:
        super().__post_init__()
        bad = np.flatnonzero(~np.isfinite(self.weights).all(axis=1) | ~self.weights.any(axis=1))
        if len(bad):
            raise ValueError(f"Codebook.weights: beam {bad[0]} has none, every beam needs finite weights")

    def __len__(self) -> int:
        return self.size("beam")


def codebook_on_panels(
    beams: PanelBeams,
    element_position_m: FloatArray,
    carrier_hz: float,
    *,
    panel_azimuth_rad: Sequence[float],
    panel_tilt_rad: Sequence[float] = (0.0,),
    element_pattern: str = "tr38901",
    polarisation_slant_rad: float = 0.0,
) -> Codebook:
    """The same beams on every panel of a device, ordered by panel. A single tilt applies to all panels.

    Raises `ValueError` if there are no panels, or if the numbers of tilts and panels differ.
    """
    if not len(panel_azimuth_rad):
        raise ValueError("panel_azimuth_rad is empty: at least 1 panel is needed")
    tilts = list(panel_tilt_rad) * (len(panel_azimuth_rad) if len(panel_tilt_rad) == 1 else 1)
    if len(tilts) != len(panel_azimuth_rad):
        raise ValueError(
            f"panel_tilt_rad: {len(tilts)} for {len(panel_azimuth_rad)} panels, 1 or one each is needed"
        )
    pointing = [
        from_panel(beams.azimuth_rad, beams.elevation_rad, azimuth, tilt)
        for azimuth, tilt in zip(panel_azimuth_rad, tilts, strict=True)
    ]
    return Codebook(
        element_position_m=element_position_m,
        element_pattern=element_pattern,
        polarisation_slant_rad=polarisation_slant_rad,
        carrier_hz=carrier_hz,
        weights=np.tile(beams.weights, (len(tilts), 1)),
        panel_azimuth_rad=np.repeat(np.asarray(panel_azimuth_rad, float), len(beams)),
        panel_tilt_rad=np.repeat(np.asarray(tilts, float), len(beams)),
        azimuth_rad=wrap_angle(np.concatenate([azimuth for azimuth, _ in pointing])),
        elevation_rad=np.concatenate([elevation for _, elevation in pointing]),
    )


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

    Beams are ordered by panel, then azimuth. Raises `ValueError` for no panels, no beams, or a sector outside
    (0, 180] deg.
    """
    azimuth = sine_spaced_azimuths(beams_per_panel, sector_rad)
    return codebook_on_panels(
        steered_beams(element_position_m, carrier_hz, azimuth, np.zeros(len(azimuth))),
        element_position_m,
        carrier_hz,
        panel_azimuth_rad=panel_azimuth_rad,
        element_pattern=element_pattern,
    )


def beam_response(codebook: Codebook, azimuth_rad: Any, elevation_rad: Any = 0.0) -> ComplexArray:
    """Angular response G (beam, direction) of every beam towards directions in the device frame.

    G(u) = g(u) w^T a(u): element amplitude (of its vertical polarisation), weights and steering vector, the G_TX
    and G_RX of equation (1).
    """
    azimuth, elevation = np.broadcast_arrays(np.atleast_1d(azimuth_rad), np.atleast_1d(elevation_rad))
    response = np.empty((len(codebook), len(azimuth)), complex)
    slant = codebook.polarisation_slant_rad
    panels = np.stack([codebook.panel_azimuth_rad, codebook.panel_tilt_rad], axis=1)
    for panel, tilt in np.unique(panels, axis=0):
        beams = (panels == (panel, tilt)).all(axis=1)
        local = to_panel(azimuth, elevation, panel, tilt)
        steering = steering_vector(codebook.element_position_m, codebook.carrier_hz, *local)
        amplitude = element_amplitude(codebook.element_pattern, *local)
        if slant or tilt:
            amplitude = amplitude * vertical_polarisation(azimuth, elevation, panel, tilt, slant)
        response[beams] = codebook.weights[beams] @ steering.T * amplitude
    return response
