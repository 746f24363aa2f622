"""Residuals of all paths of a campaign with derivatives, compiled, and their terms of the normal equations.

Every path in use has whitened residuals: three for the line of sight and for paths off shared landmarks, one for
a single bounce whose incidence point (IP) is eliminated. The IP may be off the surface of a landmark by its
roughness, in any direction.
"""

from dataclasses import dataclass

import numpy as np

from estimation.execution import compiled
from estimation.inference.least_squares import student_t_efficiency, student_t_log_peak
from estimation.laws.contour import closed_path
from estimation.laws.plane import bounce_gap_path, los_path, mirror_departure, state_columns, unit, wrapped
from estimation.laws.raised import PathHeights, raised_path
from estimation.laws.support import CIRCLE_BY_RADIUS
from estimation.laws.wall import wall_path
from estimation.slam.config import TrajectoryConfig
from estimation.slam.transmitters import transmitters_of
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState
from scenes.record import FloatArray, IntArray

_LOS, _BOUNCE, _OBJECT = PathClass.LOS, PathClass.BOUNCE, PathClass.OBJECT
_UNUSED, _LONE = PathClass.UNUSED, PathClass.LONE
_WALL, _DOUBLE, _RAISED = PathClass.WALL, PathClass.DOUBLE, PathClass.RAISED
N_SHARED = 5  # shared parameters a path depends on at most: the session's offset and two walls
_MIN_VARIANCE_M2 = 1e-18


@dataclass(frozen=True)
class Linearised:
    """Whitened residuals of all paths; unused residuals and parameters of a path are zero."""

    row: IntArray  # (path,) index of the stop
    columns: IntArray  # (path, 4) columns of the state of the stop that a path depends on
    clock_information: FloatArray  # (tx, tx) in m^-2 on the clock biases of every stop
    size: IntArray  # (path,) residuals: 0 of paths not in use, 1 or 3
    value: FloatArray  # (path, 3)
    by_state: FloatArray  # (path, 3, 4)
    by_shared: FloatArray  # (path, 3, 5)
    shared: IntArray  # (path, 5) columns of the shared parameters, -1 for none; the first is the offset

    def square(self) -> FloatArray:
        """Sum of squares (path,)."""
        return np.asarray(np.einsum("pd,pd->p", self.value, self.value))

    def log_density(self, freedom: float) -> FloatArray:
        """Log density (path,) of the measurements, in (m rad^2)^-1; minus infinity without three residuals.

        The determinant of the whitening is the product of its diagonal, which is in the derivatives over the clock
        bias, the offset of the TX heading and the heading.
        """
        diagonal = self.by_state[:, 0, 3] * self.by_shared[:, 1, 0] * self.by_state[:, 2, 2]
        is_whole = self.size == 3
        scale = np.log(np.abs(np.where(is_whole, diagonal, 1.0)))
        density = student_t_log_peak(freedom, 3) + scale - (freedom + 3) / 2 * np.log1p(self.square() / freedom)
        return np.where(is_whole, density, -np.inf)

    def weight(self, freedom: float) -> FloatArray:
        """Student-t weight (path,); 0 where not in use."""
        return np.asarray((self.size > 0) * (freedom + self.size) / (freedom + self.square()))

    def efficient_weight(self, freedom: float) -> FloatArray:
        """Mean weight (path,) under Gaussian errors; less at stops whose actual errors are larger.

        A stop whose paths agree with nothing knows little: its weights add up to no more than the actual ones.
        """
        by_size = np.array([0.0, student_t_efficiency(freedom, 1), 0.0, student_t_efficiency(freedom, 3)])
        expected = by_size[self.size]
        sums = [np.bincount(self.row, weight) for weight in (expected, self.weight(freedom))]
        share = np.minimum(1.0, sums[1] / np.maximum(sums[0], np.finfo(float).tiny))
        return np.asarray(expected * share[self.row])

    def cost(self, freedom: float) -> float:
        """Minus the Student-t log-likelihood, up to a constant."""
        return float(np.sum((self.size > 0) * (freedom + self.size) / 2 * np.log1p(self.square() / freedom)))


