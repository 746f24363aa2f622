"""Walls of two planes: a window or a panel stands a few centimetres before its wall, or behind it.

Seen with wide noise both are one wall, whose line is between the two and shifts the stops. The paths off a stretch
of the wall then agree on another offset than the rest.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimation.laws.wall import wall_places
from estimation.slam.config import TrajectoryConfig
from estimation.slam.walk.linearise import linearise
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState
from scenes.record import FloatArray, IntArray

_LEAST_PATHS = 4  # on each of the two planes
_LEAST_GAIN = 5.0  # in log likelihood, beside the number of stretches that were tried


class Split(NamedTuple):
    """A wall of which some paths are to have a plane of their own."""

    gain: float  # in log likelihood, with the states held
    wall: int
    path: IntArray  # those of the stretch
    shift_m: FloatArray  # (2,) of the offset, of the other paths and of those of the stretch


def split_walls(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> tuple[TrajectoryState, Association]:
    """The walk with two planes for every wall that a stretch with an offset of its own explains better."""
    lin = linearise(seen, link, now, config)
    slope = lin.by_shared[:, :, 2]
    weight = lin.weight(config.degrees_of_freedom)
    information = weight * np.sum(slope**2, axis=1)
    pull = -weight * np.sum(slope * lin.value, axis=1)
    walls, landmark = now.walls.copy(), link.landmark.copy()
    for wall in range(len(now.walls)):
        path = np.flatnonzero((link.kind == PathClass.WALL) & (link.landmark[:, 0] == wall))
        place, _, _ = wall_places(now.walls[wall], seen.tx_rows[path], now.state[seen.row[path], :2])
        order = np.argsort(place, kind="stable")
        split = _best_split(wall, path[order], information[path[order]], pull[path[order]])
        if split is not None:
            landmark[split.path, 0] = len(walls)
            walls = np.concatenate([walls, walls[[wall]] + [0.0, split.shift_m[1]]])
            walls[wall, 1] += split.shift_m[0]
    return replace(now, walls=walls), replace(link, landmark=landmark)


def _best_split(wall: int, path: IntArray, information: FloatArray, pull: FloatArray) -> Split | None:
    """The stretch of paths (path,), sorted along the wall, whose own offset explains most; None for none."""
    n = len(path)
    if n < 2 * _LEAST_PATHS:
        return None
    sums = [np.concatenate([[0.0], np.cumsum(each)]) for each in (information, pull)]
    first, last = np.triu_indices(n + 1, _LEAST_PATHS)
    is_able = n - (last - first) >= _LEAST_PATHS
    first, last = first[is_able], last[is_able]
    inside = [each[last] - each[first] for each in sums]
    outside = [each[-1] - part for each, part in zip(sums, inside, strict=True)]
    gain = (inside[1] ** 2 / inside[0] + outside[1] ** 2 / outside[0] - sums[1][-1] ** 2 / sums[0][-1]) / 2
    best = int(np.argmax(gain))
    if gain[best] < _LEAST_GAIN + np.log(len(gain)):
        return None
    shift = np.array([outside[1][best] / outside[0][best], inside[1][best] / inside[0][best]])
    return Split(float(gain[best]), wall, path[first[best] : last[best]], shift)
