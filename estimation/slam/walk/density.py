"""Density-based clusters of points in the plane, compiled: the smoother clusters at every round."""

from __future__ import annotations

import numpy as np

from estimation.execution import compiled
from scenes.record import FloatArray, IntArray


@compiled
def density_clusters(point_m: FloatArray, eps_m: float, min_samples: int) -> IntArray:
    """Label (point,) of the cluster of every point (point, 2) by DBSCAN, -1 for noise.

    Ester et al., "A density-based algorithm for discovering clusters", KDD 1996. Points with `min_samples` within
    `eps_m`, themselves included, are cores; clusters are numbered by their first core, and a point that two
    clusters reach belongs to the first. Points are searched in strips of `eps_m` along x.
    """
    n = len(point_m)
    order = np.argsort(point_m[:, 0])
    place = np.empty(n, np.int64)
    for at in range(n):
        place[order[at]] = at
    x, y = point_m[order, 0], point_m[order, 1]
    low, high, count = np.empty(n, np.int64), np.empty(n, np.int64), np.zeros(n, np.int64)
    first, last = 0, 0
    for at in range(n):
        while x[at] - x[first] > eps_m:
            first += 1
        while last < n and x[last] - x[at] <= eps_m:
            last += 1
        low[at], high[at] = first, last
        for other in range(first, last):
            count[at] += (x[at] - x[other]) ** 2 + (y[at] - y[other]) ** 2 <= eps_m**2
    label, stack = np.full(n, -1), np.empty(n, np.int64)
    cluster = 0
    for point in range(n):
        start = place[point]
        if label[point] >= 0 or count[start] < min_samples:
            continue
        label[point], stack[0], depth = cluster, start, 1
        while depth:
            depth -= 1
            at = stack[depth]
            for other in range(low[at], high[at]):
                near = (x[at] - x[other]) ** 2 + (y[at] - y[other]) ** 2 <= eps_m**2
                if near and label[order[other]] < 0:
                    label[order[other]] = cluster
                    if count[other] >= min_samples:
                        stack[depth] = other
                        depth += 1
        cluster += 1
    return label
