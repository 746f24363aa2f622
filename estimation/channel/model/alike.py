"""Directions elsewhere in which the beams of a device respond alike.

Beams at two elevations tell apart little more than the ratio of their gains, which returns further up.
"""

import numpy as np

from estimation.channel.model.apparent import directions_on_cone
from estimation.channel.model.manifold import CELL, Manifold
from scenes.pose import wrap_angle
from scenes.record import FloatArray, IntArray


def alike_directions(manifold: Manifold, angles: FloatArray, likeness: FloatArray, least: float) -> IntArray:
    """Of every direction (direction, angle) those more than a cell away that respond alike: a row each.

    `likeness` (direction, direction) is that of the responses, `least` the least that counts. Of directions next
    to each other the most alike stands for all. Rows are padded with the direction itself, which is their first.
    """
    rate = manifold.rates(angles)
    apart = np.abs(wrap_angle(angles[:, None] - angles)) * np.minimum(rate[:, None], rate)
    elsewhere = apart.max(axis=2) > CELL
    rows = []
    for own in range(len(angles)):
        left, found = elsewhere[own] & (likeness[own] >= least), [own]
        while left.any():
            found.append(int(np.argmax(np.where(left, likeness[own], -1.0))))
            left &= elsewhere[found[-1]]
        rows.append(np.array(found))
    return padded_rows(rows)


def twins_on_cone(manifold: Manifold, angles: FloatArray, least: float) -> list[FloatArray]:
    """Of every direction (direction, 2) the others (twin, 2) on its cone where the likeness has a maximum.

    The cone is that about the boresight of its best panel, on which the columns of the panel respond alike. Maxima
    below `least` do not count. Two that lie on both sides of a fold are less than a resolution cell apart.
    """
    elevation = manifold.elevations()
    on_cone, is_there = directions_on_cone(angles, manifold.best_panel_rad(angles), elevation)
    on_cone[..., 0] = wrap_angle(on_cone[..., 0])
    response = manifold.response(on_cone.reshape(-1, 2)).reshape(*is_there.shape, -1)
    own = manifold.response(angles)
    norm = np.linalg.norm(response, axis=2) * np.linalg.norm(own, axis=1)[:, None]
    likeness = np.abs(np.einsum("deb,db->de", response, own.conj())) / np.maximum(norm, np.finfo(float).tiny)
    likeness = np.where(is_there, likeness, 0.0)
    inside = likeness[:, 1:-1]
    is_twin = (inside >= least) & (inside > likeness[:, :-2]) & (inside >= likeness[:, 2:])
    is_twin &= np.abs(elevation[1:-1] - angles[:, 1:]) > elevation[1] - elevation[0]
    return [one[1:-1][twin] for one, twin in zip(on_cone, is_twin, strict=True)]


def padded_rows(rows: list[IntArray]) -> IntArray:
    """Rows (row, place) of equal length, padded with the number of the row."""
    table = np.tile(np.arange(len(rows))[:, None], (1, max(1, *(len(row) for row in rows))))
    for i, row in enumerate(rows):
        table[i, : len(row)] = row
    return table
