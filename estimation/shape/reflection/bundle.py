"""All objects, lines of sight, poses and offsets of a campaign in one sparse least-squares problem.

Unknowns are the parameters of every object, one delay and one arrival offset, one departure offset per session,
and the RX state of every stop, with the given states as its prior. A path depends on the state of its own stop
only. The states are therefore eliminated stop by stop, and a small dense system for objects and offsets remains
(Schur complement). Paths are weighted by their probability of not being ghosts, as in
`estimation.shape.reflection.posterior`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from estimation.inference.least_squares import Attempt, Schedule, minimise
from estimation.laws.contour import predict_reflection
from estimation.laws.plane import los_jacobian_rx, predict_los
from estimation.shape.fit import ShapeFit, failed_fit
from estimation.shape.kinds.fit import object_kind
from estimation.shape.reflection.path_likelihood import N_COMMON, offset_residual
from estimation.shape.reflection.posterior import CHI2_MEDIAN, FAR_OFF, Optimum, Prior, with_offsets
from estimation.shape.reflection.reflections import ReflectionConfig, Reflections, at_solution, prior_states
from scenes.record import FloatArray, IntArray

_MAX_STEPS = 40
_CONVERGED_NAT = 1e-6
_LEAST_INFORMATION = 1e-8  # on an object that lost all its paths to ghosts, per square of m or rad
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
    rx_state: FloatArray  # (stop, 4) x, y, heading, clock bias in m, m, rad, m
    rx_covariance: FloatArray  # (stop, 4, 4)
    noise_scale: FloatArray  # (3,) standard deviations of range, departures, arrivals over the stated ones

    @property
    def offset_std(self) -> FloatArray:
        """Standard deviations (2 + session,) of the offsets."""
        return np.sqrt(np.diagonal(self.offset_covariance))


@dataclass(frozen=True)
class _ObjectBlock:
    """One object inside the problem."""

    family: int
    paths: Reflections
    row: IntArray  # (path,) of its stop
    span: slice  # of its parameters among the common unknowns, which start with the offsets
    prior: Prior


class _Residuals(NamedTuple):
    """Differences of one object's paths, or of the lines of sight, from what the unknowns predict."""

    paths: Reflections
    row: IntArray  # (path,) of the stop
    difference: FloatArray  # (path, 3)
    by_common: FloatArray  # (path, 3, common)
    by_rx: FloatArray  # (path, 3, 4)


