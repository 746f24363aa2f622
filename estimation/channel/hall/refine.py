"""Gauss-Newton step of heights and clock biases, with the states of all paths given.

Versions of one plan path have equal plan lengths and azimuths; observed elevations and the power of the line of
sight add their part. A pair counts with its probability. In a group of m versions every path is in m - 1 pairs,
and its pairs together count m / 2 times too much, so each is divided by that.
"""

from dataclasses import dataclass

import numpy as np

from estimation.channel.hall.classes import SIGHT, StopStates, version_probabilities
from estimation.channel.hall.geometry import ELEVATION_SIGNS, HEIGHT_SLOPES
from estimation.channel.hall.pairs import TAIL_SPREAD, VERSION_PAIRS, core_and_tail
from estimation.channel.hall.paths import ELEVATION_OUTLIER_DENSITY, RangedPaths, expected_elevation
from estimation.channel.hall.power import SIGHT_STD_DB, StopPowers
from scenes.record import FloatArray

SMALL_M = 1e-3  # step of numerical slopes of powers
LEAST_WEIGHT = 1e-3  # of pairs that count


@dataclass(frozen=True)
class Equations:
    """Normal equations (4, 4) and (4,) of heights of TX, receiver and ceiling, and of the clock bias, all in m."""

    information: FloatArray
    slope: FloatArray


def stop_equations(
    paths: RangedPaths,
    powers: StopPowers,
    states: StopStates,
    clock_m: float,
    differences_m: FloatArray,
    *,
    by_elevation: bool,
) -> Equations:
    """The part of one stop. Without `by_elevation` the elevations tell nothing of heights and clock.

    An array that points a little too high is wrong about all of them: not so the heights that were surveyed.
    """
    parts = [_pair_rows(states), _sight_rows(paths, powers, states, clock_m, differences_m)]
    if by_elevation:
        parts.append(_elevation_rows(paths, states, clock_m, differences_m))
    information, slope = np.zeros((4, 4)), np.zeros(4)
    for jacobian, error, weight in parts:
        information += np.einsum("ria,rij,rjb->ab", jacobian, weight, jacobian)
        slope -= np.einsum("ria,rij,rj->a", jacobian, weight, error)
    return Equations(information, slope)


Rows = tuple[
    FloatArray, FloatArray, FloatArray
]  # Jacobian (row, part, 4), error (row, part), weight (row, part, part)


def _pair_rows(states: StopStates) -> Rows:
    pairs = states.pairs
    row, kind = np.nonzero(states.weight > LEAST_WEIGHT)
    weight, error, covariance = states.weight[row, kind], pairs.difference[row, kind], pairs.covariance[row, kind]
    one, two = pairs.one[row], pairs.two[row]
    first, second = VERSION_PAIRS[kind].T
    size = np.ones(len(states.probability))
    np.add.at(size, one, weight)
    np.add.at(size, two, weight)
    slopes = states.points.slope
    jacobian = np.zeros((len(row), 3, 4))
    jacobian[:, :, 3] = slopes[two, second, :, 0] - slopes[one, first, :, 0]
    jacobian[:, :, :3] = slopes[one, first, :, 3, None] * HEIGHT_SLOPES[first][:, None]
    jacobian[:, :, :3] -= slopes[two, second, :, 3, None] * HEIGHT_SLOPES[second][:, None]
    inverse = np.linalg.inv(covariance)
    distance = np.einsum("ri,rij,rj->r", error, inverse, error)
    core, tail = core_and_tail(distance)
    share = (core + tail / TAIL_SPREAD**2) / np.maximum(core + tail, 1e-300)
    scale = weight * share * 4 / (size[one] + size[two])
    return jacobian, error, inverse * scale[:, None, None]


def _elevation_rows(paths: RangedPaths, states: StopStates, clock_m: float, differences_m: FloatArray) -> Rows:
    """Elevations observed at both ends, as every version."""
    length = np.maximum(paths.range_m - clock_m, SMALL_M)[:, None]
    plan = states.points.value[..., 0]
    probability = version_probabilities(states.probability)
    jacobians, errors, weights = [], [], []
    for end in range(2):
        sign = ELEVATION_SIGNS[:, end]
        error = expected_elevation(plan, differences_m, end) - paths.elevation_rad[:, None, end]
        variance = paths.variance[:, None, 3 + end]
        normal = np.exp(-0.5 * error**2 / variance) / np.sqrt(2 * np.pi * variance)
        inlier = normal / (normal + ELEVATION_OUTLIER_DENSITY)
        by_height = (sign / plan)[..., None] * HEIGHT_SLOPES
        by_clock = sign * differences_m / (length * plan)
        use = states.points.is_possible & paths.sees_elevation[:, None, end]
        jacobians.append(np.concatenate([by_height, by_clock[..., None]], axis=2)[use])
        errors.append(error[use])
        weights.append((probability * inlier / variance)[use])
    return (
        np.concatenate(jacobians)[:, None],
        np.concatenate(errors)[:, None],
        np.concatenate(weights)[:, None, None],
    )


def _sight_rows(
    paths: RangedPaths, powers: StopPowers, states: StopStates, clock_m: float, differences_m: FloatArray
) -> Rows:
    """The power of the line of sight: its loss beyond free space is 0."""
    path = int(states.probability[:, SIGHT].argmax())
    one = np.array([path])

    def loss(clock: float, level_m: float) -> float:
        changed = differences_m.copy()
        changed[0] = level_m
        return float(powers.take(one).loss_db(paths.take(one), clock, changed)[0, 0])

    now, level = loss(clock_m, differences_m[0]), float(differences_m[0])
    by_clock = (loss(clock_m + SMALL_M, level) - loss(clock_m - SMALL_M, level)) / (2 * SMALL_M)
    by_level = (loss(clock_m, level + SMALL_M) - loss(clock_m, level - SMALL_M)) / (2 * SMALL_M)
    jacobian = np.append(by_level * HEIGHT_SLOPES[0], by_clock)
    weight = states.probability[path, SIGHT] / SIGHT_STD_DB**2
    return jacobian[None, None], np.array([[now]]), np.array([[[weight]]])
