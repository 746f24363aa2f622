"""The search for the maximum of the posterior of one contour, compiled: all of it is one call.

`estimation.shape.reflection.posterior` states the problem. A search repeats descents by Levenberg-Marquardt
(Madsen, Nielsen and Tingleff, "Methods for Non-Linear Least Squares Problems", 2004, section 3.2), with the
schedule of `estimation.inference.least_squares`. Information matrices are written in their lower triangle.
"""

from typing import NamedTuple

import numpy as np

from estimation.execution import compiled
from estimation.laws.contour import contour_path, path_work
from estimation.laws.plane import wrapped
from estimation.laws.support import HARMONICS
from estimation.shape.reflection.matrices import cholesky, inverse3, solve_lower
from scenes.record import FloatArray, IntArray

N_COMMON = 2  # the first offsets are of delay and arrival; those of departure, one per session, follow
CHI2_MEDIAN = 2.366  # of 3 degrees of freedom
FAR_OFF = 4.0  # squared errors over their expected median, above which the covariances are enlarged at first
_MAX_STEPS = 60
_CONVERGED_NAT = 1e-7
_ENLARGED_NAT = 1e-3  # where the covariances are enlarged: such an optimum is only the next start
_CONVERGED_VALUE = 1e-6
_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING, _DAMPING_FACTOR = 1e-3, 1e-9, 1e8, 10.0
_FLOOR = 1e-12  # added to the diagonal of a damped matrix, for parameters without information


class PathArrays(NamedTuple):
    """`Reflections` as arrays for compiled code."""

    measured: FloatArray  # (path, 3)
    covariance: FloatArray  # (path, 3, 3)
    tx: FloatArray  # (path, 3)
    rx_state: FloatArray  # (path, 4)
    rx_covariance: FloatArray  # (path, 4, 4)
    session: IntArray  # (path,)
    clock: IntArray  # (path,)
    log_specular: FloatArray  # (path,)


class GhostMixture(NamedTuple):
    """Logarithms of the share of paths off the contour and of the density of ghosts; whether poses are exact."""

    log_share: float
    log_ghost: float
    exact_pose: bool


class Terms(NamedTuple):
    """Gradient (unknown,) and information (unknown, unknown) at a point, and shares of the inliers (path,)."""

    gradient: FloatArray
    hessian: FloatArray
    inlier: FloatArray


@compiled
def search_posterior(
    family: int,
    n_parameters: int,
    value: FloatArray,
    mean: FloatArray,
    precision: FloatArray,
    evidence_precision: FloatArray,
    paths: PathArrays,
    mixture: GhostMixture,
    refreshes: int,
) -> tuple[float, FloatArray, FloatArray, bool]:
    """Parameters and offsets (unknown,) of the maximum near `value`, which is overwritten.

    Returns
    -------
    log_evidence, covariance, inlier, is_regular
        The log likelihood with the Laplace integral, without the density of the prior; the covariance (unknown,
        unknown); the shares (path,) of inliers; false where the information is singular.
    """
    n, size = len(paths.measured), len(value)
    weight, log_norm = np.empty((n, 3, 3)), np.empty(n)
    for _ in range(1 if mixture.exact_pose else refreshes):
        square = weigh_paths(family, value[:n_parameters], value[n_parameters:], paths, mixture, weight, log_norm)
        before = value.copy()
        first = np.median(square) / CHI2_MEDIAN
        rounds = int(np.ceil(np.log10(first))) + 1 if first > FAR_OFF else 1
        for k in range(rounds):
            is_last = k == rounds - 1
            scale = 1.0 if is_last else first ** (1.0 - k / (rounds - 1))
            tolerance = _CONVERGED_NAT if is_last else _ENLARGED_NAT
            _descend(
                family, n_parameters, value, mean, precision, paths, weight, log_norm, scale, mixture, tolerance
            )
        if np.max(np.abs(value - before)) < _CONVERGED_VALUE:
            break
    weigh_paths(family, value[:n_parameters], value[n_parameters:], paths, mixture, weight, log_norm)
    terms = Terms(np.zeros(size), np.zeros((size, size)), np.zeros(n))
    minus_log = _accumulate(family, n_parameters, value, paths, weight, log_norm, 1.0, mixture, terms)
    for j in range(size):
        terms.hessian[j, j] += evidence_precision[j]
    covariance = np.zeros((size, size))
    is_regular = cholesky(terms.hessian)
    log_evidence = np.nan
    if is_regular:
        log_evidence = 0.5 * size * np.log(2 * np.pi) - minus_log
        for j in range(size):
            log_evidence -= np.log(terms.hessian[j, j])
            covariance[j, j] = 1.0
            solve_lower(terms.hessian, covariance[j])
    return log_evidence, covariance, terms.inlier, is_regular


