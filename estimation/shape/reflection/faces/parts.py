"""Seen parts of a face: it has a gap where its paths are missing, or where others pass through it.

Paths meet a part evenly along it. A gap from one of them to another is as likely as none beforehand, and all pairs
of ends are alike. It explains that no path met the face there and what contradicts a face; paths within are lost.
"""

import numpy as np

from estimation.shape.reflection.association import MIN_PATHS
from scenes.record import FloatArray


def seen_parts(
    place_m: FloatArray, weight: FloatArray, against_m: FloatArray, against: FloatArray, reach_m: float
) -> FloatArray:
    """First and last places (part, 2) of the parts of a face with enough paths, in order; at least one.

    Paths (path,) met it at `place_m` and have the log evidence `weight`, at least 1, for it. What happened at
    `against_m` (event,) has the log evidence `against` for a gap. A part is expected to reach `reach_m` beyond its
    paths.
    """
    order = np.argsort(place_m)
    parts = _parts(place_m[order], np.maximum(weight[order], 1.0), against_m, against, reach_m)
    enough = [part for part in parts if len(part) >= MIN_PATHS] or [max(parts, key=len)]
    return np.array([[part[0], part[-1]] for part in enough])


def _parts(
    place: FloatArray, weight: FloatArray, against_m: FloatArray, against: FloatArray, reach_m: float
) -> list[FloatArray]:
    """Places (path,) of each part, from those of the face in order, split at the most evident gap."""
    n = len(place)
    if n < 2:
        return [place]
    expected = n / (place[-1] - place[0] + 2 * reach_m) * np.maximum(place - place[:, None] - 2 * reach_m, 0.0)
    event = np.argsort(against_m)
    total = np.append(0.0, np.cumsum(against[event]))[np.searchsorted(against_m[event], place)]
    lost = np.cumsum(weight)
    gain = expected + total - total[:, None] - (lost - weight - lost[:, None])
    gain = np.where(np.triu(np.ones((n, n), bool), 1), gain, -np.inf)
    first, last = np.unravel_index(int(np.argmax(gain)), gain.shape)
    if gain[first, last] <= np.log(n * (n - 1) / 2):
        return [place]
    sides = (slice(0, first + 1), slice(last, n))
    return [part for side in sides for part in _parts(place[side], weight[side], against_m, against, reach_m)]
