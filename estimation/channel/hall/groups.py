"""A plan path from its versions: weighted least squares over all that was observed of them.

The errors of versions that are not resolved from each other are correlated, and floor, ceiling and clock bias are
known only so well. Both count: a group of paths has one plan path, and within their covariance common heights and
a common clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimation.channel.hall.classes import FIRST, SIGHT, StopStates
from estimation.channel.hall.geometry import ELEVATION_SIGNS, HEIGHT_SLOPES, Version
from estimation.channel.hall.pairs import TAIL_SPREAD, VERSION_PAIRS, core_and_tail
from estimation.channel.hall.paths import ELEVATION_OUTLIER_DENSITY, RangedPaths, expected_elevation
from estimation.channel.hall.record import ClassPriors
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray

ELEVATION_STDS = 4.0  # beyond which an elevation counts as an outlier
EXACT_M2 = 1e-12  # variance of a height that is given without error
N_SHARED = 4  # heights of TX, receiver and ceiling, and the clock bias
TINY = np.finfo(float).tiny

Group = tuple[tuple[int, int], ...]  # paths, each with its version, in the order of the paths


@dataclass(frozen=True)
class Solved:
    """A group as versions of one plan path.

    Attributes
    ----------
    log_weight : log evidence with the priors of all states, against unrelated paths
    shift : (member, 5) of range in m, azimuths and elevations, from what was observed to what the plan path has
    covariance : (member, 5, 5) of what the plan path has
    """

    log_weight: float
    shift: FloatArray
    covariance: FloatArray


class Groups:
    """Groups of paths of one stop. `shared_m2` is the covariance (4, 4) of the heights and of the clock bias.

    `loose` (path,) is the log probability of a path without versions, and `agrees` (path, version, path, version)
    how much better than by chance two paths agree as two versions.
    """

    def __init__(
        self,
        paths: RangedPaths,
        states: StopStates,
        priors: ClassPriors,
        shared_m2: FloatArray,
        differences_m: FloatArray,
    ) -> None:
        self.paths, self.points = paths, states.points
        n, pairs, (first, second) = len(paths), states.pairs, VERSION_PAIRS.T
        self.agrees = np.zeros((n, len(Version), n, len(Version)))
        self.agrees[pairs.one[:, None], first, pairs.two[:, None], second] = pairs.ratio
        self.agrees[pairs.two[:, None], second, pairs.one[:, None], first] = pairs.ratio
        self.log_chance = np.zeros((n, n))
        self.log_chance[pairs.one, pairs.two] = self.log_chance[pairs.two, pairs.one] = np.log(pairs.chance)
        by_version = states.alone[:, FIRST:].copy()
        by_version[:, Version.LEVEL] += states.alone[:, SIGHT]
        self.log_version = np.log(np.maximum(by_version * priors.has_versions[FIRST:], TINY))
        self.loose = np.log(np.maximum(states.alone @ (1 - priors.has_versions), TINY))
        self.expected_rad = np.stack(
            [expected_elevation(self.points.value[..., 0], differences_m, end) for end in range(2)], axis=2
        )
        self.differences_m = differences_m
        self.prior = np.zeros((3 + N_SHARED, 3 + N_SHARED))
        self.prior[3:, 3:] = np.linalg.inv(shared_m2 + EXACT_M2 * np.eye(N_SHARED))
        self._solved: dict[Group, Solved] = {}

    def solve(self, group: Group) -> Solved:
        """The group solved, from memory if it was before."""
        if group not in self._solved:
            self._solved[group] = self._solve(group)
        return self._solved[group]

    def _solve(self, group: Group) -> Solved:
        members = [path for path, _ in group]
        observed, error, by_plan, by_shared = (
            np.concatenate(part) for part in zip(*(self._rows(group[0], *one) for one in group), strict=True)
        )
        slopes, noise = np.concatenate([by_plan, by_shared], axis=1), self._noise(members)
        fit = _least_squares(noise[np.ix_(observed, observed)], slopes[observed], error[observed], self.prior)
        core, tail = core_and_tail(np.asarray(fit.distance), int(observed.sum()) - 3)
        log_weight = fit.log_density + np.log(max(float(core + tail), TINY))
        n_outliers = self.paths.sees_elevation[members].sum() + 3 * len(group) - observed.sum()
        log_weight += n_outliers * np.log(ELEVATION_OUTLIER_DENSITY)
        if len(group) > 1:
            log_weight -= sum(self.solve((one,)).log_weight - self.log_version[one] for one in group)
            chance = self.log_chance[np.ix_(members, members)][~np.eye(len(group), dtype=bool)].mean()
            log_weight -= (len(group) - 1) * chance
        log_weight += sum(self.log_version[one] for one in group)
        spread = (core + TAIL_SPREAD**2 * tail) / max(float(core + tail), TINY)
        has = (spread * slopes @ fit.covariance @ slopes.T).reshape(len(group), 5, len(group), 5)
        shift = (slopes @ fit.value - error).reshape(-1, 5)
        return Solved(float(log_weight), shift, np.einsum("papb->pab", has))

    def _rows(
        self, first: tuple[int, int], path: int, version: int
    ) -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
        """What a path observes (5,), its errors (5,) at the plan path of the first, and their slopes."""
        plan, slope = self.points.value[path, version], self.points.slope[path, version]
        difference, signs = self.differences_m[version], ELEVATION_SIGNS[version]
        by_plan, by_shared = np.zeros((5, 3)), np.zeros((5, N_SHARED))
        by_plan[:3] = np.linalg.inv(slope[:, :3])
        heights = HEIGHT_SLOPES[version]
        by_shared[:3] = -by_plan[:3] @ np.column_stack([slope[:, 3:] * heights, -slope[:, 0]])
        square = plan[0] ** 2 + difference**2
        by_plan[3:, 0] = -signs * difference / square
        by_shared[3:, :3] = (signs * plan[0] / square)[:, None] * heights
        off = self.paths.elevation_rad[path] - self.expected_rad[path, version]
        apart = plan - self.points.value[first]
        apart[1:] = wrap_angle(apart[1:])
        error = by_plan @ apart + np.concatenate([np.zeros(3), off])
        near = np.abs(off) < ELEVATION_STDS * np.sqrt(self.paths.variance[path, 3:])
        return np.append([True] * 3, self.paths.sees_elevation[path] & near), error, by_plan, by_shared

    def _noise(self, members: list[int]) -> FloatArray:
        """Joint covariance of all parameters of some paths."""
        joint = self.paths.cross[np.ix_(members, members)].copy()
        joint[np.arange(len(members)), np.arange(len(members))] = self.paths.covariance[members]
        return np.asarray(joint.transpose(0, 2, 1, 3).reshape(5 * len(members), -1))


class _GroupFit(NamedTuple):
    """Plan path, heights and clock by least squares."""

    value: FloatArray
    covariance: FloatArray
    distance: float  # squared, of what was observed
    log_density: float  # of what was observed, over all plan paths, without the part of the distance


def _least_squares(noise: FloatArray, slopes: FloatArray, error: FloatArray, prior: FloatArray) -> _GroupFit:
    """The errors of observations explained, with a `prior` information on heights and clock."""
    try:
        root = np.linalg.cholesky(noise)
    except np.linalg.LinAlgError:  # correlations that cannot be: the group is none
        return _GroupFit(np.zeros(len(prior)), np.eye(len(prior)), np.inf, 0.0)
    slope, rest = np.linalg.solve(root, slopes), np.linalg.solve(root, error)
    information, shared = slope.T @ slope + prior, prior[3:, 3:]
    covariance = np.linalg.inv(information)
    value = covariance @ slope.T @ rest
    left = rest - slope @ value
    log_volume = np.log(np.diagonal(root)).sum() + 0.5 * np.linalg.slogdet(information)[1]
    log_volume += 0.5 * ((len(error) - 3) * np.log(2 * np.pi) - np.linalg.slogdet(shared)[1])
    return _GroupFit(
        np.asarray(value), np.asarray(covariance), float(left @ left + value @ prior @ value), float(-log_volume)
    )


def mixture(weight: FloatArray, mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (parameter,) and covariance of a mixture of weights (part,)."""
    centre = weight @ mean
    off = mean - centre
    return centre, np.einsum("g,gab->ab", weight, covariance + off[:, :, None] * off[:, None])
