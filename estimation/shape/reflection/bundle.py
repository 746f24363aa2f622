"""All objects, lines of sight, poses and offsets of a campaign in one sparse least-squares problem.

Unknowns are the parameters of every object, one delay and one arrival offset, one departure offset per
session, and the RX state of every stop, with the given states as its prior. A stop meets only its own paths,
so the states are eliminated stop by stop and a small dense system for objects and offsets is left (Schur
complement). Paths weigh in with their probability of not being ghosts, as in
`estimation.shape.reflection.posterior`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from estimation.inference.least_squares import Attempt, Schedule, minimise
from estimation.laws.contour import predict
from estimation.laws.plane import los_jacobian_rx, predict_los, residual
from estimation.shape.fit import ShapeFit, failed_fit
from estimation.shape.reflection.bundle_kinds import (
    BundleObject,
    family_of_kind,
    prior_of,
    shape_of,
    start_of,
)
from estimation.shape.reflection.path_likelihood import N_COMMON
from estimation.shape.reflection.posterior import CHI2_MEDIAN, FAR_OFF, Optimum, Prior, with_offsets
from estimation.shape.reflection.reflections import ReflectionConfig, Reflections, at_solution, prior_states
from scenes.record import FloatArray, IntArray

_MAX_STEPS = 40
_SETTLED_NAT = 1e-6
_LEAST_INFORMATION = 1e-8  # on an object that lost all its paths to ghosts, per square of m or rad
_LEAST_LEFT = 0.05  # share of a variance that the fit does not take up
_NORMAL_MEDIAN = 0.6745  # of the size of a standard normal number


@dataclass(frozen=True)
class Bundle:
    """Shapes in the order of the objects, and what is common to them."""

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
    """One object inside the problem: where its parameters lie among the common unknowns (offsets first)."""

    kind: str
    family: int
    paths: Reflections
    row: IntArray  # (path,) of its stop
    first: int
    start: Optimum
    prior: Prior


@dataclass(frozen=True)
class _System:
    """Minus the log posterior and its normal equations, the stops' blocks apart from the common unknowns."""

    cost: float
    common_gradient: FloatArray  # (common,)
    common: FloatArray  # (common, common)
    stop_gradient: FloatArray  # (stop, 4)
    stop: FloatArray  # (stop, 4, 4)
    cross: FloatArray  # (stop, 4, common)

    def schur(self, damping: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The system left for the common unknowns, and inv(stop) times gradient (stop, 4) and cross."""
        raised = self.stop * (1 + damping * np.eye(4))
        through = np.linalg.solve(raised, np.concatenate([self.stop_gradient[..., None], self.cross], axis=2))
        own, cross = through[..., 0], through[..., 1:]
        size = len(self.common)
        left = self.common * (1 + damping * np.eye(size)) + _LEAST_INFORMATION * np.eye(size)
        return left - np.einsum("sic,sid->cd", self.cross, cross), own, cross


class _BundlePoint(NamedTuple):
    common: FloatArray  # (common,)
    state: FloatArray  # (stop, 4)
    system: _System


def fit_bundle(objects: Sequence[BundleObject], los: Reflections, config: ReflectionConfig) -> Bundle:
    """Fit all objects together; each starts from its fit alone, and one whose fit fails is left out.

    `los` holds the lines of sight in the same form as the reflections, with the same stops and sessions; it
    may be empty. States and their covariances are those of the first path of each stop, over objects in
    order, then `los`.

    Raises
    ------
    ValueError
        Where the kind of an object is unknown.
    """
    starts = [start_of(each, config) for each in objects]
    given = [each.paths for each, start in zip(objects, starts, strict=True) if start is not None]
    stop, prior_state, prior_weight = prior_states([*given, los])
    n_offsets = N_COMMON + max((data.n_sessions for data in [*given, los]), default=0)
    parts: list[_ObjectBlock | None] = []
    first = n_offsets
    for each, start in zip(objects, starts, strict=True):
        if start is None:
            parts.append(None)
            continue
        row = np.searchsorted(stop, each.paths.stop)
        prior = prior_of(each, start.parameter, config)
        parts.append(_ObjectBlock(each.kind, family_of_kind(each.kind), each.paths, row, first, start, prior))
        first += len(start.parameter)
    used = [part for part in parts if part is not None]
    common = np.zeros(first)
    for part in used:
        common[part.first : part.first + len(part.start.parameter)] = part.start.parameter
        common[: len(part.start.offset)] = part.start.offset
    problem = _Problem(
        used, los, np.searchsorted(stop, los.stop), prior_state, prior_weight, n_offsets, config
    )
    common, state = problem.solve(common)
    system = problem.system(common, state)
    left, _, cross = system.schur(0.0)
    own, covariance = np.asarray(np.linalg.inv(system.stop)), np.asarray(np.linalg.inv(left))
    found = [None if part is None else problem.optimum(part, common, state, covariance) for part in parts]
    rx_covariance = own + cross @ covariance @ np.swapaxes(cross, 1, 2)
    shapes = tuple(
        failed_fit(each.kind, "no start")
        if optimum is None
        else shape_of(each, optimum, at_solution(each.paths, stop, state, rx_covariance), config)
        for each, optimum in zip(objects, found, strict=True)
    )
    return Bundle(
        shapes=shapes,
        inlier=tuple(np.zeros(0) if optimum is None else optimum.inlier for optimum in found),
        offset=common[:n_offsets],
        offset_covariance=covariance[:n_offsets, :n_offsets],
        stop=stop,
        rx_state=state,
        rx_covariance=rx_covariance,
        noise_scale=problem.noise_scale(common, state, covariance, cross, own),
    )


@dataclass(frozen=True)
class _Problem:
    parts: list[_ObjectBlock]
    los: Reflections
    los_row: IntArray
    prior_state: FloatArray  # (stop, 4)
    prior_weight: FloatArray  # (stop, 4, 4)
    n_offsets: int
    config: ReflectionConfig

    def solve(self, common: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Common unknowns and states at the minimum.

        Fits alone took up offsets of their own, and given states have errors, so that an object may start where
        all its paths are ghosts to it: the covariances of such paths are raised at first and cooled to their own.
        """
        state = self.prior_state
        for heat in self._cooling(common, state):
            common, state = self._heated(heat)._descend(common, state)
        return common, state

    def _cooling(self, common: FloatArray, state: FloatArray) -> FloatArray:
        """Factors (round, set) on the covariances of objects and, last, of lines of sight.

        The first make half of the squared errors of a set usual ones.
        """
        first = np.ones(len(self.parts) + 1)
        sets = [*range(len(self.parts)), *([len(self.parts)] if len(self.los) else [])]
        for k, (paths, _, difference, _, _) in zip(sets, self._residuals(common, state), strict=True):
            weight = np.asarray(np.linalg.inv(paths.covariance))
            square = np.einsum("na,nab,nb->n", difference, weight, difference)
            first[k] = float(np.median(square)) / CHI2_MEDIAN
        first = np.where(first > FAR_OFF, first, 1.0)
        rounds = int(np.ceil(np.log10(first.max()))) + 1
        return np.asarray(
            first ** np.linspace(1.0, 0.0, rounds)[:, None] if rounds > 1 else [np.ones(len(first))]
        )

    def _heated(self, heat: FloatArray) -> _Problem:
        """The problem with the covariances of objects and lines of sight (set,) raised."""

        def raised(paths: Reflections, factor: float) -> Reflections:
            return replace(paths, covariance=paths.covariance * factor)

        parts = [
            replace(part, paths=raised(part.paths, float(factor)))
            for part, factor in zip(self.parts, heat[:-1], strict=True)
        ]
        return replace(self, parts=parts, los=raised(self.los, float(heat[-1])))

    def _descend(self, common: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The minimum from a start, by Levenberg-Marquardt."""

        def attempt(at: _BundlePoint, damping: float) -> Attempt[_BundlePoint]:
            left, own, cross = at.system.schur(damping)
            right = at.system.common_gradient - np.einsum("sic,si->c", at.system.cross, own)
            step = -np.linalg.solve(left, right)
            common, state = at.common + step, at.state - own - cross @ step
            trial = _BundlePoint(common, state, self.system(common, state))
            return Attempt(trial, at.system.cost, trial.system.cost)

        start = _BundlePoint(common, state, self.system(common, state))
        found = minimise(start, attempt, Schedule(_MAX_STEPS, largest=1e6, absolute=_SETTLED_NAT))
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
        blocks = [(offsets, 0), *((part.prior, part.first) for part in self.parts)]
        for prior, first in blocks:
            span = slice(first, first + len(prior.mean))
            shift = common[span] - prior.mean
            cost += 0.5 * float(np.sum(prior.precision * shift**2))
            gradient[span] += prior.precision * shift
            hessian[span, span] += np.diag(prior.precision)
        for paths, row, difference, by_common, by_rx in self._residuals(common, state):
            weight = np.asarray(np.linalg.inv(paths.covariance), float)
            lost, share = self._mixture(difference, weight)
            cost += lost
            weighted = weight * share[:, None, None]
            left_common = np.einsum("nac,nab->ncb", by_common, weighted)
            left_rx = np.einsum("nai,nab->nib", by_rx, weighted)
            gradient -= np.einsum("ncb,nb->c", left_common, difference)
            hessian += np.einsum("ncb,nbd->cd", left_common, by_common)
            np.add.at(stop_gradient, row, -np.einsum("nib,nb->ni", left_rx, difference))
            np.add.at(stop, row, left_rx @ by_rx)
            np.add.at(cross, row, left_rx @ by_common)
        return _System(cost, gradient, hessian, stop_gradient, stop, cross)

    def optimum(
        self, part: _ObjectBlock, common: FloatArray, state: FloatArray, covariance: FloatArray
    ) -> Optimum:
        """One object's part of the solution, its covariance with poses and offsets unknown."""
        n = len(part.start.parameter)
        index = np.array([*range(part.first, part.first + n), *range(self.n_offsets)])
        parameter = common[part.first : part.first + n]
        paths = predict(part.family, parameter, part.paths.tx, state[part.row])
        difference = self._difference(part.paths, paths.measured, common)
        _, share = self._mixture(difference, np.asarray(np.linalg.inv(part.paths.covariance), float))
        return Optimum(
            parameter, common[: self.n_offsets], covariance[np.ix_(index, index)], np.nan, share, paths
        )

    def noise_scale(
        self,
        common: FloatArray,
        state: FloatArray,
        covariance: FloatArray,
        cross: FloatArray,
        own: FloatArray,
    ) -> FloatArray:
        """Median size (3,) of the residuals over the expected one: what the fit takes up of the noise is left out.

        A residual of a path has the covariance R - J S J', S that of all unknowns (Foerstner 1979, variance
        components). The median leaves out ghosts and objects of unusual noise. NaN without a path.
        """
        sizes = [np.zeros((0, 3))]
        for paths, row, difference, by_common, by_rx in self._residuals(common, state):
            _, share = self._mixture(difference, np.asarray(np.linalg.inv(paths.covariance), float))
            # A change of the common unknowns moves the states by -cross, so J S J' splits in two.
            moved = by_common - by_rx @ cross[row]
            taken = np.einsum("nac,cd,nad->na", moved, covariance, moved)
            taken += np.einsum("nai,nij,naj->na", by_rx, own[row], by_rx)
            stated = np.diagonal(paths.covariance, axis1=1, axis2=2)
            left = np.maximum(stated - taken, _LEAST_LEFT * stated)
            sizes.append((np.abs(difference) / np.sqrt(left))[share > 0.5])
        size = np.concatenate(sizes)
        return np.median(size, axis=0) / _NORMAL_MEDIAN if len(size) else np.full(3, np.nan)

    def _residuals(
        self, common: FloatArray, state: FloatArray
    ) -> list[tuple[Reflections, IntArray, FloatArray, FloatArray, FloatArray]]:
        """Per object, then for the lines of sight: data, stop rows, differences, derivatives by common and RX."""
        found = []
        for part in self.parts:
            span = slice(part.first, part.first + len(part.start.parameter))
            paths = predict(part.family, common[span], part.paths.tx, state[part.row])
            by_common = self._by_offset(part.paths, len(common))
            by_common[:, :, span] = paths.by_parameter
            difference = self._difference(part.paths, paths.measured, common)
            found.append((part.paths, part.row, difference, by_common, paths.by_rx))
        if len(self.los):
            given = state[self.los_row]
            measured, by_rx = predict_los(self.los.tx, given), los_jacobian_rx(self.los.tx, given)
            difference = self._difference(self.los, measured, common)
            found.append((self.los, self.los_row, difference, self._by_offset(self.los, len(common)), by_rx))
        return found

    def _difference(self, data: Reflections, predicted: FloatArray, common: FloatArray) -> FloatArray:
        offset = np.column_stack(
            [
                np.full(len(data), common[0]),
                common[N_COMMON + data.session],
                np.full(len(data), common[1]),
            ]
        )
        return residual(data.measured, predicted + offset)

    def _by_offset(self, data: Reflections, size: int) -> FloatArray:
        slope = np.zeros((len(data), 3, size))
        slope[:, 0, 0], slope[:, 2, 1] = 1.0, 1.0
        slope[np.arange(len(data)), 1, N_COMMON + data.session] = 1.0
        return slope

    def _mixture(self, difference: FloatArray, weight: FloatArray) -> tuple[float, FloatArray]:
        """Minus the log likelihood of Gaussian and ghost together, and the Gaussian's share (path,)."""
        square = np.einsum("na,nab,nb->n", difference, weight, difference)
        log_norm = np.log1p(-self.config.ghost_share) - 1.5 * np.log(2 * np.pi)
        log_inlier = log_norm + 0.5 * np.linalg.slogdet(weight)[1] - 0.5 * square
        log_total = np.logaddexp(log_inlier, self.config.log_ghost_density)
        return -float(np.sum(log_total)), np.exp(log_inlier - log_total)
