"""All objects, lines of sight, poses and offsets of a campaign in one sparse least-squares problem.

Unknowns are the parameters of every object, one delay and one arrival offset, one departure offset per session,
and the RX state of every stop, with the given states as its prior. A path depends on the state of its own stop
only. The states are therefore eliminated stop by stop, and a small dense system for objects and offsets remains
(Schur complement). Paths are weighted by their probability of not being ghosts, as in
`estimation.shape.reflection.posterior`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimation.inference.least_squares import Attempt, Schedule, minimise
from estimation.laws.plane import state_columns
from estimation.shape.config import ReflectionConfig
from estimation.shape.fit import ShapeFit, failed_fit
from estimation.shape.kinds.fit import object_kind
from estimation.shape.reflection.bundle_system import (
    LOS,
    BundlePaths,
    BundleSystem,
    absorbed_variance,
    bundle_system,
)
from estimation.shape.reflection.posterior import Optimum, Prior, with_offsets
from estimation.shape.reflection.reflections import Reflections, at_solution, prior_states
from estimation.shape.reflection.search import CHI2_MEDIAN, FAR_OFF, N_COMMON
from scenes.record import FloatArray, IntArray, concatenate

_MAX_STEPS = 40
_CONVERGED_NAT = 1e-6
_LEAST_VARIANCE_SHARE = 0.05  # of a residual over the stated variance, after what the fit absorbs
NORMAL_MEDIAN = 0.6745  # of the absolute value of a standard normal number


@dataclass(frozen=True)
class BundleObject:
    """The paths of one object and its kind, a key of `OBJECT_KINDS`.

    The radius prior of `prior` replaces that of the settings for this object.
    """

    kind: str
    paths: Reflections
    prior: ReflectionConfig | None = None

    def settings(self, config: ReflectionConfig) -> ReflectionConfig:
        """The settings with the priors of this object."""
        if self.prior is None:
            return config
        own = {"radius_median_m": self.prior.radius_median_m, "radius_log_std": self.prior.radius_log_std}
        return config.model_copy(update=own)


@dataclass(frozen=True)
class Bundle:
    """Shapes in the order of the objects, and the common unknowns."""

    shapes: tuple[ShapeFit, ...]
    inlier: tuple[FloatArray, ...]  # per object (path,) probability of not being a ghost
    offset: FloatArray  # (2 + session,) delay in m, arrivals, departures of each session in rad
    offset_covariance: FloatArray  # (2 + session, 2 + session)
    stop: IntArray  # (stop,) the stops that have paths
    rx_state: FloatArray  # (stop, state) x, y, heading, clock bias of every TX in m, m, rad, m
    rx_covariance: FloatArray  # (stop, state, state)
    noise_scale: FloatArray  # (3,) standard deviations of range, departures, arrivals over the stated ones

    @property
    def offset_std(self) -> FloatArray:
        """Standard deviations (2 + session,) of the offsets."""
        return np.sqrt(np.diagonal(self.offset_covariance))


class _BundlePoint(NamedTuple):
    common: FloatArray  # (common,)
    state: FloatArray  # (stop, state)
    system: BundleSystem


def fit_bundle(objects: Sequence[BundleObject], los: Reflections, config: ReflectionConfig) -> Bundle:
    """Fit all objects together; each starts from its own fit, and one whose own fit fails is not used.

    `los` holds the lines of sight in the same form as the reflections, with the same stops and sessions; it may
    be empty. States and their covariances are those of the first path of each stop, over objects in order, then
    `los`.

    Raises `ValueError` where the kind of an object is unknown.
    """
    kinds = [object_kind(each.kind) for each in objects]
    settings = [each.settings(config) for each in objects]
    starts = {
        k: start
        for k, each in enumerate(objects)
        if len(each.paths) and (start := kinds[k].optimum(each.paths, settings[k])) is not None
    }
    sets = [*(objects[k].paths for k in starts), los]
    n_offsets = N_COMMON + max(data.n_sessions for data in sets)
    offsets = with_offsets(Prior(*3 * [np.zeros(0)]), n_offsets - N_COMMON, config)
    priors = [offsets, *(kinds[k].prior(start.parameter, settings[k]) for k, start in starts.items())]
    family = [*(kinds[k].family for k in starts), LOS]
    common = np.concatenate([np.zeros(n_offsets), *(start.parameter for start in starts.values())])
    for start in starts.values():
        common[: len(start.offset)] = start.offset
    problem = _problem(sets, family, priors, config)
    common, state = problem.solve(common)
    return _solution(problem, common, state, objects, settings, list(starts))


def _problem(
    sets: Sequence[Reflections], family: Sequence[int], priors: Sequence[Prior], config: ReflectionConfig
) -> _Problem:
    """The problem of sets of paths, lines of sight last; priors are those of the offsets and of every object."""
    stop, prior_state, prior_weight = prior_states(sets)
    data = bundle_paths(sets, family, [len(prior.mean) for prior in priors], stop, config.log_path_share)
    mean, precision = (np.concatenate([getattr(each, name) for each in priors]) for name in ("mean", "precision"))
    return _Problem(data, stop, prior_state, prior_weight, mean, precision, config.log_ghost_density)


def bundle_paths(
    sets: Sequence[Reflections],
    family: Sequence[int],
    sizes: Sequence[int],
    stop: IntArray,
    log_share: float = 0.0,
) -> BundlePaths:
    """The paths of sets, lines of sight last, for the normal equations of a bundle.

    `sizes` are the numbers of offsets and of the parameters of every object, `stop` (stop,) the sorted stops.
    """
    every = concatenate(sets, "path")
    weight = np.asarray(np.linalg.inv(every.covariance), float)
    end = np.cumsum(sizes)
    return BundlePaths(
        every.arrays,
        weight,
        log_share - 1.5 * np.log(2 * np.pi) + 0.5 * np.linalg.slogdet(weight)[1],
        np.repeat(np.arange(len(sets)), [len(data) for data in sets]),
        np.searchsorted(stop, every.stop),
        state_columns(every.clock),
        np.array(family, dtype=np.int64),
        end.astype(np.int64),
        np.append(np.diff(end), 0).astype(np.int64),
    )


def _solution(
    problem: _Problem,
    common: FloatArray,
    state: FloatArray,
    objects: Sequence[BundleObject],
    settings: Sequence[ReflectionConfig],
    started: Sequence[int],
) -> Bundle:
    """Shapes and covariances at the solution; `started` are the objects in it."""
    data, system = problem.data, problem.system(common, state, np.ones(len(problem.data.family)))
    reduced, _, cross = system.schur(0.0)
    own, covariance = np.asarray(np.linalg.inv(system.stop)), np.asarray(np.linalg.inv(reduced))
    coupled = -cross @ covariance
    rx_covariance = own - coupled @ np.swapaxes(cross, 1, 2)
    n_offsets = int(data.first[0])
    shapes = [failed_fit(each.kind, "no start") for each in objects]
    inlier = [np.zeros(0) for _ in objects]
    for k, name in enumerate(started):
        own_span = np.arange(data.first[k], data.first[k] + data.size[k])
        index = np.append(own_span, np.arange(n_offsets))
        inlier[name] = system.share[data.of_set == k]
        found = Optimum(
            common[own_span], common[:n_offsets], covariance[np.ix_(index, index)], np.nan, inlier[name]
        )
        paths = at_solution(objects[name].paths, problem.stop, state, rx_covariance)
        shapes[name] = object_kind(objects[name].kind).shape(found, paths, settings[name])
    size, absorbed = absorbed_variance(common, state, data, covariance, coupled, rx_covariance)
    return Bundle(
        shapes=tuple(shapes),
        inlier=tuple(inlier),
        offset=common[:n_offsets],
        offset_covariance=covariance[:n_offsets, :n_offsets],
        stop=problem.stop,
        rx_state=state,
        rx_covariance=rx_covariance,
        noise_scale=_noise_scale(size, absorbed, data.paths.covariance, system.share),
    )


@dataclass(frozen=True)
class _Problem:
    data: BundlePaths
    stop: IntArray  # (stop,)
    prior_state: FloatArray  # (stop, state)
    prior_weight: FloatArray  # (stop, state, state)
    prior_mean: FloatArray  # (common,)
    prior_precision: FloatArray  # (common,)
    log_ghost: float

    def solve(self, common: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Common unknowns and states at the minimum.

        The own fits absorbed offsets, and given states have errors, so an object may start where all its paths
        are ghosts to it. The covariances of such paths are therefore enlarged at first and reduced step by step.
        """
        state = self.prior_state
        for scale in self._cooling(common, state):
            common, state = self._descend(common, state, scale)
        return common, state

    def _cooling(self, common: FloatArray, state: FloatArray) -> FloatArray:
        """Factors (round, set) on the covariances of objects and, last, of lines of sight.

        With the first factors half of the squared errors of a set are below the expected median.
        """
        first = np.ones(len(self.data.family))
        square = self.system(common, state, first).square
        for k in range(len(first)):
            if len(own := square[self.data.of_set == k]):
                first[k] = float(np.median(own)) / CHI2_MEDIAN
        first = np.where(first > FAR_OFF, first, 1.0)
        rounds = int(np.ceil(np.log10(first.max()))) + 1
        return np.asarray(first ** np.linspace(1.0, 0.0, rounds)[:, None] if rounds > 1 else [np.ones(len(first))])

    def _descend(self, common: FloatArray, state: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The minimum from a start, by Levenberg-Marquardt, with covariances times `scale` (set,)."""

        def attempt(at: _BundlePoint, damping: float) -> Attempt[_BundlePoint]:
            reduced, own, cross = at.system.schur(damping)
            right = at.system.common_gradient - own.ravel() @ at.system.cross.reshape(-1, len(at.common))
            step = -np.linalg.solve(reduced, right)
            common, state = at.common + step, at.state - own - cross @ step
            trial = _BundlePoint(common, state, self.system(common, state, scale))
            return Attempt(trial, at.system.cost, trial.system.cost)

        start = _BundlePoint(common, state, self.system(common, state, scale))
        found = minimise(start, attempt, Schedule(_MAX_STEPS, largest=1e6, absolute=_CONVERGED_NAT))
        return found.common, found.state

    def system(self, common: FloatArray, state: FloatArray, scale: FloatArray) -> BundleSystem:
        """Cost and normal equations at common unknowns (common,) and states (stop, state), priors included."""
        system = bundle_system(common, state, self.data, scale, self.log_ghost)
        shift, away = common - self.prior_mean, state - self.prior_state
        pull = np.einsum("sij,sj->si", self.prior_weight, away)
        index = np.arange(len(common))
        system.common_gradient[:] += self.prior_precision * shift
        system.common[index, index] += self.prior_precision
        system.stop_gradient[:] += pull
        system.stop[:] += self.prior_weight
        added = 0.5 * float(np.sum(self.prior_precision * shift**2) + np.sum(away * pull))
        return system._replace(cost=system.cost + added)


def _noise_scale(
    difference: FloatArray, absorbed: FloatArray, covariance: FloatArray, share: FloatArray
) -> FloatArray:
    """Median absolute differences (3,) over those expected after the fit absorbed a part of the noise.

    The residual of a path has the covariance R - J S J', S that of all unknowns (Foerstner 1979, variance
    components). The median ignores ghosts and objects of unusual noise. NaN without a path.
    """
    stated = np.diagonal(covariance, axis1=1, axis2=2)
    expected = np.maximum(stated - absorbed, _LEAST_VARIANCE_SHARE * stated)
    size = (np.abs(difference) / np.sqrt(expected))[share > 0.5]
    return np.median(size, axis=0) / NORMAL_MEDIAN if len(size) else np.full(3, np.nan)
