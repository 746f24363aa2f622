"""Directions as a codebook sees them: horizontal beams cannot tell a direction from its cone angle."""

from __future__ import annotations

from typing import Any

import numpy as np

from estimation.channel.manifold import Manifold
from scenes.pose import wrap_angle
from scenes.record import ComplexArray, FloatArray
from sim.codebook import Codebook, beam_response


def apparent_angles(
    codebook: Codebook, manifold: Manifold, azimuth_rad: Any, elevation_rad: Any
) -> tuple[FloatArray, ComplexArray]:
    """Angles (direction, angle) that a manifold's model has for true directions, and the gains (direction,) there.

    A manifold of two angles has the direction itself. One of azimuths at elevation zero sees the panel whose best
    beam is the strongest there under sin(azimuth) cos(elevation) about its boresight. The gain is the factor that
    brings the model's responses nearest to the true ones: element patterns and columns know the elevation.
    """
    azimuth, elevation = np.broadcast_arrays(np.atleast_1d(azimuth_rad), np.atleast_1d(elevation_rad))
    response = beam_response(codebook, azimuth, elevation).T
    if manifold.n_angles == 2:
        angles = np.stack([wrap_angle(azimuth), elevation], axis=1)
    else:
        panel = codebook.panel_azimuth_rad[np.abs(response).argmax(axis=1)]
        cone = np.arcsin(np.sin(azimuth - panel) * np.cos(elevation))
        angles = np.asarray(wrap_angle(panel + cone))[:, None]
    model = manifold.response(angles)
    energy = np.square(np.abs(model)).sum(axis=1)
    overlap = (model.conj() * response).sum(axis=1)
    return angles, np.where(energy > 0, overlap / np.where(energy > 0, energy, 1.0), 0.0)
