"""Likelihood of an RX state given the paths of one stop, and its maximum; compiled.

A path that is no line of sight is a single bounce, a bounce off two walls, or clutter:

- A single bounce with eliminated IP gives one equation r = 0 for the state
  (`estimation.laws.plane.BounceEquation`). To first order r is Gaussian with variance g' R g, where g is its
  gradient by the measurement; here it is Student-t with that scale. Minimising the sum of r^2 / (g' R g) refines
  state and IPs jointly.
- Two perpendicular walls reverse a ray and two parallel walls keep its direction. Departure and arrival are then
  parallel, which is one equation for the heading.
- Clutter has any angles, and a range uniform over `clutter_width_m`; it is hardly shorter than the straight line.

States and derivatives are [x, y, heading, bias] in m, m, rad, m, with x and y relative to the TX.
"""

import math

import numpy as np

from estimation.execution import compiled
from estimation.laws.plane import los_path, wrapped
from estimation.slam.snapshot.path_table import LineOfSight, PathModel, PathTable
from scenes.record import FloatArray

# The density of IPs is uniform per octave of distance, and per area within this distance.
NEAR_M = 3.0
# Probability of clutter before the straight line, relative to other clutter.
EARLY_SHARE = 0.05
# No single bounce is beyond 20 standard deviations (squared: 400), no bounce off two walls beyond 6.
FAR_SINGLE, FAR_DOUBLE = 400.0, 36.0
MAX_ITERATIONS = 40
_STEP_LIMIT = (2.0, 2.0, 0.3, 4.0)  # of one iteration, in m, m, rad, m
_CONVERGED = 1e-6  # share of these limits; a Newton step squares the error

_TX = np.zeros(3)  # states are relative to it, departures in the world frame

# Columns of the work array: one row per path.
_VALUE, _SPREAD, _PEAK, _TILT, _TILT_PEAK, _CLUTTER, _JACOBIAN, _CURVATURE = 0, 1, 2, 3, 4, 5, 6, 10
N_COLUMNS = 13


@compiled
def log_likelihood(paths: PathTable, los: LineOfSight, model: PathModel, states: FloatArray) -> FloatArray:
    """Log-likelihood (state,) of all paths but the line of sight, relative to clutter alone."""
    result = np.zeros(len(states))
    work = np.empty((len(paths.range_m), N_COLUMNS))
    for k in range(len(states)):
        evaluate(paths, los, model, states[k], work)
        result[k] = log_gain(paths, work, work, model)
    return result