@compiled
def weigh_starts(
    family: int, starts: FloatArray, offset: FloatArray, paths: PathArrays, mixture: GhostMixture
) -> tuple[FloatArray, FloatArray]:
    """Squared distances and log normalisations (start, path) of contours (start, parameter), offsets alike."""
    n = len(paths.measured)
    square, log_norm, weight = np.empty((len(starts), n)), np.empty((len(starts), n)), np.empty((n, 3, 3))
    for k in range(len(starts)):
        square[k] = weigh_paths(family, starts[k], offset, paths, mixture, weight, log_norm[k])
    return square, log_norm


@compiled
def weigh_paths(
    family: int,
    parameter: FloatArray,
    offset: FloatArray,
    paths: PathArrays,
    mixture: GhostMixture,
    weight: FloatArray,
    log_norm: FloatArray,
) -> FloatArray:
    """Squared Mahalanobis distances (path,) from the predictions, the errors of the poses included.

    Writes the inverse covariances (path, 3, 3) and the log normalisations (path,) of the inliers.
    """
    n, m = len(paths.measured), len(parameter)
    value, by_rx, by_parameter, point = np.empty(3), np.empty((3, 4)), np.empty((3, m)), np.empty(2)
    work, difference, square = path_work(m), np.empty(3), np.empty(n)
    total, spread = np.empty((3, 3)), np.empty((3, 4))
    for i in range(n):
        contour_path(family, parameter, paths.tx[i], paths.rx_state[i], value, by_rx, by_parameter, point, work)
        total[:] = paths.covariance[i]
        if not mixture.exact_pose:
            _add_pose_errors(by_rx, paths.rx_covariance[i], spread, total)
        determinant = inverse3(total, weight[i])
        log_norm[i] = mixture.log_share + paths.log_specular[i] - 1.5 * np.log(2 * np.pi)
        log_norm[i] -= 0.5 * np.log(determinant)
        path_difference(paths.measured[i], value, offset, paths.session[i], difference)
        square[i] = 0.0
        for a in range(3):
            for b in range(3):
                square[i] += difference[a] * weight[i, a, b] * difference[b]
    return square


@compiled
def _descend(
    family: int,
    m: int,
    value: FloatArray,
    mean: FloatArray,
    precision: FloatArray,
    paths: PathArrays,
    weight: FloatArray,
    log_norm: FloatArray,
    scale: float,
    mixture: GhostMixture,
    tolerance: float,
) -> None:
    """Levenberg-Marquardt from `value` (unknown,), in place, with all covariances times `scale`.

    It ends where a step gains at most `tolerance`.
    """
    n, size = len(paths.measured), len(value)
    now = Terms(np.empty(size), np.empty((size, size)), np.empty(n))
    new = Terms(np.empty(size), np.empty((size, size)), np.empty(n))
    damped, trial, step = np.empty((size, size)), np.empty(size), np.empty(size)
    cost = _posterior(family, m, value, mean, precision, paths, weight, log_norm, scale, mixture, now)
    damping = _FIRST_DAMPING
    for _ in range(_MAX_STEPS):
        damped[:] = now.hessian
        for j in range(size):
            damped[j, j] += damping * now.hessian[j, j] + _FLOOR
        if not cholesky(damped):
            return
        step[:] = now.gradient
        solve_lower(damped, step)
        expected = 0.0
        for j in range(size):
            step[j] = -step[j]
            if family <= HARMONICS and 2 <= j < m:
                step[j] = min(max(step[j], -1.0), 1.0)
            expected -= now.gradient[j] * step[j]
            trial[j] = value[j] + step[j]
        trial_cost = _posterior(family, m, trial, mean, precision, paths, weight, log_norm, scale, mixture, new)
        if not trial_cost < cost and expected < tolerance:
            return
        gain = cost - trial_cost
        if gain >= 0:
            value[:] = trial
            now, new, cost = new, now, trial_cost
            if gain <= tolerance:
                return
            damping = max(damping / _DAMPING_FACTOR, _LEAST_DAMPING)
        else:
            if damping > _LARGEST_DAMPING:
                return
            damping *= _DAMPING_FACTOR


