"""Codebooks: the beams of a device, over one or several panels."""

from __future__ import annotations

from dataclasses import dataclass

from scenes.record import ComplexArray, FloatArray, Record, array


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
