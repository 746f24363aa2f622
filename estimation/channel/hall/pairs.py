"""Agreement of two paths as versions of one plan path, under given heights and clock bias."""

from dataclasses import dataclass

import numpy as np

from estimation.channel.hall.paths import PlanPoints, RangedPaths
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

# Versions (pair of versions, 2) that two different paths of a plan path can be.
VERSION_PAIRS = np.array([(one, two) for one in range(5) for two in range(5) if one != two])
TAIL_SHARE, TAIL_SPREAD = 0.2, 3.0  # errors of paths with close neighbours exceed their covariances
WINDOW = np.array([1.5, 0.06, 0.06])  # plan length in m and azimuths in rad, where paths agree by chance
NEAR = np.array([3.0, 0.3, 0.3])  # no versions are further apart in these than this plus five deviations
LEAST_DENSITY = 1e-3  # of paths per m rad^2


@dataclass(frozen=True)
class Agreement:
    """Pairs (pair,) of paths of a stop, and how much better than by chance they agree.

    `ratio` (pair, pair of versions) is the density of their difference as these versions over that of unrelated
    paths. `difference` (pair, pair of versions, 3) and `covariance` (..., 3, 3) are those of their plan paths.
    `chance` (pair,) is the density of unrelated paths around the pair, per m rad^2.
    """

    one: IntArray
    two: IntArray
    ratio: FloatArray
    difference: FloatArray
    covariance: FloatArray
    chance: FloatArray


def agreement(paths: RangedPaths, points: PlanPoints) -> Agreement:
    """Every pair of paths, each once, that may be versions of one plan path."""
    one, two = np.triu_indices(len(paths), 1)
    turn = np.abs(wrap_angle(paths.azimuth_rad[one] - paths.azimuth_rad[two]))
    near = (turn < NEAR[1:] + 5 * np.sqrt(paths.variance[one, 1:3] + paths.variance[two, 1:3])).all(axis=1)
    one, two = one[near], two[near]
    first, second = VERSION_PAIRS.T
    difference = points.value[one][:, first] - points.value[two][:, second]
    difference[..., 1:] = wrap_angle(difference[..., 1:])
    possible = points.is_possible[one][:, first] & points.is_possible[two][:, second]
    inside = possible & (np.abs(difference) < WINDOW).all(axis=2)
    keep = inside.any(axis=1)
    one, two, difference, possible = one[keep], two[keep], difference[keep], possible[keep]
    covariance = points.covariance[one][:, first] + points.covariance[two][:, second]
    own, cross = points.slope[..., :3], paths.cross[one, two][:, None, :3, :3]
    common = own[one][:, first] @ cross @ own[two][:, second].swapaxes(2, 3)
    covariance = covariance - common - common.swapaxes(2, 3)
    chance = _chance_density(len(paths), one, two, inside[keep])[:, None]
    density = difference_density(difference, covariance)
    return Agreement(one, two, np.where(possible, density / chance, 0.0), difference, covariance, chance[:, 0])


def _chance_density(n_paths: int, one: IntArray, two: IntArray, inside: BoolArray) -> FloatArray:
    """Density (pair,) of unrelated paths around the pair, per m rad^2: paths come in clusters."""
    around = np.zeros(n_paths)
    for index in (one, two):
        np.add.at(around, index, inside.sum(axis=1) / len(VERSION_PAIRS))
    mean = around.mean() if n_paths else 0.0
    local = np.maximum(around[one], around[two])
    return np.asarray(np.maximum(np.maximum(local, mean) / np.prod(2 * WINDOW), LEAST_DENSITY))


def difference_density(difference: FloatArray, covariance: FloatArray) -> FloatArray:
    """Density (...) of differences (..., 3): Gaussian with wide tails."""
    root = np.linalg.cholesky(covariance)
    distance = np.square(np.linalg.solve(root, difference[..., None])[..., 0]).sum(axis=-1)
    norm = (2 * np.pi) ** 1.5 * np.einsum("...ii->...i", root).prod(axis=-1)
    core, tail = core_and_tail(distance)
    return np.asarray((core + tail) / norm)


def core_and_tail(distance: FloatArray, n_parameters: int = 3) -> tuple[FloatArray, FloatArray]:
    """The two parts (...) of that density over its norm, at squared Mahalanobis distances (...)."""
    tail = TAIL_SHARE / TAIL_SPREAD**n_parameters * np.exp(-0.5 * distance / TAIL_SPREAD**2)
    return (1 - TAIL_SHARE) * np.exp(-0.5 * distance), tail
