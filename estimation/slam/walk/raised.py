"""Which compact landmarks are points at a height, at a given trajectory: ceilings and floors scatter as walls do.

With horizontal beams a point far above the devices looks like an object in the plane whose paths are a little too
long. As a circle it would pull the walk; as a point with a height of its own it helps.
"""

from dataclasses import replace

import numpy as np

from estimation.execution import compiled
from estimation.laws.raised import RAISED_STD_M
from estimation.slam.config import TrajectoryConfig
from estimation.slam.walk.linearise import linearise, path_heights
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState
from scenes.record import FloatArray, IntArray

_STARTS_M = (0.7, 2.0)  # heights above and below the middle of the devices that fits start from
_LEAST_GAIN = 5.0  # in log likelihood, for a height: it can only lengthen paths, so errors are taken for it
_STEPS = 20
_FIRST_DAMPING, _LESS, _MORE = 1e-3, 0.3, 10.0


def with_raised(
    seen: Observations, now: TrajectoryState, path: IntArray, member: IntArray, config: TrajectoryConfig
) -> TrajectoryState:
    """The landmarks with those objects as raised points that explain their paths better so.

    `member` (ip,) is the object of every path of `path` (ip,), -1 for none. Both kinds are fitted with the states
    held, and both have three unknowns: the one of less cost is kept. Between devices at equal heights a point
    below explains paths as well as one above, so none is tried.
    """
    mine = member >= 0
    own, of_object = seen.take(path[mine]), member[mine]
    n, difference_m = len(now.objects), path_heights(own).difference_m
    middle = np.bincount(of_object, difference_m, n) / np.maximum(np.bincount(of_object), 1) / 2
    starts_m = [side * start for start in _STARTS_M for side in ((1, -1) if difference_m.any() else (1,))]
    prior = (config.object_radius_m, config.object_radius_std_m)
    _, cost = _fitted(own, now, of_object, now.objects, PathClass.OBJECT, prior, config)
    best, least, is_raised = np.zeros((n, 3)), cost, np.zeros(n, bool)
    for start in starts_m:
        spot = np.column_stack([now.objects[:, :2], middle + start])
        spot, cost = _fitted(own, now, of_object, spot, PathClass.RAISED, (0.0, RAISED_STD_M), config)
        is_less = cost < least - _LEAST_GAIN * ~is_raised
        best[is_less], least, is_raised = spot[is_less], np.minimum(cost, least), is_raised | is_less
    return replace(now, objects=now.objects[~is_raised], raised=best[is_raised])


def _fitted(
    own: Observations,
    now: TrajectoryState,
    landmark: IntArray,
    start: FloatArray,
    kind: PathClass,
    prior: tuple[float, float],
    config: TrajectoryConfig,
) -> tuple[FloatArray, FloatArray]:
    """Landmarks (landmark, 3) of one kind fitted to the paths of each with states held, and their costs.

    `prior` is mean and standard deviation of the third unknown. Levenberg-Marquardt, each landmark by itself.
    """
    n, freedom = len(start), config.degrees_of_freedom
    link = Association(np.full(len(landmark), kind), np.column_stack([landmark, np.full(len(landmark), -1)]))
    inverse = np.array([0.0, 0.0, prior[1] ** -2.0])

    def at(value: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Cost (landmark,), gradient (landmark, 3) and information (landmark, 3, 3)."""
        here = replace(now, objects=value) if kind == PathClass.OBJECT else replace(now, raised=value)
        lin = linearise(own, link, here, config)
        slope, weight = lin.by_shared[:, :, 1:4], lin.weight(freedom)
        information, gradient = np.tile(np.diag(inverse), (n, 1, 1)), (value - [0, 0, prior[0]]) * inverse
        cost = 0.5 * (value[:, 2] - prior[0]) ** 2 * inverse[2]
        _add_terms(landmark, weight, lin.value, slope, gradient, information)
        loss = (freedom + 3) / 2 * np.log1p(lin.square() / freedom)
        return cost + np.bincount(landmark, loss, n), gradient, information

    value, damping = start.copy(), np.full(n, _FIRST_DAMPING)
    cost, gradient, information = at(value)
    for _ in range(_STEPS):
        extra = damping[:, None] * np.diagonal(information, axis1=1, axis2=2) + 1e-9
        trial = value - np.linalg.solve(information + extra[:, :, None] * np.eye(3), gradient[..., None])[..., 0]
        found = at(trial)
        is_less = found[0] < cost
        damping = np.where(is_less, damping * _LESS, damping * _MORE)
        value = np.where(is_less[:, None], trial, value)
        cost = np.where(is_less, found[0], cost)
        gradient = np.where(is_less[:, None], found[1], gradient)
        information = np.where(is_less[:, None, None], found[2], information)
    return value, cost


@compiled
def _add_terms(
    landmark: IntArray,
    weight: FloatArray,
    value: FloatArray,
    slope: FloatArray,
    gradient: FloatArray,
    information: FloatArray,
) -> None:
    """Add the terms of whitened residuals (path, 3) with slopes (path, 3, 3) to their landmarks, in place."""
    for p in range(len(landmark)):
        own = landmark[p]
        for i in range(3):
            fall = 0.0
            for r in range(3):
                fall += weight[p] * slope[p, r, i] * value[p, r]
            gradient[own, i] += fall
            for j in range(3):
                product = 0.0
                for r in range(3):
                    product += weight[p] * slope[p, r, i] * slope[p, r, j]
                information[own, i, j] += product