@compiled
def refine_states(
    paths: PathTable, los: LineOfSight, model: PathModel, start: FloatArray, max_iterations: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Climb from each state to its maximum, with variances and feasibility of the iterate.

    Newton steps use the exact second derivative of the mixture. Where it is not positive definite or a step does
    not improve, damped Gauss-Newton steps weight each path by its probability of being a single bounce.

    Returns
    -------
    state, information, log_likelihood, square
        (state, 4), (state, 4, 4), (state,) with the exponent of the line of sight, and (state, path) squared
        normalised residuals, infinite where a single bounce is infeasible.
    """
    n = len(paths.range_m)
    states, information = start.copy(), np.zeros((len(start), 4, 4))
    likelihood, square = np.zeros(len(start)), np.full((len(start), n), np.inf)
    work, ahead = np.empty((n, N_COLUMNS)), np.empty((n, N_COLUMNS))
    direct, slope = np.zeros(3), np.zeros((3, 4))
    for k in range(len(start)):
        _climb(paths, los, model, states[k], max_iterations, work, ahead)
        evaluate(paths, los, model, states[k], work)
        direct_residual(los, states[k], direct, slope)
        likelihood[k] = log_gain(paths, work, work, model) - 0.5 * square_of(direct)
        fisher(paths, work, model, slope, information[k])
        for j in range(n):
            if work[j, _PEAK] > 0.0:
                square[k, j] = work[j, _VALUE] ** 2 / work[j, _SPREAD] * model.degrees_of_freedom
    return states, information, likelihood, square


@compiled
def _climb(
    paths: PathTable,
    los: LineOfSight,
    model: PathModel,
    state: FloatArray,
    max_iterations: int,
    work: FloatArray,
    ahead: FloatArray,
) -> None:
    """Move a state (4,) to its maximum, in place; `work` and `ahead` are overwritten."""
    newton, gauss, gradient, lower = np.empty((4, 4)), np.empty((4, 4)), np.empty(4), np.empty((4, 4))
    direct, slope, step, trial = np.zeros(3), np.zeros((3, 4)), np.empty(4), np.empty(4)
    damping = 0.0
    evaluate(paths, los, model, state, work)
    for _ in range(max_iterations):
        direct_residual(los, state, direct, slope)
        before = derivatives(paths, work, model, direct, slope, newton, gauss, gradient)
        if damping > 0.0 or not _solve(newton, gradient, lower, step):
            for i in range(4):
                gauss[i, i] *= 1.0 + max(damping, 1e-9)
            if not _solve(gauss, gradient, lower, step):
                return
        size = 0.0
        for i in range(4):
            size = max(size, abs(step[i]) / _STEP_LIMIT[i])
        trial[:] = state - step / max(size, 1.0)
        evaluate(paths, los, model, trial, ahead)
        direct_residual(los, trial, direct, slope)
        if 0.5 * square_of(direct) - log_gain(paths, work, ahead, model) <= before + 1e-9:
            state[:] = trial
            work, ahead = ahead, work
            damping = damping / 10 if damping > 1e-6 else 0.0
        elif damping > 1e6:
            return
        else:
            damping = max(10 * damping, 1e-4)
        if size < _CONVERGED:
            return


@compiled
def evaluate(paths: PathTable, los: LineOfSight, model: PathModel, state: FloatArray, work: FloatArray) -> None:
    """Fill `work` with the terms of every path at a state; those of the line of sight are zero."""
    x, y, bias = state[0], state[1], state[3]
    sine, cosine = math.sin(0.5 * state[2]), math.cos(0.5 * state[2])
    distance = math.hypot(x, y)
    for j in range(len(work)):
        cov, own = paths.covariance[j], work[j]
        sin_s = paths.mean[j, 0] * cosine + paths.mean[j, 1] * sine
        cos_s = paths.mean[j, 1] * cosine - paths.mean[j, 0] * sine
        sin_d = paths.half[j, 0] * cosine + paths.half[j, 1] * sine
        cos_d = paths.half[j, 1] * cosine - paths.half[j, 0] * sine
        length = paths.range_m[j] - bias
        along, reach = x * cos_s + y * sin_s, length * cos_d
        by_dep, by_arr = -0.5 * (along + reach), -0.5 * (along - reach)
        value = -x * sin_s + y * cos_s + length * sin_d
        variance = sin_d * sin_d * cov[0, 0] + by_dep * by_dep * cov[1, 1] + by_arr * by_arr * cov[2, 2]
        variance += 2 * (sin_d * (by_dep * cov[0, 1] + by_arr * cov[0, 2]) + by_dep * by_arr * cov[1, 2])
        variance = max(variance, 1e-18)
        own[_VALUE], own[_SPREAD] = value, model.degrees_of_freedom * variance
        own[_JACOBIAN], own[_JACOBIAN + 1] = -sin_s, cos_s
        own[_JACOBIAN + 2], own[_JACOBIAN + 3] = by_arr, -sin_d
        own[_CURVATURE], own[_CURVATURE + 1], own[_CURVATURE + 2] = -0.5 * cos_s, -0.5 * sin_s, -0.5 * cos_d
        own[_PEAK] = 0.0
        slack = paths.slack_rad[j] * length * abs(sin_d)
        near = length > 0.0 and value * value <= FAR_SINGLE * variance
        if near and abs(along) <= abs(reach) + slack:
            own[_PEAK] = model.single_peak / math.sqrt(variance) * length**2 / (length**2 + NEAR_M**2)
        tilt = 2 * sin_d * cos_d  # sine of the angle between departure and arrival
        own[_TILT] = tilt if cos_d * cos_d > sin_d * sin_d else -tilt
        early = length + paths.early_m[j] < distance
        own[_TILT_PEAK] = 0.0 if early else model.double_peak / math.sqrt(paths.tilt_variance[j])
        own[_CLUTTER] = model.clutter_share * (EARLY_SHARE if early else 1.0)
    if los.path >= 0:
        own = work[los.path]
        own[_PEAK], own[_TILT_PEAK], own[_CLUTTER] = 0.0, 0.0, 1.0


@compiled
def _single(fixed: FloatArray, now: FloatArray, model: PathModel) -> float:
    """Density of a path as a single bounce; peak and scale of `fixed`, residual and feasibility of `now`."""
    if fixed[_PEAK] == 0.0 or now[_PEAK] == 0.0:
        return 0.0
    root = math.sqrt(fixed[_SPREAD] / (fixed[_SPREAD] + now[_VALUE] * now[_VALUE]))
    return float(fixed[_PEAK] * root ** (model.degrees_of_freedom + 1))


@compiled
def _double(peak: float, tilt: float, variance: float) -> float:
    """Density of a path as a bounce off two walls."""
    square = tilt * tilt / variance
    return float(peak * math.exp(-0.5 * square)) if square < FAR_DOUBLE else 0.0


@compiled
def log_gain(paths: PathTable, fixed: FloatArray, now: FloatArray, model: PathModel) -> float:
    """Log density of all paths over that of clutter of unit share; one logarithm for several paths."""
    total, product = 0.0, 1.0
    for j in range(len(now)):
        double = _double(fixed[j, _TILT_PEAK], now[j, _TILT], paths.tilt_variance[j])
        product *= fixed[j, _CLUTTER] + max(_single(fixed[j], now[j], model), double)
        if j % 8 == 7:
            total += math.log(product)
            product = 1.0
    return float(total + math.log(product))


@compiled
def direct_residual(los: LineOfSight, state: FloatArray, value: FloatArray, slope: FloatArray) -> None:
    """Whitened residuals (3,) of the line of sight and their derivatives (3, 4); zero without one."""
    if los.path < 0:
        return
    los_path(_TX, state, value, slope)
    value[0] = los.measured[0] - value[0]
    for i in (1, 2):
        value[i] = wrapped(los.measured[i] - value[i])
    for i in (2, 1, 0):  # the whitening is lower triangular
        value[i] *= los.whitening[i, i]
        slope[i] *= -los.whitening[i, i]
        for j in range(i):
            value[i] += los.whitening[i, j] * value[j]
            slope[i] -= los.whitening[i, j] * slope[j]


@compiled
def derivatives(
    paths: PathTable,
    work: FloatArray,
    model: PathModel,
    direct: FloatArray,
    slope: FloatArray,
    newton: FloatArray,
    gauss: FloatArray,
    gradient: FloatArray,
) -> float:
    """Minus the log-likelihood; in place its gradient, second derivative and the positive part of that (lower)."""
    newton[:], gauss[:], gradient[:] = 0.0, 0.0, 0.0
    freedom, likelihood, product = model.degrees_of_freedom, -0.5 * square_of(direct), 1.0
    for j in range(len(work)):
        own = work[j]
        spread = paths.tilt_variance[j]
        single, double = _single(own, own, model), _double(own[_TILT_PEAK], own[_TILT], spread)
        total = own[_CLUTTER] + max(single, double)
        product *= total
        if j % 8 == 7:
            likelihood += math.log(product)
            product = 1.0
        if double > single:
            share, pull = double / total, own[_TILT] / spread
            gradient[2] += share * pull
            gauss[2, 2] += share / spread
            newton[2, 2] += share / spread - share * (1 - share) * pull**2
        if single <= double:
            continue
        share, value = single / total, own[_VALUE]
        below = own[_SPREAD] + value * value
        pull = (freedom + 1) * value / below
        weight = share * (freedom + 1) / below
        bend = weight * (own[_SPREAD] - value * value) / below - share * (1 - share) * pull * pull
        for a in range(4):
            by_a = own[_JACOBIAN + a]
            gradient[a] += share * pull * by_a
            for b in range(a + 1):
                newton[a, b] += bend * by_a * own[_JACOBIAN + b]
                gauss[a, b] += weight * by_a * own[_JACOBIAN + b]
        newton[2, 0] += share * pull * own[_CURVATURE]
        newton[2, 1] += share * pull * own[_CURVATURE + 1]
        newton[3, 2] += share * pull * own[_CURVATURE + 2]
        newton[2, 2] -= 0.25 * share * pull * value
    for i in range(3):
        for a in range(4):
            gradient[a] += direct[i] * slope[i, a]
            for b in range(a + 1):
                newton[a, b] += slope[i, a] * slope[i, b]
                gauss[a, b] += slope[i, a] * slope[i, b]
    return float(-likelihood - math.log(product))


@compiled
def square_of(vector: FloatArray) -> float:
    """Squared length of a vector (3,)."""
    return float(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)


@compiled
def fisher(
    paths: PathTable, work: FloatArray, model: PathModel, slope: FloatArray, information: FloatArray
) -> None:
    """Information (4, 4) of the paths under Gaussian errors.

    Inverse variances times the asymptotic efficiency of the Student-t estimate (Huber, Robust Statistics,
    section 3.2): the weights themselves depend on the errors.
    """
    for i in range(3):
        for a in range(4):
            for b in range(4):
                information[a, b] += slope[i, a] * slope[i, b]
    for j in range(len(work)):
        own = work[j]
        spread = paths.tilt_variance[j]
        single, double = _single(own, own, model), _double(own[_TILT_PEAK], own[_TILT], spread)
        total = own[_CLUTTER] + max(single, double)
        if double > single:
            information[2, 2] += double / total / spread
            continue
        weight = single / total * model.efficiency * model.degrees_of_freedom / own[_SPREAD]
        for a in range(4):
            for b in range(4):
                information[a, b] += weight * own[_JACOBIAN + a] * own[_JACOBIAN + b]


@compiled
def _solve(matrix: FloatArray, right: FloatArray, lower: FloatArray, x: FloatArray) -> bool:
    """Solve for x (4,) by Cholesky from a lower triangle; False where the matrix is not positive definite."""
    for i in range(4):
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            if i > j:
                lower[i, j] = value / lower[j, j]
            elif value > 1e-14 * matrix[i, i]:
                lower[i, i] = math.sqrt(value)
            else:
                return False
    for i in range(4):
        x[i] = right[i]
        for k in range(i):
            x[i] -= lower[i, k] * x[k]
        x[i] /= lower[i, i]
    for i in range(3, -1, -1):
        for k in range(i + 1, 4):
            x[i] -= lower[k, i] * x[k]
        x[i] /= lower[i, i]
    return True