@compiled
def _posterior(
    family: int,
    m: int,
    value: FloatArray,
    mean: FloatArray,
    precision: FloatArray,
    paths: PathArrays,
    weight: FloatArray,
    log_norm: FloatArray,
    scale: float,
    mixture: GhostMixture,
    terms: Terms,
) -> float:
    """Minus the log posterior up to a constant; its `terms` are written."""
    cost = _accumulate(family, m, value, paths, weight, log_norm, scale, mixture, terms)
    for j in range(len(value)):
        away = value[j] - mean[j]
        cost += 0.5 * precision[j] * away * away
        terms.gradient[j] += precision[j] * away
        terms.hessian[j, j] += precision[j]
    return cost


@compiled
def _accumulate(
    family: int,
    m: int,
    value: FloatArray,
    paths: PathArrays,
    weight: FloatArray,
    log_norm: FloatArray,
    scale: float,
    mixture: GhostMixture,
    terms: Terms,
) -> float:
    """Minus the log likelihood with the covariances times `scale`; its `terms` are written."""
    gradient, hessian, inlier = terms
    parameter, offset = value[:m], value[m:]
    predicted, by_rx, by_parameter, point = np.empty(3), np.empty((3, 4)), np.empty((3, m)), np.empty(2)
    work, d, w, wd = path_work(m), np.empty(3), np.empty((3, 3)), np.empty(3)
    weighted = np.empty((3, m))
    gradient[:] = 0.0
    hessian[:] = 0.0
    cost, hot = 0.0, 1.5 * np.log(scale)
    for i in range(len(paths.measured)):
        contour_path(
            family, parameter, paths.tx[i], paths.rx_state[i], predicted, by_rx, by_parameter, point, work
        )
        session = paths.session[i]
        path_difference(paths.measured[i], predicted, offset, session, d)
        square = 0.0
        for a in range(3):
            wd[a] = (weight[i, a, 0] * d[0] + weight[i, a, 1] * d[1] + weight[i, a, 2] * d[2]) / scale
            square += wd[a] * d[a]
        share, log_total = inlier_share(log_norm[i] - hot - 0.5 * square, mixture.log_ghost)
        inlier[i] = share
        cost -= log_total
        for a in range(3):
            for b in range(3):
                w[a, b] = share / scale * weight[i, a, b]
            wd[a] *= share
        for j in range(m):
            for a in range(3):
                weighted[a, j] = (
                    w[a, 0] * by_parameter[0, j] + w[a, 1] * by_parameter[1, j] + w[a, 2] * by_parameter[2, j]
                )
                gradient[j] -= wd[a] * by_parameter[a, j]
            for k in range(j + 1):
                for a in range(3):
                    hessian[j, k] += weighted[a, j] * by_parameter[a, k]
        # An offset adds to one quantity: delay, arrival or the departures of a session.
        delay, arrival, departure = m, m + 1, m + N_COMMON + session
        for j in range(m):
            hessian[delay, j] += weighted[0, j]
            hessian[arrival, j] += weighted[2, j]
            hessian[departure, j] += weighted[1, j]
        hessian[delay, delay] += w[0, 0]
        hessian[arrival, delay] += w[2, 0]
        hessian[arrival, arrival] += w[2, 2]
        hessian[departure, delay] += w[1, 0]
        hessian[departure, arrival] += w[1, 2]
        hessian[departure, departure] += w[1, 1]
        gradient[delay] -= wd[0]
        gradient[arrival] -= wd[2]
        gradient[departure] -= wd[1]
    return cost


@compiled
def inlier_share(log_inlier: float, log_ghost: float) -> tuple[float, float]:
    """Share of the contour in the density of a path that is a ghost otherwise, and the log of the density."""
    top = max(log_inlier, log_ghost)
    log_total = top + np.log(np.exp(log_inlier - top) + np.exp(log_ghost - top))
    return np.exp(log_inlier - log_total), log_total


@compiled
def path_difference(
    measured: FloatArray, predicted: FloatArray, offset: FloatArray, session: int, difference: FloatArray
) -> None:
    """Write measured minus predicted (3,), with the offsets, the azimuths wrapped."""
    difference[0] = measured[0] - predicted[0] - offset[0]
    difference[1] = wrapped(measured[1] - predicted[1] - offset[N_COMMON + session])
    difference[2] = wrapped(measured[2] - predicted[2] - offset[1])


@compiled
def _add_pose_errors(by_rx: FloatArray, rx_covariance: FloatArray, spread: FloatArray, total: FloatArray) -> None:
    """Add the covariance of the predictions (3, 3) due to that of the RX state (4, 4)."""
    for a in range(3):
        for k in range(4):
            spread[a, k] = 0.0
            for j in range(4):
                spread[a, k] += by_rx[a, j] * rx_covariance[j, k]
    for a in range(3):
        for b in range(3):
            for k in range(4):
                total[a, b] += spread[a, k] * by_rx[b, k]
