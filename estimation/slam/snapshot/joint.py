"""Modes of one stop from the paths of several TX: one pose, and a clock bias for every TX.

Each TX alone gives modes as for a single TX, and two lines of sight give a pose by their angles. Each such pose is
completed by the other TX, with and without a line of sight. All TX together refine it and give its evidence.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from estimation.distributions import chi_square_quantile
from estimation.inference.least_squares import Attempt, Schedule, damped_step, minimise
from estimation.laws.plane import bounce_equation, state_columns
from estimation.slam.config import SnapshotConfig
from estimation.slam.snapshot.evidence import PowerLaw, SnapshotPrior, log_clutter, log_powers, power_law, prior_of
from estimation.slam.snapshot.hypotheses import distinct_states
from estimation.slam.snapshot.joint_terms import TxTerms, gain_between, terms_at
from estimation.slam.snapshot.likelihood import log_likelihood
from estimation.slam.snapshot.path_table import (
    LineOfSight,
    PathModel,
    PathTable,
    line_of_sight,
    path_model,
    path_table,
)
from estimation.slam.snapshot.problem import Fit, SnapshotProblem
from estimation.slam.snapshot.statistical import N_RANKED, los_candidates, solve_statistical
from scenes.pose import wrap_angle
from scenes.record import FloatArray, IntArray

_MODES_PER_TX = 4  # that are completed by the other TX
_ANGLE_GATE = 5.0  # standard deviations of a direction of a line of sight from the one that a pose predicts
_LEAST_SLOPE = 0.05  # of a bounce equation by the clock bias, from which it gives one
_SAME_HEADING_RAD = np.deg2rad(8.0)  # of a receiver, from the lines of sight of two TX
_POSE_STD = np.array([0.3, 0.3, np.deg2rad(2.0)])  # of a pose from two directions
_FEW_BOUNCES = 12  # strongest paths whose bounce equations give clock biases
_SCHEDULE = Schedule(30, first=1e-6, largest=1e6, absolute=1e-7)


class _Candidate(NamedTuple):
    """A pose with the lines of sight (tx,), -1 for none, and the clock biases (tx,); None where not yet known."""

    pose: FloatArray  # (3,)
    std: FloatArray  # (3,)
    lines: tuple[int | None, ...]
    bias_m: tuple[float | None, ...]


@dataclass(frozen=True)
class _Part:
    """The paths of one TX in the form of the compiled functions; states are relative to the TX."""

    problem: SnapshotProblem
    table: PathTable
    model: PathModel

    @property
    def origin(self) -> FloatArray:
        """Position of the TX with zeros (4,)."""
        return np.array([*self.problem.tx.position_m[:2], 0.0, 0.0])

    def direct(self, line: int) -> LineOfSight:
        """A path as line of sight, -1 for none."""
        return line_of_sight(self.problem, line)


@dataclass(frozen=True)
class _Refined:
    state: FloatArray
    information: FloatArray
    evidence: float
    square: list[FloatArray]  # per TX (path,)
    lines: tuple[int, ...]


def joint_modes(problem: SnapshotProblem, config: SnapshotConfig) -> list[Fit]:
    """Distinct modes by falling evidence, as `solve_statistical`; none where no TX has enough paths."""
    alone = [problem.of_tx(tx) for tx in range(len(problem.every_tx))]
    model, law, prior = path_model(config.mixture), power_law(config.path_loss), prior_of(config)
    parts = [_Part(one, path_table(one, config.mixture), model) for one in alone]
    gate = float(chi_square_quantile(config.gate_probability, 1))
    clutter = sum(
        log_clutter(part.table.range_m, part.problem.power_dbm, law, prior) for part in parts if len(part.problem)
    )
    clock = problem.every_tx.clock_information
    found = []
    for candidate in _candidates(parts, config):
        for whole in _completed(candidate, parts):
            refined = _refined(whole, parts, clock, law, prior)
            if refined.evidence > clutter and _is_determined(refined, gate, prior):
                found.append(refined)
    if not found:
        return []
    state, evidence = np.array([one.state for one in found]), np.array([one.evidence for one in found])
    kept = distinct_states(state, evidence, N_RANKED, np.inf)
    return [_fit(found[k], problem, gate) for k in kept]


def _candidates(parts: Sequence[_Part], config: SnapshotConfig) -> Iterator[_Candidate]:
    """Poses from every TX alone, and from the lines of sight of every two."""
    n = len(parts)
    for tx, part in enumerate(parts):
        for fit in solve_statistical(part.problem, config)[:_MODES_PER_TX]:
            line = int(np.argmax(fit.is_los)) if fit.is_los.any() else -1
            std = np.sqrt(np.diagonal(fit.covariance)[:3])
            lines = tuple(line if k == tx else None for k in range(n))
            bias_m = tuple(float(fit.state[3]) if k == tx else None for k in range(n))
            yield _Candidate(fit.state[:3], std, lines, bias_m)
    for a, b in combinations(range(n), 2):
        first, second = parts[a].problem, parts[b].problem
        for i, j in product(_lines_of(first), _lines_of(second)):
            pose = _seen_from_two(first, int(i), second, int(j))
            if pose is not None:
                lines = tuple({a: int(i), b: int(j)}.get(k) for k in range(n))
                yield _Candidate(pose, _POSE_STD, lines, n * (None,))


def _seen_from_two(first: SnapshotProblem, i: int, second: SnapshotProblem, j: int) -> FloatArray | None:
    """The pose (3,) that sees one path of each TX as its line of sight; None where the directions disagree."""
    azimuth = np.array([first.departure_rad[i], second.departure_rad[j]])
    heading = azimuth + np.pi - np.array([first.measured[i, 2], second.measured[j, 2]])
    apart = float(wrap_angle(heading[1] - heading[0]))
    unit = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    matrix = np.column_stack([unit[0], -unit[1]])
    if abs(apart) > _SAME_HEADING_RAD or abs(np.linalg.det(matrix)) < _LEAST_SLOPE:
        return None
    reach = np.linalg.solve(matrix, second.tx.position_m[:2] - first.tx.position_m[:2])
    if (reach <= 0).any():
        return None
    place = first.tx.position_m[:2] + reach[0] * unit[0]
    return np.array([*place, wrap_angle(heading[0] + apart / 2)])


def _completed(candidate: _Candidate, parts: Sequence[_Part]) -> Iterator[_Candidate]:
    """The candidate with a line of sight, or none, and a clock bias for every TX: at most two choices each."""
    choices = [_choices(candidate, tx, part) for tx, part in enumerate(parts)]
    for chosen in product(*choices):
        yield candidate._replace(lines=tuple(c[0] for c in chosen), bias_m=tuple(c[1] for c in chosen))


def _choices(candidate: _Candidate, tx: int, part: _Part) -> list[tuple[int, float]]:
    """Lines of sight, -1 for none, and clock biases in m with which the paths of one TX fit a pose best."""
    line, bias_m, problem = candidate.lines[tx], candidate.bias_m[tx], part.problem
    if line is not None and bias_m is not None:
        return [(line, bias_m)]
    away = candidate.pose[:2] - problem.tx.position_m[:2]
    distance = float(np.hypot(*away))
    if line is not None:
        return [(line, float(problem.measured[line, 0]) - distance)]
    known = [one for one in candidate.bias_m if one is not None]
    if not len(problem):
        return [(-1, float(np.mean(known)) if known else 0.0)]
    found = []
    expected = np.arctan2(away[1], away[0]) + np.array([0.0, np.pi]) - [0.0, candidate.pose[2]]
    seen = np.column_stack([problem.departure_rad, problem.measured[:, 2]])
    variance = np.diagonal(problem.covariance, axis1=1, axis2=2)[:, 1:]
    own = (candidate.std[:2].max() / max(distance, 0.1)) ** 2 + np.array([0.0, candidate.std[2] ** 2])
    agrees = (np.abs(wrap_angle(seen - expected)) <= _ANGLE_GATE * np.sqrt(variance + own)).all(axis=1)
    lines = _lines_of(problem)
    lines = lines[agrees[lines]]
    if len(lines):
        best = int(lines[np.argmax(problem.power_dbm[lines])])
        found.append((best, float(problem.measured[best, 0]) - distance))
    biases = np.array([*_bounce_biases(candidate.pose, problem), *known])
    states = np.column_stack([np.tile(candidate.pose, (len(biases), 1)), biases]) - part.origin
    if len(biases):
        score = log_likelihood(part.table, part.direct(-1), part.model, states)
        found.append((-1, float(biases[np.argmax(score)])))
    return found or [(-1, 0.0)]


def _lines_of(problem: SnapshotProblem) -> IntArray:
    """Paths that may be the line of sight; of a TX with one path that one, because others place the receiver."""
    return np.arange(1) if len(problem) == 1 else los_candidates(problem)


def _bounce_biases(pose: FloatArray, problem: SnapshotProblem) -> FloatArray:
    """Clock biases in m with which each of the strongest paths is a single bounce at a pose."""
    strongest: IntArray = problem.strongest[:_FEW_BOUNCES]
    equation = bounce_equation(problem.tx, pose[2], problem.measured[strongest])
    slope = equation.row[:, 2]
    gives = np.abs(slope) > _LEAST_SLOPE
    rest = equation.right_side - equation.row[:, :2] @ pose[:2]
    return np.asarray(rest[gives] / slope[gives])


class _JointPoint(NamedTuple):
    state: FloatArray
    terms: list[TxTerms]


def _refined(
    start: _Candidate, parts: Sequence[_Part], clock: FloatArray, law: PowerLaw, prior: SnapshotPrior
) -> _Refined:
    """The maximum of the likelihood of all TX near a candidate, with its evidence."""
    lines = tuple(-1 if line is None else line for line in start.lines)
    direct = [part.direct(line) for part, line in zip(parts, lines, strict=True)]
    columns = state_columns(np.arange(len(parts)))
    size = 3 + len(parts)

    def own(state: FloatArray, tx: int) -> FloatArray:
        return np.asarray(state[columns[tx]] - parts[tx].origin)

    def point(state: FloatArray) -> _JointPoint:
        every = [TxTerms(*terms_at(p.table, direct[k], p.model, own(state, k))) for k, p in enumerate(parts)]
        return _JointPoint(state, every)

    def cost(fixed: FloatArray, state: FloatArray) -> float:
        gains = [
            gain_between(p.table, direct[k], p.model, own(fixed, k), own(state, k)) for k, p in enumerate(parts)
        ]
        return 0.5 * float(state[3:] @ clock @ state[3:]) - sum(gains)

    def summed(terms: Sequence[TxTerms], name: str) -> FloatArray:
        matrix = np.zeros((size, size))
        matrix[3:, 3:] = clock
        for k, one in enumerate(terms):
            matrix[np.ix_(columns[k], columns[k])] += getattr(one, name)
        return matrix

    def attempt(at: _JointPoint, damping: float) -> Attempt[_JointPoint]:
        gradient = np.append(np.zeros(3), clock @ at.state[3:])
        for k, one in enumerate(at.terms):
            gradient[columns[k]] += one.gradient
        trial = at.state + damped_step(summed(at.terms, "curvature"), gradient, damping)
        return Attempt(point(trial), cost(at.state, at.state), cost(at.state, trial))

    bias_m = [0.0 if one is None else one for one in start.bias_m]
    found = minimise(point(np.append(start.pose, bias_m)), attempt, _SCHEDULE)
    information = summed(found.terms, "information") + np.diag(
        np.append(prior.information[:3], np.full(len(parts), prior.information[3]))
    )
    evidence = sum(one.log_likelihood for one in found.terms) - 0.5 * np.linalg.slogdet(information)[1]
    evidence -= 0.5 * float(found.state[3:] @ clock @ found.state[3:])
    evidence -= np.log(2 * prior.reach_m**2) + len(parts) * np.log(prior.max_clock_m)
    for k, part in enumerate(parts):
        evidence += _log_powers(part, own(found.state, k), lines[k], law, prior)
    evidence -= 0.5 * (np.hypot(*own(found.state, 0)[:2]) / prior.reach_m) ** 2
    return _Refined(found.state, information, float(evidence), [one.square for one in found.terms], lines)


def _log_powers(part: _Part, state: FloatArray, line: int, law: PowerLaw, prior: SnapshotPrior) -> float:
    """Log density of the powers of one TX, and of its line of sight over clutter, as `log_evidence` has them."""
    problem, distance = part.problem, float(np.hypot(state[0], state[1]))
    total = log_powers(problem.power_dbm, part.table.range_m - state[3], distance, line, law)
    if line >= 0:
        total += prior.log_clutter_volume - 0.5 * np.linalg.slogdet(2 * np.pi * problem.covariance[line])[1]
    return float(total)


def _is_determined(refined: _Refined, gate: float, prior: SnapshotPrior) -> bool:
    """Whether more equations agree than there are unknowns, with credible clocks."""
    equations, clocks = 0, 0
    for square, line in zip(refined.square, refined.lines, strict=True):
        bounces = int(np.sum(np.delete(square, line) <= gate)) if line >= 0 else int(np.sum(square <= gate))
        equations += bounces + 3 * (line >= 0)
        clocks += bounces > 0 or line >= 0
    is_credible = bool((np.abs(refined.state[3:]) <= prior.max_clock_m).all())
    return is_credible and equations > 3 + clocks


def _fit(refined: _Refined, problem: SnapshotProblem, gate: float) -> Fit:
    inlier, is_los = np.zeros(len(problem), bool), np.zeros(len(problem), bool)
    for tx, (square, line) in enumerate(zip(refined.square, refined.lines, strict=True)):
        own = np.flatnonzero(problem.link == tx)
        inlier[own] = square <= gate
        if line >= 0:
            inlier[own[line]] = is_los[own[line]] = True
    state = refined.state.copy()
    state[2] = wrap_angle(state[2])
    return Fit(state, inlier, is_los, -refined.evidence, np.asarray(np.linalg.inv(refined.information)))
