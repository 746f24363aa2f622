"""Normal equations of `estimation.shape.reflection.bundle`, compiled: each path adds to its own unknowns only.

A path depends on the parameters of its object, three offsets and the state of its stop. The common unknowns are
[delay offset, arrival offset, departure offset of every session, parameters of every object].
"""

from typing import NamedTuple

import numpy as np

from estimation.execution import compiled
from estimation.laws.contour import contour_path, path_work
from estimation.laws.plane import los_path
from estimation.shape.reflection.search import N_COMMON, PathArrays, inlier_share, path_difference
from scenes.record import FloatArray, IntArray

LOS = -1  # the family of lines of sight, which have no parameters
_LEAST_INFORMATION = 1e-8  # on an object that lost all its paths to ghosts, per square of m or rad


class BundlePaths(NamedTuple):
    """The paths of all sets, which are the objects and then the lines of sight."""

    paths: PathArrays
    weight: FloatArray  # (path, 3, 3) inverse covariances of the measurements
    log_norm: FloatArray  # (path,) log normalisations of the inliers
    of_set: IntArray  # (path,)
    row: IntArray  # (path,) of the stop
    column: IntArray  # (path, 4) of the state of the stop
    family: IntArray  # (set,) of `estimation.laws.contour`, or `LOS`
    first: IntArray  # (set,) the first parameter among the common unknowns
    size: IntArray  # (set,) number of parameters


