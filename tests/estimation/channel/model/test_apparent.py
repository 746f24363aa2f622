"""Directions as horizontal beams see them."""

import numpy as np
from numpy.testing import assert_allclose

from estimation.channel.model.apparent import apparent_angles
from estimation.channel.model.manifold import Manifold
from sim.signal.arrays.array import upa_positions_m
from sim.signal.arrays.beams import direction_grid, sine_spaced_azimuths, steered_beams
from sim.signal.arrays.codebook import beam_response, codebook_on_panels, steered_codebook

CARRIER_HZ = 60e9
POSITION_M = upa_positions_m(4, 16, CARRIER_HZ)
FOUR_SIDES = steered_codebook(
    POSITION_M, CARRIER_HZ, panel_azimuth_rad=[-np.pi, -np.pi / 2, 0.0, np.pi / 2], beams_per_panel=12,
    sector_rad=np.pi / 2,
)  # fmt: skip


def test_horizontal_directions_are_unchanged():
    azimuth = np.linspace(-3.0, 3.0, 25)
    angles, gain = apparent_angles(FOUR_SIDES, Manifold(FOUR_SIDES), azimuth, 0.0)
    assert_allclose(angles[:, 0], azimuth, atol=1e-12)
    assert_allclose(gain, 1, atol=1e-9)


def test_cone_angles_have_the_biases_of_the_reference():
    """At 10 deg elevation 0.3, 0.9 and 1.5 deg for azimuths of 20, 45 and 60 deg, towards the boresight."""
    book = steered_codebook(
        POSITION_M, CARRIER_HZ, panel_azimuth_rad=[0.0], beams_per_panel=32, sector_rad=np.deg2rad(140)
    )
    azimuth, elevation = np.deg2rad([20.0, 45.0, 60.0, -60.0]), np.full(4, np.deg2rad(10.0))
    angles, gain = apparent_angles(book, Manifold(book), azimuth, elevation)
    assert_allclose(np.rad2deg(azimuth - angles[:, 0]), [0.3, 0.9, 1.5, -1.5], atol=0.06)
    true = beam_response(book, azimuth, elevation).T
    model = Manifold(book).response(angles) * gain[:, None]
    assert_allclose(np.linalg.norm(true - model, axis=1) / np.linalg.norm(true, axis=1), 0, atol=0.02)


def test_beams_that_resolve_elevation_keep_the_direction():
    beams = steered_beams(POSITION_M, CARRIER_HZ, *direction_grid(sine_spaced_azimuths(8, 1.5), [-0.3, 0.0, 0.3]))
    book = codebook_on_panels(beams, POSITION_M, CARRIER_HZ, panel_azimuth_rad=[0.0])
    angles, gain = apparent_angles(book, Manifold(book), [0.3, -0.2], [0.1, -0.2])
    assert_allclose(angles, [[0.3, 0.1], [-0.2, -0.2]])
    assert_allclose(gain, 1, atol=1e-9)
