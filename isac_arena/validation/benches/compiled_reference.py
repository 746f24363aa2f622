"""The published snapshot SLAM, compiled as its authors' C is: the work beside which our solvers are timed.

Kaltiokallio et al., arXiv 2404.10291, restated in our own words. As in the published C: all minimal sets at each
of 361 headings; the matrices of a path once per heading; sums over all paths by a flag; the state from the inverse
of its normal matrix, by elimination with pivoting; a set that is not feasible, or has too few inliers, ends there;
all in double precision on one core. Nothing else is skipped. Ours alone: small products are written out, so that
the compiler needs no calls for them, and the best state is kept where the C stores the results of all sets. Both
make this one faster than the C. With nine paths a search without line of sight takes 6 ms on one core of a server;
published are 6.0 ms.

The results are those of `estimation.slam.snapshot.reference`, which is written with NumPy.
"""

import math
from typing import NamedTuple

import numpy as np

from estimation.execution import compiled
from estimation.slam.config import SnapshotConfig
from estimation.slam.snapshot.problem import MIN_LOS_INLIERS, SnapshotProblem, path_subsets
from estimation.slam.snapshot.reference import PARALLEL_GATE, los_heading
from scenes.record import BoolArray, FloatArray, IntArray


class _Terms(NamedTuple):
    """Matrices of the paths at one heading: H z - mu = gamma (tau - B) eta."""

    h: FloatArray  # (path, 2, 3)
    mu: FloatArray  # (path, 2) in m
    eta: FloatArray  # (path, 2); zero for a line of sight
    unit: FloatArray  # (path, 2), eta over its length
    normal: FloatArray  # (path, 3, 3), g H'QH
    right: FloatArray  # (path, 3), g H'Q mu


def published_state(problem: SnapshotProblem, config: SnapshotConfig) -> FloatArray:
    """State (4,) by the published order: with the line of sight where it is credible, else without.

    x, y in m, heading in rad, clock bias in m; NaN where no hypothesis is feasible.
    """
    state, n_inliers = los_state(problem, config)
    distance_m = math.hypot(state[0] - problem.tx.position_m[0], state[1] - problem.tx.position_m[1])
    power_dbm = float(problem.power_dbm[problem.earliest])
    if n_inliers >= MIN_LOS_INLIERS and config.path_loss.is_credible(power_dbm, distance_m):
        return state
    return nlos_state(problem, config)


def los_state(problem: SnapshotProblem, config: SnapshotConfig) -> tuple[FloatArray, int]:
    """State (4,) with the earliest path as line of sight, over all pairs with another path, and its inliers."""
    first = problem.earliest
    others = np.delete(np.arange(len(problem)), first)
    pairs = np.column_stack([np.full_like(others, first), others])
    return _searched(problem, config, np.array([los_heading(problem)]), pairs, first)


def nlos_state(problem: SnapshotProblem, config: SnapshotConfig) -> FloatArray:
    """State (4,) from single bounces alone, over all quadruples at all headings of the grid."""
    headings = np.linspace(-np.pi, np.pi, config.n_headings)
    return _searched(problem, config, headings, path_subsets(np.arange(len(problem)), 4), -1)[0]


def _searched(
    problem: SnapshotProblem, config: SnapshotConfig, headings: FloatArray, sets: IntArray, los: int
) -> tuple[FloatArray, int]:
    tx = np.array([*problem.tx.position_m[:2], problem.tx.heading_rad])
    gain = 10 ** (problem.power_dbm / 10)
    return _search(tx, problem.measured, gain, headings, sets, los, config.gate_m2)


@compiled
def _search(
    tx: FloatArray,
    measured: FloatArray,
    gain: FloatArray,
    headings: FloatArray,
    sets: IntArray,
    los: int,
    gate_m2: float,
) -> tuple[FloatArray, int]:
    """State (4,) of the least cost and its number of inliers; `los` is the line of sight, -1 for none."""
    n, size = len(gain), sets.shape[1]
    terms = _Terms(
        np.zeros((n, 2, 3)), np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 3, 3)),
        np.empty((n, 3)),
    )  # fmt: skip
    matrix, z, square, inlier = np.empty((3, 6)), np.empty(3), np.empty(n), np.empty(n, np.bool_)
    best, least, most = np.full(4, np.nan), np.inf, 0
    for heading in headings:
        _fill_terms(terms, tx, measured, gain, heading, los)
        for s in range(len(sets)):
            inlier[:] = False
            for k in range(size):
                inlier[sets[s, k]] = True
            if not _is_solved(terms, measured, inlier, matrix, z, square):
                continue
            found = 0
            for j in range(n):
                inlier[j] = square[j] <= gate_m2
                found += inlier[j]
            if found < size:
                continue
            if not _is_solved(terms, measured, inlier, matrix, z, square):
                continue
            cost = 0.0
            for j in range(n):
                cost += gain[j] * (square[j] if inlier[j] else gate_m2)
            if cost < least:
                least, most = cost, found
                best[0], best[1], best[2], best[3] = z[0], z[1], heading, z[2]
    return best, most


