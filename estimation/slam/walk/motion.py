"""The motion prior of a walk, compiled: smooth positions, slowly changing heading and clock bias.

The second difference of the position, split along and across the course, is Student-t; so are the steps of heading
and clock bias between stops, with 2 degrees of freedom.
"""

import numpy as np

from estimation.execution import compiled
from estimation.laws.plane import wrapped
from estimation.slam.config import TrajectoryConfig
from scenes.record import BoolArray, FloatArray

_DRIFT_FREEDOM = 2.0
_LEAP = 3.0  # usual steps from the middle of its neighbours: a walk that turns back is one step off
_LEAST_STEPS = 4  # of a walk: of fewer none is usual


def course_of(state: FloatArray) -> FloatArray:
    """Unit vectors (stop - 2, 2) from the stop before to the stop after; zero where these coincide."""
    step = state[2:, :2] - state[:-2, :2]
    return np.asarray(step / np.maximum(np.hypot(*step.T), 1e-9)[:, None])


def leaps(state: FloatArray) -> BoolArray:
    """Stops (stop,) far from the middle of their neighbours, for the steps of their walk (stop, state)."""
    is_far, step = np.zeros(len(state), bool), np.hypot(*np.diff(state[:, :2], axis=0).T)
    if len(step) >= _LEAST_STEPS:
        off = np.hypot(*np.diff(state[:, :2], 2, axis=0).T) / 2
        is_far = np.concatenate([step[:1], off, step[-1:]]) > _LEAP * np.median(step)
    return is_far


def motion_cost(state: FloatArray, course: FloatArray, config: TrajectoryConfig) -> float:
    """Minus the log-likelihood of a walk (stop, state), up to a constant."""
    return float(_cost(state, course, motion_scales(config), config.motion_degrees_of_freedom))


def add_motion(
    state: FloatArray,
    course: FloatArray,
    config: TrajectoryConfig,
    diagonal: FloatArray,
    gradient: FloatArray,
    *,
    as_expected: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Add the prior's information to diagonal blocks (stop, state, state) and gradient (stop, state), in place.

    Returns its coupling blocks to the next (stop - 1, state, state) and the second next stop. Each term has
    the weight of its Student-t law; `as_expected` it is at most the Fisher information of that law, which is
    what a covariance may count on: a small step is no proof of a small scale.
    """
    (n, size), freedom = state.shape, config.motion_degrees_of_freedom
    next1, next2 = np.zeros((max(n - 1, 0), size, size)), np.zeros((max(n - 2, 0), size, size))
    most = np.array([_fisher(freedom, 2), _fisher(_DRIFT_FREEDOM, 1)]) if as_expected else np.full(2, np.inf)
    _add(state, course, motion_scales(config), freedom, most, diagonal, gradient, next1, next2)
    return next1, next2


def _fisher(freedom: float, size: int) -> float:
    """Fisher information of the location of a Student-t law of unit scale, per component of a vector of `size`."""
    return (freedom + size) / (freedom + size + 2)


def motion_scales(config: TrajectoryConfig) -> FloatArray:
    """Scales along and across the course in m, of the heading in rad and of a clock bias in m."""
    return np.array(
        [config.along_track_std_m, config.cross_track_std_m, config.heading_step_rad, config.clock_step_m]
    )


@compiled
def _bend(state: FloatArray, course: FloatArray, scale: FloatArray, k: int) -> tuple[float, float]:
    """Second difference of the position about stop k + 1, along and across, over its scales."""
    x = state[k, 0] - 2 * state[k + 1, 0] + state[k + 2, 0]
    y = state[k, 1] - 2 * state[k + 1, 1] + state[k + 2, 1]
    cx, cy = course[k, 0], course[k, 1]
    return (cx * x + cy * y) / scale[0], (-cy * x + cx * y) / scale[1]


@compiled
def _drift(state: FloatArray, scale: FloatArray, k: int, axis: int) -> float:
    """Step of heading (axis 2) or a clock bias (3 and on) from stop k to the next over its scale."""
    step = state[k + 1, axis] - state[k, axis]
    return float((wrapped(step) if axis == 2 else step) / scale[min(axis, 3)])


@compiled
def _cost(state: FloatArray, course: FloatArray, scale: FloatArray, freedom: float) -> float:
    total = 0.0
    for k in range(len(state) - 2):
        along, across = _bend(state, course, scale, k)
        total += (freedom + 2) / 2 * np.log1p((along**2 + across**2) / freedom)
    for k in range(len(state) - 1):
        for axis in range(2, state.shape[1]):
            drift = _drift(state, scale, k, axis)
            total += (_DRIFT_FREEDOM + 1) / 2 * np.log1p(drift**2 / _DRIFT_FREEDOM)
    return total


@compiled
def _add(
    state: FloatArray,
    course: FloatArray,
    scale: FloatArray,
    freedom: float,
    most: FloatArray,
    diagonal: FloatArray,
    gradient: FloatArray,
    next1: FloatArray,
    next2: FloatArray,
) -> None:
    for k in range(len(state) - 1):
        for axis in range(2, state.shape[1]):
            drift = _drift(state, scale, k, axis)
            weight = min((_DRIFT_FREEDOM + 1) / (_DRIFT_FREEDOM + drift**2), most[1])
            information = weight / scale[min(axis, 3)] ** 2
            diagonal[k, axis, axis] += information
            diagonal[k + 1, axis, axis] += information
            next1[k, axis, axis] -= information
            gradient[k, axis] -= weight * drift / scale[min(axis, 3)]
            gradient[k + 1, axis] += weight * drift / scale[min(axis, 3)]
    sign = np.array([1.0, -2.0, 1.0])
    for k in range(len(state) - 2):
        along, across = _bend(state, course, scale, k)
        weight = min((freedom + 2) / (freedom + along**2 + across**2), most[0])
        cx, cy = course[k, 0], course[k, 1]
        a, b = cx / scale[0], cy / scale[0]
        c, d = -cy / scale[1], cx / scale[1]
        pull = (weight * (a * along + c * across), weight * (b * along + d * across))
        own = (weight * (a * a + c * c), weight * (a * b + c * d), weight * (b * b + d * d))
        for i in range(3):
            for p in range(2):
                gradient[k + i, p] += sign[i] * pull[p]
            for j in range(i, 3):
                target = diagonal[k + i] if j == i else (next1[k + i] if j == i + 1 else next2[k])
                for p in range(2):
                    for q in range(2):
                        target[p, q] += sign[i] * sign[j] * own[p + q]
