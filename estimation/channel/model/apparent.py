"""Apparent directions: horizontal beams do not distinguish a direction from its cone angle."""

from typing import Any

import numpy as np

from estimation.channel.model.manifold import Manifold
from scenes.pose import wrap_angle
from scenes.record import BoolArray, ComplexArray, FloatArray
from sim.signal.arrays.codebook import Codebook, beam_response


def cone_angles(
    azimuth_rad: FloatArray, elevation_rad: FloatArray, boresight_rad: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Azimuths at elevation zero of the same cone about a boresight, and their slopes over azimuth and elevation.

    sin(cone) = sin(azimuth) cos(elevation) about the boresight, all (direction,) in rad; slopes (direction, 2).
    The cone angle is always in front: a flat array does not distinguish front and back.
    """
    turn = azimuth_rad - boresight_rad
    sine = np.sin(turn) * np.cos(elevation_rad)
    across = np.sqrt(np.maximum(1 - sine**2, np.finfo(float).tiny))
    slopes = np.stack([np.cos(turn) * np.cos(elevation_rad), -np.sin(turn) * np.sin(elevation_rad)], axis=1)
    return np.asarray(boresight_rad + np.arcsin(sine)), slopes / across[:, None]


def directions_on_cone(
    angles_rad: FloatArray, boresight_rad: FloatArray, elevation_rad: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Directions (direction, elevation, 2) on the cones of others (direction, 2) about a boresight (direction,).

    They are in front, at each of the elevations (elevation,). The second result (direction, elevation) is whether
    the cone reaches this elevation.
    """
    boresight = boresight_rad[:, None]
    sine = np.sin(angles_rad[:, :1] - boresight) * np.cos(angles_rad[:, 1:]) / np.cos(elevation_rad)
    is_there = np.abs(sine) < 1
    azimuth = boresight + np.arcsin(np.where(is_there, sine, 0.0))
    return np.stack([azimuth, np.broadcast_to(elevation_rad, azimuth.shape)], axis=2), is_there


def reported_angles(manifold: Manifold, angles_rad: FloatArray) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Directions as a manifold reports them: angles, their slopes over `angles_rad` (direction, angle), and gains.

    A manifold of two angles reports the directions. One of azimuths reports cone angles about the boresight of the
    panel of the strongest beam; `angles_rad` may then have an elevation, as `Manifold.with_hidden_elevation` takes
    it. The gain (direction,) is that of the strongest beam over its gain at the reported angles.
    """
    n, n_given = angles_rad.shape
    if manifold.n_angles == 2:
        return angles_rad, np.broadcast_to(np.eye(2), (n, 2, 2)), np.ones(n, complex)
    full = manifold.with_hidden_elevation() if n_given == 2 else manifold
    elevation = angles_rad[:, 1] if n_given == 2 else np.zeros(n)
    cone, slopes = cone_angles(angles_rad[:, 0], elevation, full.best_panel_rad(angles_rad))
    response, model = full.response(angles_rad), manifold.response(cone[:, None])
    best = np.abs(response).argmax(axis=1)[:, None]
    gain = np.take_along_axis(response, best, axis=1) / np.take_along_axis(model, best, axis=1)
    return cone[:, None], slopes[:, None, :n_given], gain[:, 0]


def reported_slopes(aod_slopes: FloatArray, aoa_slopes: FloatArray, n_turns: int) -> FloatArray:
    """Slopes (path, reported, fitted) of delay, angles and turns, from those of both directions."""
    n = len(aod_slopes)
    blocks = np.ones((n, 1, 1)), aod_slopes, aoa_slopes, np.broadcast_to(np.eye(n_turns), (n, n_turns, n_turns))
    slopes = np.zeros((n, sum(block.shape[1] for block in blocks), sum(block.shape[2] for block in blocks)))
    row = column = 0
    for block in blocks:
        slopes[:, row : row + block.shape[1], column : column + block.shape[2]] = block
        row, column = row + block.shape[1], column + block.shape[2]
    return slopes


def apparent_angles(
    codebook: Codebook, manifold: Manifold, azimuth_rad: Any, elevation_rad: Any
) -> tuple[FloatArray, ComplexArray]:
    """Angles (direction, angle) under which a manifold's model fits true directions, and the gains (direction,).

    A manifold of two angles has the direction itself. One of azimuths at elevation zero observes sin(azimuth)
    cos(elevation) about the boresight of the panel whose best beam is strongest. The gain is the factor that
    brings the model's responses nearest to the true ones: element patterns and columns depend on elevation.
    """
    azimuth, elevation = np.broadcast_arrays(np.atleast_1d(azimuth_rad), np.atleast_1d(elevation_rad))
    response = beam_response(codebook, azimuth, elevation).T
    if manifold.n_angles == 2:
        angles = np.stack([wrap_angle(azimuth), elevation], axis=1)
    else:
        panel = codebook.panel_azimuth_rad[np.abs(response).argmax(axis=1)]
        angles = np.asarray(wrap_angle(cone_angles(azimuth, elevation, panel)[0]))[:, None]
    model = manifold.response(angles)
    energy = np.square(np.abs(model)).sum(axis=1)
    overlap = (model.conj() * response).sum(axis=1)
    return angles, np.where(energy > 0, overlap / np.where(energy > 0, energy, 1.0), 0.0)