@compiled
def _is_solved(
    terms: _Terms, measured: FloatArray, inlier: BoolArray, matrix: FloatArray, z: FloatArray, square: FloatArray
) -> bool:
    """Whether the state of some paths, in place in `z`, is feasible; then `square` has the distances of all."""
    _solve(terms, inlier, matrix, z)
    if not _is_feasible(terms, measured, inlier, z):
        return False
    _fill_distances2(terms, z, square)
    return True


@compiled
def _fill_terms(
    terms: _Terms, tx: FloatArray, measured: FloatArray, gain: FloatArray, heading: float, los: int
) -> None:
    """Matrices of all paths at a heading; a line of sight has eta = 0, so that Q = I."""
    for j in range(len(gain)):
        h, mu, eta, unit = terms.h[j], terms.mu[j], terms.eta[j], terms.unit[j]
        departure, arrival = tx[2] + measured[j, 1], heading + measured[j, 2]
        vx, vy = math.cos(arrival), math.sin(arrival)
        h[0, 0], h[1, 1], h[0, 2], h[1, 2] = 1.0, 1.0, -vx, -vy
        mu[0], mu[1] = tx[0] - measured[j, 0] * vx, tx[1] - measured[j, 0] * vy
        eta[:], unit[:] = 0.0, 0.0
        if j != los:
            eta[0], eta[1] = math.cos(departure) + vx, math.sin(departure) + vy
            length = math.sqrt(eta[0] * eta[0] + eta[1] * eta[1])
            unit[0], unit[1] = eta[0] / length, eta[1] / length
        for a in range(3):
            # Row a of H'Q
            along = h[0, a] * unit[0] + h[1, a] * unit[1]
            x, y = h[0, a] - along * unit[0], h[1, a] - along * unit[1]
            for b in range(3):
                terms.normal[j, a, b] = gain[j] * (x * h[0, b] + y * h[1, b])
            terms.right[j, a] = gain[j] * (x * mu[0] + y * mu[1])


@compiled
def _solve(terms: _Terms, member: BoolArray, matrix: FloatArray, z: FloatArray) -> None:
    """State z = [x, y, B] of the normal equations of some paths, by the inverse; NaN where there is none.

    `matrix` (3, 6) is room for the normal matrix and its inverse.
    """
    r0 = r1 = r2 = 0.0
    matrix[:] = 0.0
    for j in range(len(member)):
        if member[j]:
            for a in range(3):
                for b in range(3):
                    matrix[a, b] += terms.normal[j, a, b]
            r0 += terms.right[j, 0]
            r1 += terms.right[j, 1]
            r2 += terms.right[j, 2]
    _invert(matrix)
    for a in range(3):
        z[a] = matrix[a, 3] * r0 + matrix[a, 4] * r1 + matrix[a, 5] * r2


@compiled
def _invert(matrix: FloatArray) -> None:
    """The left half (3, 3) is inverted into the right half; not finite where it is singular."""
    for a in range(3):
        matrix[a, 3 + a] = 1.0
    for a in range(3):
        pivot = a
        for b in range(a + 1, 3):
            if abs(matrix[b, a]) > abs(matrix[pivot, a]):
                pivot = b
        if pivot != a:
            for b in range(6):
                matrix[a, b], matrix[pivot, b] = matrix[pivot, b], matrix[a, b]
        scale = 1.0 / matrix[a, a]
        for b in range(a, 6):
            matrix[a, b] *= scale
        for other in range(3):
            if other != a:
                factor = matrix[other, a]
                for b in range(a, 6):
                    matrix[other, b] -= factor * matrix[a, b]


@compiled
def _is_feasible(terms: _Terms, measured: FloatArray, member: BoolArray, z: FloatArray) -> bool:
    """Whether no path is shorter than the clock bias, and the members' incidence points are between the devices.

    The rays of the earliest path may be too nearly opposite to tell.
    """
    first = 0
    for j in range(len(member)):
        if measured[j, 0] < measured[first, 0]:
            first = j
        if not measured[j, 0] >= z[2]:  # also where z is NaN
            return False
    for j in range(len(member)):
        if not member[j]:
            continue
        h, eta = terms.h[j], terms.eta[j]
        eta2 = eta[0] * eta[0] + eta[1] * eta[1]
        if j == first and eta2 < PARALLEL_GATE:
            continue
        x = h[0, 0] * z[0] + h[0, 1] * z[1] + h[0, 2] * z[2] - terms.mu[j, 0]
        y = h[1, 0] * z[0] + h[1, 1] * z[1] + h[1, 2] * z[2] - terms.mu[j, 1]
        share = (eta[0] * x + eta[1] * y) / ((measured[j, 0] - z[2]) * eta2)
        if not 0 <= share <= 1:
            return False
    return True


@compiled
def _fill_distances2(terms: _Terms, z: FloatArray, square: FloatArray) -> None:
    """Squared residuals |Q (H z - mu)|^2 (path,) in m^2 of all paths."""
    for j in range(len(square)):
        h, unit = terms.h[j], terms.unit[j]
        x = h[0, 0] * z[0] + h[0, 1] * z[1] + h[0, 2] * z[2] - terms.mu[j, 0]
        y = h[1, 0] * z[0] + h[1, 1] * z[1] + h[1, 2] * z[2] - terms.mu[j, 1]
        along = unit[0] * x + unit[1] * y
        x, y = x - along * unit[0], y - along * unit[1]
        square[j] = x * x + y * y
