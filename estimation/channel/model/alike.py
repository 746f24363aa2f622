"""Directions elsewhere in which the beams of a device respond alike.

Beams at two elevations tell apart little more than the ratio of their gains, which returns further up.
"""

import numpy as np

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


def padded_rows(rows: list[IntArray]) -> IntArray:
    """Rows (row, place) of equal length, padded with the number of the row."""
    table = np.tile(np.arange(len(rows))[:, None], (1, max(1, *(len(row) for row in rows))))
    for i, row in enumerate(rows):
        table[i, : len(row)] = row
    return table