class BundleSystem(NamedTuple):
    """Minus the log posterior and its normal equations; the blocks of the stops are separate."""

    cost: float
    common_gradient: FloatArray  # (common,)
    common: FloatArray  # (common, common)
    stop_gradient: FloatArray  # (stop, state)
    stop: FloatArray  # (stop, state, state)
    cross: FloatArray  # (stop, state, common)
    share: FloatArray  # (path,) probabilities of not being ghosts
    square: FloatArray  # (path,) squared errors over their variances

    def schur(self, damping: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The reduced system of the common unknowns, and inv(stop) times gradient (stop, state) and cross."""
        damped = self.stop * (1 + damping * np.eye(self.stop.shape[1]))
        through = np.linalg.solve(damped, np.concatenate([self.stop_gradient[..., None], self.cross], axis=2))
        own, cross = through[..., 0], through[..., 1:]
        size = len(self.common)
        common = self.common * (1 + damping * np.eye(size)) + _LEAST_INFORMATION * np.eye(size)
        return common - self.cross.reshape(-1, size).T @ cross.reshape(-1, size), own, cross


def bundle_system(
    common: FloatArray, state: FloatArray, data: BundlePaths, scale: FloatArray, log_ghost: float
) -> BundleSystem:
    """The terms of the paths at common unknowns (common,) and states (stop, state); priors are not in them.

    The covariances of a set are multiplied by its `scale` (set,).
    """
    n, size, (n_stops, own) = len(data.row), len(common), state.shape
    arrays = (np.zeros(size), np.zeros((size, size)), np.zeros((n_stops, own)), np.zeros((n_stops, own, own)))
    rest = (np.zeros((n_stops, own, size)), np.empty(n), np.empty(n))
    system = BundleSystem(0.0, *arrays, *rest)
    return system._replace(cost=_accumulate(common, state, data, scale, log_ghost, system))


@compiled
def _accumulate(
    common: FloatArray,
    state: FloatArray,
    data: BundlePaths,
    scale: FloatArray,
    log_ghost: float,
    system: BundleSystem,
) -> float:
    n_columns = data.size.max() + N_COMMON + 1
    difference, slope, by_rx = np.empty(3), np.empty((3, n_columns)), np.empty((3, 4))
    index, point, work = np.empty(n_columns, np.int64), np.empty(2), path_work(n_columns)
    w, wd, cost = np.empty((3, 3)), np.empty(3), 0.0
    for i in range(len(data.row)):
        row, factor = data.row[i], scale[data.of_set[i]]
        n = _linearise(i, common, state[row], data, difference, slope, by_rx, index, point, work)
        square = 0.0
        for a in range(3):
            wd[a] = 0.0
            for b in range(3):
                wd[a] += data.weight[i, a, b] / factor * difference[b]
            square += wd[a] * difference[a]
        share, log_total = inlier_share(data.log_norm[i] - 1.5 * np.log(factor) - 0.5 * square, log_ghost)
        system.share[i], system.square[i] = share, square
        cost -= log_total
        for a in range(3):
            wd[a] *= share
            for b in range(3):
                w[a, b] = share / factor * data.weight[i, a, b]
        _add_path(row, data.column[i], index[:n], slope, by_rx, w, wd, system)
    return cost


@compiled
def _add_path(
    row: int,
    column: IntArray,
    index: IntArray,
    slope: FloatArray,
    by_rx: FloatArray,
    w: FloatArray,
    wd: FloatArray,
    system: BundleSystem,
) -> None:
    """Add the products of one path: `w` (3, 3) is its weight, `wd` (3,) that times its difference."""
    weighted = np.empty(3)
    for j in range(len(index)):
        for a in range(3):
            weighted[a] = w[a, 0] * slope[0, j] + w[a, 1] * slope[1, j] + w[a, 2] * slope[2, j]
            system.common_gradient[index[j]] -= slope[a, j] * wd[a]
        for k in range(len(index)):
            for a in range(3):
                system.common[index[j], index[k]] += weighted[a] * slope[a, k]
        for c in range(4):
            for a in range(3):
                system.cross[row, column[c], index[j]] += by_rx[a, c] * weighted[a]
    for c in range(4):
        for a in range(3):
            weighted[a] = w[a, 0] * by_rx[0, c] + w[a, 1] * by_rx[1, c] + w[a, 2] * by_rx[2, c]
            system.stop_gradient[row, column[c]] -= by_rx[a, c] * wd[a]
        for e in range(4):
            for a in range(3):
                system.stop[row, column[c], column[e]] += weighted[a] * by_rx[a, e]


@compiled
def absorbed_variance(
    common: FloatArray,
    state: FloatArray,
    data: BundlePaths,
    covariance: FloatArray,
    coupled: FloatArray,
    rx_covariance: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Differences (path, 3) and the variances (path, 3) of the predictions, J S J' with S that of all unknowns.

    `covariance` (common, common), `coupled` (stop, state, common) and `rx_covariance` (stop, state, state) are
    blocks of S.
    """
    n_columns = data.size.max() + N_COMMON + 1
    slope, by_rx = np.empty((3, n_columns)), np.empty((3, 4))
    index, point, work = np.empty(n_columns, np.int64), np.empty(2), path_work(n_columns)
    difference, variance = np.empty((len(data.row), 3)), np.zeros((len(data.row), 3))
    for i in range(len(data.row)):
        row, column = data.row[i], data.column[i]
        n = _linearise(i, common, state[row], data, difference[i], slope, by_rx, index, point, work)
        for a in range(3):
            for j in range(n):
                for k in range(n):
                    variance[i, a] += slope[a, j] * covariance[index[j], index[k]] * slope[a, k]
                for c in range(4):
                    variance[i, a] += 2 * by_rx[a, c] * coupled[row, column[c], index[j]] * slope[a, j]
            for c in range(4):
                for e in range(4):
                    variance[i, a] += by_rx[a, c] * rx_covariance[row, column[c], column[e]] * by_rx[a, e]
    return difference, variance


@compiled
def _linearise(
    i: int,
    common: FloatArray,
    state: FloatArray,
    data: BundlePaths,
    difference: FloatArray,
    slope: FloatArray,
    by_rx: FloatArray,
    index: IntArray,
    point: FloatArray,
    work: tuple[FloatArray, FloatArray, FloatArray],
) -> int:
    """Write the difference (3,) of a path from its prediction, and the slopes of this by its unknowns.

    `slope` (3, unknown) are the slopes by the common unknowns `index` (unknown,), `by_rx` (3, 4) those by the
    state. Returns the number of unknowns.
    """
    k, tx, session = data.of_set[i], data.paths.tx[i], data.paths.session[i]
    own = np.empty(4)
    for c in range(4):
        own[c] = state[data.column[i, c]]
    first, m, predicted = data.first[k], data.size[k], work[0]
    if data.family[k] == LOS:
        los_path(tx, own, difference, by_rx)
    else:
        contour_path(data.family[k], common[first : first + m], tx, own, difference, by_rx, slope, point, work)
    for a in range(3):
        predicted[a] = difference[a]
    path_difference(data.paths.measured[i], predicted, common, session, difference)
    for j in range(m):
        index[j] = first + j
    index[m], index[m + 1], index[m + 2] = 0, 1, N_COMMON + session
    slope[:, m : m + 3] = 0.0
    slope[0, m] = slope[2, m + 1] = slope[1, m + 2] = 1.0
    return int(m) + 3