def linearise(seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig) -> Linearised:
    """Residuals of all paths at the present unknowns."""
    difference_m, boresight_rad = path_heights(seen)
    common_m = np.array([config.wall_roughness_m, config.object_roughness_m])
    parts = _linearise(
        seen.tx_rows,
        seen.measured,
        seen.covariance,
        link.kind,
        link.landmark,
        seen.states(now.state),
        now.offset_of(seen),
        now.offset_rad,
        now.walls,
        now.objects,
        now.raised,
        difference_m,
        boresight_rad,
        common_m * np.broadcast_to(link.rough, (len(seen.row),))[:, None],
        seen.is_mirrored,
    )
    columns = state_columns(seen.tx_of_path)
    return Linearised(seen.row, columns, transmitters_of(seen.tx).clock_information, *parts)


def path_heights(seen: Observations) -> PathHeights:
    """Heights of all paths; where they are not known there is no raised point that needs them."""
    n = len(seen.row)
    return PathHeights(np.zeros(n), np.full((n, 2), np.nan)) if seen.heights is None else seen.heights


@compiled
def _linearise(
    source: FloatArray,
    measured: FloatArray,
    covariance: FloatArray,
    kind: IntArray,
    landmark: IntArray,
    state: FloatArray,
    offset_of: IntArray,
    offset: FloatArray,
    walls: FloatArray,
    objects: FloatArray,
    raised: FloatArray,
    difference_m: FloatArray,
    boresight_rad: FloatArray,
    rough_m: FloatArray,
    is_mirrored: bool,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, IntArray]:
    n = len(state)
    size, shared = np.zeros(n, np.int64), np.full((n, N_SHARED), -1)
    value, by_state, by_shared = np.zeros((n, 3)), np.zeros((n, 3, 4)), np.zeros((n, 3, N_SHARED))
    seen, point = np.empty(3), np.empty(2)
    chain, cov = np.empty((2, 2)), np.empty((3, 3))
    work = np.zeros(3), np.zeros((2, 3)), np.empty((3, 2))
    for i in range(n):
        if kind[i] == _UNUSED or kind[i] == _LONE:
            continue
        tx, x = source[i], state[i]
        seen[:] = measured[i]
        seen[1] += offset[offset_of[i]]
        shared[i, 0] = offset_of[i]
        if kind[i] == _BOUNCE:
            size[i] = 1
            _bounce(tx, x, seen, covariance[i], value[i], by_state[i], by_shared[i])
            continue
        size[i], side = 3, 1.0
        cov[:] = covariance[i]
        if kind[i] == _LOS:
            los_path(tx, x, value[i], by_state[i])
            if is_mirrored:
                side = mirror_departure(offset[offset_of[i]], value[i], by_state[i])
        elif kind[i] == _OBJECT:
            circle = objects[landmark[i, 0]]
            by_circle = by_shared[i, :, 1:4]
            closed_path(CIRCLE_BY_RADIUS, circle, tx, x, value[i], by_state[i], by_circle, point, work)
            _number_columns(shared[i], len(offset) + walls.size + 3 * landmark[i, 0])
            # The centre replaces the IP: its directions from TX and RX are nearly the same.
            add_roughness(tx, x, circle[:2], rough_m[i, 1], cov)
        elif kind[i] == _RAISED:
            spot = raised[landmark[i, 0]]
            by_spot = by_shared[i, :, 1:4]
            raised_path(tx, x, spot, difference_m[i], boresight_rad[i], value[i], by_state[i], by_spot)
            _number_columns(shared[i], len(offset) + walls.size + objects.size + 3 * landmark[i, 0])
            add_roughness(tx, x, spot[:2], rough_m[i, 1], cov)
        else:
            bounces = 1 if kind[i] == _WALL else 2
            for b in range(bounces):
                chain[b] = walls[landmark[i, b]]
                shared[i, 1 + 2 * b] = len(offset) + 2 * landmark[i, b]
                shared[i, 2 + 2 * b] = shared[i, 1 + 2 * b] + 1
            by_wall = by_shared[i, :, 1 : 1 + 2 * bounces]
            wall_path(tx, x, chain[:bounces], value[i], by_state[i], by_wall, point)
            add_roughness(tx, x, point, rough_m[i, 0], cov)
        for a in range(3):
            value[i, a] = seen[a] - value[i, a]
            if a:
                value[i, a] = wrapped(value[i, a])
        by_shared[i, 1, 0] = -side
        _whiten(cov, value[i], by_state[i], by_shared[i])
    return size, value, by_state, by_shared, shared