class _System(NamedTuple):
    """Minus the log posterior and its normal equations; the blocks of the stops are separate."""

    cost: float
    common_gradient: FloatArray  # (common,)
    common: FloatArray  # (common, common)
    stop_gradient: FloatArray  # (stop, 4)
    stop: FloatArray  # (stop, 4, 4)
    cross: FloatArray  # (stop, 4, common)

    def schur(self, damping: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The reduced system of the common unknowns, and inv(stop) times gradient (stop, 4) and cross."""
        damped = self.stop * (1 + damping * np.eye(4))
        through = np.linalg.solve(damped, np.concatenate([self.stop_gradient[..., None], self.cross], axis=2))
        own, cross = through[..., 0], through[..., 1:]
        size = len(self.common)
        common = self.common * (1 + damping * np.eye(size)) + _LEAST_INFORMATION * np.eye(size)
        return common - np.einsum("sic,sid->cd", self.cross, cross), own, cross


class _BundlePoint(NamedTuple):
    common: FloatArray  # (common,)
    state: FloatArray  # (stop, 4)
    system: _System


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
    given = [*(objects[k].paths for k in starts), los]
    stop, prior_state, prior_weight = prior_states(given)
    n_offsets = N_COMMON + max(data.n_sessions for data in given)
    common = np.zeros(n_offsets)
    blocks: dict[int, _ObjectBlock] = {}
    for k, start in starts.items():
        paths, span = objects[k].paths, slice(len(common), len(common) + len(start.parameter))
        prior = kinds[k].prior(start.parameter, settings[k])
        blocks[k] = _ObjectBlock(kinds[k].family, paths, np.searchsorted(stop, paths.stop), span, prior)
        common = np.append(common, start.parameter)
        common[: len(start.offset)] = start.offset
    los_row = np.searchsorted(stop, los.stop)
    problem = _Problem(list(blocks.values()), los, los_row, prior_state, prior_weight, n_offsets, config)
    common, state = problem.solve(common)
    system = problem.system(common, state)
    reduced, _, cross = system.schur(0.0)
    own, covariance = np.asarray(np.linalg.inv(system.stop)), np.asarray(np.linalg.inv(reduced))
    found = {k: problem.optimum(block, common, state, covariance) for k, block in blocks.items()}
    rx_covariance = own + cross @ covariance @ np.swapaxes(cross, 1, 2)
    shapes = tuple(
        kinds[k].shape(found[k], at_solution(each.paths, stop, state, rx_covariance), settings[k])
        if k in found
        else failed_fit(each.kind, "no start")
        for k, each in enumerate(objects)
    )
    return Bundle(
        shapes=shapes,
        inlier=tuple(found[k].inlier if k in found else np.zeros(0) for k in range(len(objects))),
        offset=common[:n_offsets],
        offset_covariance=covariance[:n_offsets, :n_offsets],
        stop=stop,
        rx_state=state,
        rx_covariance=rx_covariance,
        noise_scale=problem.noise_scale(common, state, covariance, cross, own),
    )


@dataclass(frozen=True)
class _Problem:
    blocks: list[_ObjectBlock]
    los: Reflections
    los_row: IntArray
    prior_state: FloatArray  # (stop, 4)
    prior_weight: FloatArray  # (stop, 4, 4)
    n_offsets: int
    config: ReflectionConfig

    def solve(self, common: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Common unknowns and states at the minimum.

        The own fits absorbed offsets, and given states have errors, so an object may start where all its paths
        are ghosts to it. The covariances of such paths are therefore enlarged at first and reduced step by step.
        """
        state = self.prior_state
        for factor in self._cooling(common, state):
            common, state = self._scaled(factor)._descend(common, state)
        return common, state

    def _cooling(self, common: FloatArray, state: FloatArray) -> FloatArray:
        """Factors (round, set) on the covariances of objects and, last, of lines of sight.

        With the first factors half of the squared errors of a set are below the expected median.
        """
        first = np.ones(len(self.blocks) + 1)
        for k, each in enumerate(self._residuals(common, state)):
            weight = np.asarray(np.linalg.inv(each.paths.covariance))
            square = np.einsum("na,nab,nb->n", each.difference, weight, each.difference)
            first[k] = float(np.median(square)) / CHI2_MEDIAN
        first = np.where(first > FAR_OFF, first, 1.0)
        rounds = int(np.ceil(np.log10(first.max()))) + 1
        return np.asarray(first ** np.linspace(1.0, 0.0, rounds)[:, None] if rounds > 1 else [np.ones(len(first))])

    def _scaled(self, factor: FloatArray) -> _Problem:
        """The problem with the covariances of objects and lines of sight times factors (set,)."""
        *objects, los = (
            replace(data, covariance=data.covariance * float(f))
            for data, f in zip([*(block.paths for block in self.blocks), self.los], factor, strict=True)
        )
        blocks = [replace(block, paths=data) for block, data in zip(self.blocks, objects, strict=True)]
        return replace(self, blocks=blocks, los=los)

    def _descend(self, common: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The minimum from a start, by Levenberg-Marquardt."""

        def attempt(at: _BundlePoint, damping: float) -> Attempt[_BundlePoint]:
            reduced, own, cross = at.system.schur(damping)
            right = at.system.common_gradient - np.einsum("sic,si->c", at.system.cross, own)
            step = -np.linalg.solve(reduced, right)
            common, state = at.common + step, at.state - own - cross @ step
            trial = _BundlePoint(common, state, self.system(common, state))
            return Attempt(trial, at.system.cost, trial.system.cost)

        start = _BundlePoint(common, state, self.system(common, state))
        found = minimise(start, attempt, Schedule(_MAX_STEPS, largest=1e6, absolute=_CONVERGED_NAT))
        return found.common, found.state

    def system(self, common: FloatArray, state: FloatArray) -> _System:
        """Cost and normal equations at common unknowns (common,) and states (stop, 4)."""
        offsets = with_offsets(Prior(*3 * [np.zeros(0)]), self.n_offsets - N_COMMON, self.config)
        size, away = len(common), state - self.prior_state
        pull = np.einsum("sij,sj->si", self.prior_weight, away)
        cost = 0.5 * float(np.sum(away * pull))
        gradient, hessian = np.zeros(size), np.zeros((size, size))
        stop_gradient, stop = pull, self.prior_weight.copy()
        cross = np.zeros((len(state), 4, size))
        priors = [(offsets, slice(0, self.n_offsets)), *((block.prior, block.span) for block in self.blocks)]
        for prior, span in priors:
            shift = common[span] - prior.mean
            cost += 0.5 * float(np.sum(prior.precision * shift**2))
            gradient[span] += prior.precision * shift
            hessian[span, span] += np.diag(prior.precision)
        for paths, row, difference, by_common, by_rx in self._residuals(common, state):
            added, share, weight = self._mixture(paths, difference)
            cost += added
            weighted = weight * share[:, None, None]
            weighted_common = np.einsum("nac,nab->ncb", by_common, weighted)
            weighted_rx = np.einsum("nai,nab->nib", by_rx, weighted)
            gradient -= np.einsum("ncb,nb->c", weighted_common, difference)
            hessian += np.einsum("ncb,nbd->cd", weighted_common, by_common)
            np.add.at(stop_gradient, row, -np.einsum("nib,nb->ni", weighted_rx, difference))
            np.add.at(stop, row, weighted_rx @ by_rx)
            np.add.at(cross, row, weighted_rx @ by_common)
        return _System(cost, gradient, hessian, stop_gradient, stop, cross)

    def optimum(
        self, block: _ObjectBlock, common: FloatArray, state: FloatArray, covariance: FloatArray
    ) -> Optimum:
        """The solution of one object; its covariance has poses and offsets unknown."""
        offsets = range(self.n_offsets)
        index = np.array([*range(block.span.start, block.span.stop), *offsets])
        parameter = common[block.span]
        paths = predict_reflection(block.family, parameter, block.paths.tx, state[block.row])
        _, share, _ = self._mixture(block.paths, offset_residual(block.paths, paths.measured, common))
        return Optimum(parameter, common[: self.n_offsets], covariance[np.ix_(index, index)], np.nan, share, paths)

    def noise_scale(
        self, common: FloatArray, state: FloatArray, covariance: FloatArray, cross: FloatArray, own: FloatArray
    ) -> FloatArray:
        """Median absolute residuals (3,) over those expected after the fit absorbed a part of the noise.

        The residual of a path has the covariance R - J S J', S that of all unknowns (Foerstner 1979, variance
        components). The median ignores ghosts and objects of unusual noise. NaN without a path.
        """
        sizes = [np.zeros((0, 3))]
        for paths, row, difference, by_common, by_rx in self._residuals(common, state):
            _, share, _ = self._mixture(paths, difference)
            # A change of the common unknowns moves the states by -cross, so J S J' has two terms.
            moved = by_common - by_rx @ cross[row]
            absorbed = np.einsum("nac,cd,nad->na", moved, covariance, moved)
            absorbed += np.einsum("nai,nij,naj->na", by_rx, own[row], by_rx)
            stated = np.diagonal(paths.covariance, axis1=1, axis2=2)
            expected = np.maximum(stated - absorbed, _LEAST_VARIANCE_SHARE * stated)
            sizes.append((np.abs(difference) / np.sqrt(expected))[share > 0.5])
        size = np.concatenate(sizes)
        return np.median(size, axis=0) / NORMAL_MEDIAN if len(size) else np.full(3, np.nan)

    def _residuals(self, common: FloatArray, state: FloatArray) -> list[_Residuals]:
        """Residuals of each object, then those of the lines of sight if there are any."""
        found = []
        for block in self.blocks:
            paths = predict_reflection(block.family, common[block.span], block.paths.tx, state[block.row])
            by_common = _by_offset(block.paths, len(common))
            by_common[:, :, block.span] = paths.by_parameter
            difference = offset_residual(block.paths, paths.measured, common)
            found.append(_Residuals(block.paths, block.row, difference, by_common, paths.by_rx))
        if len(self.los):
            given = state[self.los_row]
            measured, by_rx = predict_los(self.los.tx, given), los_jacobian_rx(self.los.tx, given)
            difference = offset_residual(self.los, measured, common)
            by_common = _by_offset(self.los, len(common))
            found.append(_Residuals(self.los, self.los_row, difference, by_common, by_rx))
        return found

    def _mixture(self, paths: Reflections, difference: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Minus the log likelihood with ghosts, the share of the Gaussian (path,), and the inverse covariances."""
        weight = np.asarray(np.linalg.inv(paths.covariance), float)
        square = np.einsum("na,nab,nb->n", difference, weight, difference)
        log_norm = np.log1p(-self.config.ghost_share) - 1.5 * np.log(2 * np.pi)
        log_inlier = log_norm + 0.5 * np.linalg.slogdet(weight)[1] - 0.5 * square
        log_total = np.logaddexp(log_inlier, self.config.log_ghost_density)
        return -float(np.sum(log_total)), np.exp(log_inlier - log_total), weight


def _by_offset(data: Reflections, size: int) -> FloatArray:
    """Derivatives (path, 3, size) of the predictions by the common unknowns: the offsets, the others zero."""
    slope = np.zeros((len(data), 3, size))
    slope[:, 0, 0], slope[:, 2, 1] = 1.0, 1.0
    slope[np.arange(len(data)), 1, N_COMMON + data.session] = 1.0
    return slope
