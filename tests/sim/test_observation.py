"""The observation record: all that a receiver would have, and nothing else."""

from collections.abc import Iterator
from dataclasses import fields
from typing import get_type_hints

from scenes.record import Record
from sim.observation import BeamSweep

KNOWN_TO_A_RECEIVER = {
    "samples",
    "stop",
    # the grid
    "prs_symbol", "frequency_offset_hz", "carrier_hz",
    # the beams of both devices, as designed
    "tx_codebook", "rx_codebook", "element_position_m", "element_pattern", "polarisation_slant_rad", "weights",
    "panel_azimuth_rad", "panel_tilt_rad", "azimuth_rad", "elevation_rad",
    # the TX pose
    "tx_pose", "position_m", "heading_rad",
    # the times of the beam pairs, where the world moves
    "clock",
    # the noise estimate
    "noise_power_mw",
}  # fmt: skip


def field_names(kind: type[Record]) -> Iterator[str]:
    hints = get_type_hints(kind)
    for spec in fields(kind):
        yield spec.name
        if isinstance(hints[spec.name], type) and issubclass(hints[spec.name], Record):
            yield from field_names(hints[spec.name])


def test_the_sweep_carries_what_a_receiver_knows_and_nothing_else() -> None:
    assert set(field_names(BeamSweep)) == KNOWN_TO_A_RECEIVER
    assert "rx_pose" not in get_type_hints(BeamSweep)