@compiled
def _number_columns(shared: IntArray, first: int) -> None:
    """Write the columns of the three unknowns of a landmark, of which the first is `first`."""
    for a in range(3):
        shared[1 + a] = first + a


@compiled
def _bounce(
    tx: FloatArray,
    x: FloatArray,
    seen: FloatArray,
    covariance: FloatArray,
    value: FloatArray,
    by_state: FloatArray,
    by_shared: FloatArray,
) -> None:
    """The residual of `estimation.laws.plane.BounceEquation` over its standard deviation."""
    gap_by_state, by = np.empty(4), np.empty(3)
    gap, _, _ = bounce_gap_path(tx, x, seen, gap_by_state, by)
    variance = 0.0
    for i in range(3):
        for j in range(3):
            variance += by[i] * covariance[i, j] * by[j]
    scale = 1 / np.sqrt(max(variance, _MIN_VARIANCE_M2))
    value[0] = gap * scale
    by_state[0] = gap_by_state * scale
    by_shared[0, 0] = by[1] * scale


@compiled
def add_roughness(tx: FloatArray, x: FloatArray, point: FloatArray, rough_m: float, cov: FloatArray) -> None:
    """Add the effect of IP errors of `rough_m` in both directions to a covariance of the measurement, in place."""
    ux, uy, from_tx = unit(point[0] - tx[0], point[1] - tx[1])
    vx, vy, from_rx = unit(point[0] - x[0], point[1] - x[1])
    by_point = ((ux + vx, uy + vy), (-uy / from_tx, ux / from_tx), (-vy / from_rx, vx / from_rx))
    for i in range(3):
        for j in range(3):
            both = by_point[i][0] * by_point[j][0] + by_point[i][1] * by_point[j][1]
            cov[i, j] += rough_m**2 * both


@compiled
def _whiten(cov: FloatArray, value: FloatArray, by_state: FloatArray, by_shared: FloatArray) -> None:
    """Whiten differences and turn derivatives of the prediction into those of the residuals, in place."""
    cholesky3(cov)
    for i in range(3):
        for j in range(i):
            ratio = cov[i, j]
            value[i] -= ratio * value[j]
            for a in range(4):
                by_state[i, a] -= ratio * by_state[j, a]
            for p in range(N_SHARED):
                by_shared[i, p] -= ratio * by_shared[j, p]
        value[i] /= cov[i, i]
        for a in range(4):
            by_state[i, a] /= cov[i, i]
        for p in range(N_SHARED):
            by_shared[i, p] /= cov[i, i]
    for i in range(3):
        for a in range(4):
            by_state[i, a] = -by_state[i, a]
        for p in range(N_SHARED):
            by_shared[i, p] = -by_shared[i, p]


@compiled
def cholesky3(matrix: FloatArray) -> None:
    """Lower Cholesky factor of a matrix (3, 3), in place; the upper triangle is not changed."""
    for j in range(3):
        for i in range(j, 3):
            for k in range(j):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
            if i == j:
                matrix[j, j] = np.sqrt(matrix[j, j])
            else:
                matrix[i, j] /= matrix[j, j]


@compiled
def accumulate(
    row: IntArray,
    size: IntArray,
    weight: FloatArray,
    value: FloatArray,
    by_state: FloatArray,
    columns: IntArray,
    by_shared: FloatArray,
    shared: IntArray,
    diagonal: FloatArray,
    border: FloatArray,
    corner: FloatArray,
    gradient: FloatArray,
    shared_gradient: FloatArray,
) -> None:
    """Add weighted squares and products of all residuals to the blocks of an `ArrowSystem`, in place."""
    for i in range(len(row)):
        k = row[i]
        for d in range(size[i]):
            w = weight[i]
            for a in range(4):
                wa, at = w * by_state[i, d, a], columns[i, a]
                gradient[k, at] += wa * value[i, d]
                for b in range(4):
                    diagonal[k, at, columns[i, b]] += wa * by_state[i, d, b]
                for p in range(N_SHARED):
                    if shared[i, p] >= 0:
                        border[k, at, shared[i, p]] += wa * by_shared[i, d, p]
            for p in range(N_SHARED):
                if shared[i, p] < 0:
                    continue
                wp = w * by_shared[i, d, p]
                shared_gradient[shared[i, p]] += wp * value[i, d]
                for q in range(N_SHARED):
                    if shared[i, q] >= 0:
                        corner[shared[i, p], shared[i, q]] += wp * by_shared[i, d, q]
