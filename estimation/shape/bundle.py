"""All objects, lines of sight, poses and offsets of a campaign in one sparse least-squares problem.

Unknowns are the parameters of every object, one delay and one arrival offset, one departure offset per
session, and the RX state of every stop, with the given states as its prior. A stop meets only its own paths,
so the states are eliminated stop by stop and a small dense system for objects and offsets is left (Schur
complement). Paths weigh in with their probability of not being ghosts, as in `estimation.shape.posterior`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.geometry import los_jacobian_rx, predict_los, residual
from estimation.shape.direct import closed_prior, closed_shape, fit_closed
from estimation.shape.edge import edge_shape, fit_point, point_prior
from estimation.shape.fit import ShapeFit, failed_fit
from estimation.shape.mirror_wall import fit_wall, wall_prior, wall_shape
from estimation.shape.path_likelihood import N_COMMON
from estimation.shape.posterior import Optimum, Prior, with_offsets
from estimation.shape.reflections import ReflectionConfig, Reflections
from estimation.shape.specular import EDGE, WALL, predict
from estimation.shape.support import CLOSED_FAMILY
from scenes.pose import Pose
from scenes.record import FloatArray, IntArray

_MAX_STEPS = 40
_SETTLED_NAT = 1e-6
_EXACT_STD = 1e-6  # of a state given as exact, in m and rad


@dataclass(frozen=True)
class BundleObject:
    """The paths of one object and the kind of contour they are fitted with: closed, `wall` or `edge`."""

    kind: str
    paths: Reflections


@dataclass(frozen=True)
class Bundle:
    """Shapes in the order of the objects, and what is common to them."""

    shapes: tuple[ShapeFit, ...]
    inlier: tuple[FloatArray, ...]  # per object (path,) probability of not being a ghost
    offset: FloatArray  # (2 + session,) delay in m, arrivals, departures of each session in rad
    offset_std: FloatArray  # (2 + session,)
    stop: IntArray  # (stop,) the stops that have paths
    rx_state: FloatArray  # (stop, 4) x, y, heading, clock bias in m, m, rad, m


@dataclass(frozen=True)
class _Part:
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
        left = self.common * (1 + damping * np.eye(len(self.common)))
        return left - np.einsum("sic,sid->cd", self.cross, cross), own, cross


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
    starts = [_start(each, config) for each in objects]
    given = [each.paths for each, start in zip(objects, starts, strict=True) if start is not None]
    stop, prior_state, prior_weight = _prior_states([*given, los])
    n_offsets = N_COMMON + max((data.n_sessions for data in [*given, los]), default=0)
    parts: list[_Part | None] = []
    first = n_offsets
    for each, start in zip(objects, starts, strict=True):
        if start is None:
            parts.append(None)
            continue
        row = np.searchsorted(stop, each.paths.stop)
        prior = _prior(each.kind, start.parameter, config)
        parts.append(_Part(each.kind, _family(each.kind), each.paths, row, first, start, prior))
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
    covariance = np.asarray(np.linalg.inv(problem.system(common, state).schur(0.0)[0]), float)
    found = [None if part is None else problem.optimum(part, common, state, covariance) for part in parts]
    shapes = tuple(
        failed_fit(each.kind, "no start") if optimum is None else _shape(each, optimum, state, stop, config)
        for each, optimum in zip(objects, found, strict=True)
    )
    return Bundle(
        shapes=shapes,
        inlier=tuple(np.zeros(0) if optimum is None else optimum.inlier for optimum in found),
        offset=common[:n_offsets],
        offset_std=np.sqrt(np.diagonal(covariance)[:n_offsets]),
        stop=stop,
        rx_state=state,
    )


@dataclass(frozen=True)
class _Problem:
    parts: list[_Part]
    los: Reflections
    los_row: IntArray
    prior_state: FloatArray  # (stop, 4)
    prior_weight: FloatArray  # (stop, 4, 4)
    n_offsets: int
    config: ReflectionConfig

    def solve(self, common: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Common unknowns and states at the minimum, by Levenberg-Marquardt."""
        state, damping = self.prior_state, 1e-3
        now = self.system(common, state)
        for _ in range(_MAX_STEPS):
            left, own, cross = now.schur(damping)
            right = now.common_gradient - np.einsum("sic,si->c", now.cross, own)
            step = -np.linalg.solve(left, right)
            trial_state = state - own - cross @ step
            trial = self.system(common + step, trial_state)
            if trial.cost < now.cost:
                gain = now.cost - trial.cost
                common, state, now, damping = common + step, trial_state, trial, max(damping / 10, 1e-9)
                if gain < _SETTLED_NAT:
                    break
            elif damping > 1e6:
                break
            else:
                damping *= 10
        return common, state

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

    def optimum(self, part: _Part, common: FloatArray, state: FloatArray, covariance: FloatArray) -> Optimum:
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
            measured, by_rx = _los(self.los.tx, state[self.los_row])
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


def _start(each: BundleObject, config: ReflectionConfig) -> Optimum | None:
    if each.kind not in (*CLOSED_FAMILY, "wall", "edge"):
        raise ValueError(f"kind = '{each.kind}': must be one of {', '.join(CLOSED_FAMILY)}, wall, edge")
    if len(each.paths) == 0:
        return None
    if each.kind == "wall":
        return fit_wall(each.paths, config)
    return fit_point(each.paths, config) if each.kind == "edge" else fit_closed(each.paths, each.kind, config)


def _prior(kind: str, start: FloatArray, config: ReflectionConfig) -> Prior:
    if kind == "wall":
        return wall_prior(config)
    return point_prior(config) if kind == "edge" else closed_prior(kind, start, config)


def _family(kind: str) -> int:
    return {**CLOSED_FAMILY, "wall": WALL, "edge": EDGE}[kind]


def _shape(
    each: BundleObject, found: Optimum, state: FloatArray, stop: IntArray, config: ReflectionConfig
) -> ShapeFit:
    if each.kind == "wall":
        solved = replace(each.paths, rx_state=state[np.searchsorted(stop, each.paths.stop)])
        return wall_shape(found, solved)
    return edge_shape(found) if each.kind == "edge" else closed_shape(found, each.kind, config)


def _prior_states(sets: Sequence[Reflections]) -> tuple[IntArray, FloatArray, FloatArray]:
    """Stops, the states (stop, 4) given for them, and the inverse (stop, 4, 4) of their covariances."""
    stop, first = np.unique(np.concatenate([data.stop for data in sets]), return_index=True)
    state = np.concatenate([data.rx_state for data in sets])[first]
    covariance = np.concatenate([data.rx_covariance for data in sets])[first]
    return stop, state, np.asarray(np.linalg.inv(covariance + _EXACT_STD**2 * np.eye(4)))


def _los(tx: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lines of sight (path, 3) and their derivatives (path, 3, 4) for TX rows (path, 3)."""
    measured, by_rx = np.zeros((len(tx), 3)), np.zeros((len(tx), 3, 4))
    for row in np.unique(tx, axis=0):
        mine = np.all(tx == row, axis=1)
        pose = Pose(np.array([*row[:2], 0.0]), float(row[2]))
        measured[mine], by_rx[mine] = predict_los(pose, state[mine]), los_jacobian_rx(pose, state[mine])
    return measured, by_rx
