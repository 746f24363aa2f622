"""Stops placed again by the landmarks of a walk, with their rivals.

A stop alone can have several modes, or none: landmarks that other stops show decide between them. The places of
a grid where most paths agree, the modes of the stop alone, and the states of its neighbours are tried. Each is
refined with the landmarks held, and the one of most evidence is kept: of its paths over clutter, of the power of
its line of sight, and of the walk.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from estimation.distributions import chi_square_quantile
from estimation.inference.least_squares import student_t_log_peak
from estimation.laws.wall import wall_places
from estimation.slam.config import TrajectoryConfig
from estimation.slam.mapping.noise import LARGEST_RANGE_M
from estimation.slam.snapshot.evidence import PowerLaw, log_powers
from estimation.slam.snapshot.problem import direct_path
from estimation.slam.snapshot.refine import bounce_terms
from estimation.slam.walk.agreement import agreeing_states, sight_states
from estimation.slam.walk.association import drop_unused_landmarks, reclassify_paths
from estimation.slam.walk.linearise import linearise
from estimation.slam.walk.motion import motion_scales
from estimation.slam.walk.neighbours import between_known, motion_about, neighbour_states
from estimation.slam.walk.residuals import (
    Association,
    Observations,
    PathClass,
    TrajectoryState,
    without_heading_offsets,
)
from estimation.slam.walk.smoother import state_equations
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

CLUTTER_LOG_DENSITY = -float(np.log(LARGEST_RANGE_M * (2 * np.pi) ** 2))  # per m rad^2
WIDE_M = 0.3  # errors of places that are not yet refined
REFINEMENTS, STEPS = 3, 3  # associations of a candidate, and steps of its state after each
LARGEST_STEP = (1.0, 1.0, 0.3, 1.0)  # m, m, rad, m: of a state; the last is of every clock bias
LEAST_EVIDENCE = 6.0  # of the log evidence, for another place
SAME = np.array([0.5, 0.1])  # m, rad: closer candidates are one mode


class Powers(NamedTuple):
    """Powers of the paths of a stop, with the law of lines of sight and of other paths."""

    power_dbm: FloatArray  # (path,)
    law: PowerLaw

    def direct(self, own: Observations) -> int:
        """Index of the candidate for the line of sight: the strongest of the paths as early as the first."""
        n = len(self.power_dbm)
        return direct_path(own.measured[:n, 0], own.covariance[:n, 0, 0], self.power_dbm)

    def los_odds(self, tiled: Observations, now: TrajectoryState) -> FloatArray:
        """Log density (candidate,) of the powers with `direct` as the line of sight over that without.

        Behind a flat array its power says nothing: the gain of the mirrored departure was taken from it.
        """
        first, n = self.direct(tiled), len(now.state)
        length = tiled.measured[:, 0].reshape(n, -1) - now.state[:, 3:]
        x, y = (now.state[:, :2] - tiled.tx_rows[0, :2]).T
        distance = np.hypot(x, y)
        densities = [
            [log_powers(self.power_dbm, length[k], distance[k], los, self.law) for los in (first, -1)]
            for k in range(n)
        ]
        odds = np.asarray(np.subtract(*np.transpose(densities)))
        is_behind = np.cos(np.arctan2(y, x) - tiled.tx_rows[0, 2]) < 0
        return np.where(is_behind & tiled.is_mirrored, 0.0, odds)


class DoubtfulStops(NamedTuple):
    """Stops that the landmarks of the walk are to place, states of all stops to start from, and their powers."""

    is_doubtful: BoolArray  # (stop,)
    starts: Sequence[FloatArray]  # (start, 4) of every stop
    powers: Sequence[Powers]  # of every stop
    max_bias_m: float


@dataclass(frozen=True)
class Place:
    """A stop as the landmarks place it.

    Attributes
    ----------
    state : (4,) of the best candidate; the present one if no other is better by `LEAST_EVIDENCE`
    is_new : whether it is another place than the present one
    is_los : (path,) of the stop
    gain : log evidence of the best candidate over the present state as it is
    evidence : log evidence of the state over clutter alone, the unknowns integrated out in Gaussian approximation
    position_std_m : of the position, from the paths of the stop with the landmarks held
    gap : log odds over the best other mode; NaN where there is none
    rival : (4,) that mode
    los_probability : of all candidates with a line of sight
    square_m2 : mean square distance of the candidates from the best, by their probabilities
    """

    state: FloatArray
    is_new: bool
    is_los: BoolArray
    gain: float
    evidence: float
    position_std_m: float
    gap: float
    rival: FloatArray
    los_probability: float
    square_m2: float


def placed(
    seen: Observations,
    now: TrajectoryState,
    spans: FloatArray,
    stop: int,
    is_known: BoolArray,
    doubtful: DoubtfulStops,
    config: TrajectoryConfig,
) -> Place:
    """One stop placed by the landmarks of `now`, of the `spans` (wall, 2), and by its neighbours.

    `is_known` (stop,) says whose states of `now` hold. A stop that is known stays where no other place is clearly
    better.
    """
    own, starts, powers = seen.of_stop(stop), doubtful.starts[stop], doubtful.powers[stop]
    others = is_known & (np.arange(len(is_known)) != stop)
    near = replace(now, state=between_known(now.state, others))
    beside = neighbour_states(near.state, stop)
    candidates = np.concatenate(
        [
            now.state[[stop]],
            starts,
            beside,
            sight_states(own, near, stop, powers.direct(own), float(near.state[stop, 3])),
            agreeing_states(own, near, stop, doubtful.max_bias_m),
        ]
    )
    copies, point = _tiled(own, now, stop, candidates)
    found = _refined(copies, point, spans, 1 + len(starts), powers, config)
    here = _associated(*_tiled(own, now, stop, now.state[[stop]]), spans, powers, config)
    motion = [motion_about(now.state, others, stop, each.now.state, config) for each in (here, found)]
    least = np.concatenate(motion).min()  # that of the walk itself
    present, score = (
        _log_evidence(each, config) - cost + least for each, cost in zip((here, found), motion, strict=True)
    )
    return _ranked(found, score, float(present[0]), LEAST_EVIDENCE if is_known[stop] else 0.0)


class _Candidates(NamedTuple):
    """Candidates as stops of their own, with the association of their paths."""

    seen: Observations
    now: TrajectoryState
    link: Association
    information: FloatArray  # (candidate, 4, 4) of the paths with the landmarks held
    los_odds: FloatArray  # (candidate,) log density of the powers with a line of sight over that without

    @property
    def is_los(self) -> BoolArray:
        """Lines of sight (candidate, path)."""
        return np.reshape(self.link.kind == PathClass.LOS, (len(self.los_odds), -1))


def _refined(
    tiled: Observations,
    point: TrajectoryState,
    spans: FloatArray,
    n_known: int,
    powers: Powers,
    config: TrajectoryConfig,
) -> _Candidates:
    """Association and steps in turns, from candidates of which the first `n_known` are near their places."""
    paths = _widened(tiled, n_known)
    for _ in range(REFINEMENTS):
        link = _associated(paths, point, spans, powers, config).link
        point, paths = stepped(paths, link, point, config), tiled
    return _associated(tiled, point, spans, powers, config)


def _associated(
    paths: Observations, point: TrajectoryState, spans: FloatArray, powers: Powers, config: TrajectoryConfig
) -> _Candidates:
    """Candidates with the classes of their paths."""
    odds = powers.los_odds(paths, point)
    direct = powers.direct(paths) + len(powers.power_dbm) * np.arange(paths.n_stops)
    link = reclassify_paths(paths, point, _lines_of_sight(paths, point, direct, odds, config), spans, config)
    information, _ = state_equations(paths, link, point, config)
    has_los = np.bincount(paths.row, link.kind == PathClass.LOS, paths.n_stops) > 0
    return _Candidates(paths, point, link, information, np.where(has_los, odds, 0.0))


def _log_evidence(found: _Candidates, config: TrajectoryConfig) -> FloatArray:
    """Log evidence (candidate,) over clutter alone, the state integrated out in Gaussian approximation."""
    gain = path_gains(found.seen, found.link, found.now, config) - _log_choices(found)
    gain = np.maximum(gain, 0.0)
    scales = motion_scales(config)
    volume = 0.5 * np.linalg.slogdet(found.information + np.diag(scales**-2.0))[1] + np.log(scales).sum()
    return np.asarray(np.bincount(found.seen.row, gain, found.seen.n_stops) + found.los_odds - volume)


def _log_choices(found: _Candidates) -> FloatArray:
    """Logarithm (path,) of the number of landmarks, or of pairs of walls, that the one of a path was chosen from.

    The more there are, the better the best agrees by chance.
    """
    kind, walls = found.link.kind, len(found.now.walls)
    landmarks = walls + len(found.now.objects) + len(found.now.raised)
    is_one = np.isin(kind, [PathClass.WALL, PathClass.OBJECT, PathClass.RAISED])
    choices = np.where(is_one, landmarks, np.where(kind == PathClass.DOUBLE, walls * (walls - 1), 1))
    return np.log(choices)


def _ranked(found: _Candidates, score: FloatArray, present: float, least: float) -> Place:
    """The best candidate by `score` (candidate,), with its rival.

    The first one is the present state, refined: another has to be better by `least`.
    """
    state = found.now.state
    best = int(score.argmax()) if score.max() > score[0] + least else 0
    place, heading = state[:, :2] - state[best, :2], state[:, 2] - state[best, 2]
    is_other = (np.hypot(*place.T) > SAME[0]) | (np.abs(wrap_angle(heading)) > SAME[1])
    probability = np.exp(score - score.max()) * (is_other | (np.arange(len(score)) == best))
    probability /= probability.sum()
    rival = int(np.where(is_other, score, -np.inf).argmax())
    return Place(
        state=state[best],
        is_new=best > 0 and bool(is_other[0]),
        is_los=found.is_los[best],
        gain=float(score[best]) - present,
        evidence=float(score[best]),
        position_std_m=float(np.sqrt(np.trace(np.linalg.inv(found.information[best])[:2, :2]))),
        gap=float(score[best] - score[rival]) if is_other.any() else np.nan,
        rival=state[rival],
        los_probability=float(probability[found.is_los.any(axis=1)].sum()),
        square_m2=float(probability @ np.sum(place**2, axis=1)),
    )


def certain_landmarks(
    seen: Observations, link: Association, now: TrajectoryState, is_certain: BoolArray
) -> tuple[TrajectoryState, FloatArray]:
    """The walk with the landmarks that stops which are certain (stop,) show, and the spans of its walls.

    Doubtful stops that err together make landmarks of their own, which would hold them where they are. With no
    landmark of a certain stop all are taken.
    """
    kind, known = link.kind.copy(), is_certain[seen.row]
    for one in (PathClass.WALL, PathClass.OBJECT, PathClass.RAISED):
        mine = link.kind == one
        kind[mine & ~np.isin(link.landmark[:, 0], link.landmark[mine & known, 0])] = PathClass.UNUSED
    kind[kind == PathClass.DOUBLE] = PathClass.UNUSED
    fewer, theirs = drop_unused_landmarks(now, replace(link, kind=kind))
    if not len(fewer.walls) + len(fewer.objects) + len(fewer.raised):
        fewer, theirs = now, link
    return fewer, wall_spans(seen, theirs, fewer)


def wall_spans(seen: Observations, link: Association, now: TrajectoryState) -> FloatArray:
    """The intervals (wall, 2) along the walls where the paths assigned to them bounce; empty ones without any."""
    spans = np.tile([np.inf, -np.inf], (len(now.walls), 1))
    path = np.flatnonzero(link.kind == PathClass.WALL)
    wall = link.landmark[path, 0]
    place, _, _ = wall_places(now.walls[wall], seen.tx_rows[path], now.state[seen.row[path], :2])
    np.minimum.at(spans[:, 0], wall, place)
    np.maximum.at(spans[:, 1], wall, place)
    return spans


def path_gains(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> FloatArray:
    """Log density (path,) of the paths in their classes over that of clutter; 0 of paths not in use.

    A single bounce off any place has one residual: its density is that of the gap of its rays, over any range.
    """
    whole = linearise(seen, link, now, config).log_density(config.degrees_of_freedom) - CLUTTER_LOG_DENSITY
    gain = np.where(np.isfinite(whole), whole, 0.0)
    lone = np.flatnonzero(link.kind == PathClass.BOUNCE)
    if len(lone):
        measured = without_heading_offsets(seen, now, lone)
        terms = bounce_terms(seen.tx_rows[lone], measured, seen.covariance[lone], now.state[seen.row[lone]])
        freedom = config.degrees_of_freedom
        square = terms.value_m**2 / terms.variance_m2
        density = student_t_log_peak(freedom, 1) - (freedom + 1) / 2 * np.log1p(square / freedom)
        gain[lone] = density - 0.5 * np.log(terms.variance_m2) + np.log(LARGEST_RANGE_M)
    return gain


def _tiled(
    own: Observations, now: TrajectoryState, stop: int, states: FloatArray
) -> tuple[Observations, TrajectoryState]:
    """The paths of a stop once for every state (candidate, 4), each as a stop of its own."""
    copies, _ = own.copies(np.zeros(len(states), np.int64))
    return copies, now.apart(states.copy(), np.full(len(states), stop))


def _widened(seen: Observations, first: int) -> Observations:
    """The paths as they may look from places that err by `WIDE_M`, from the stop `first` on."""
    angle = WIDE_M / np.maximum(seen.measured[:, 0], WIDE_M)
    std = np.column_stack([np.full(len(angle), WIDE_M), angle, angle]) * (seen.row >= first)[:, None]
    return replace(seen, covariance=seen.covariance + np.square(std)[:, None] * np.eye(3))


def _lines_of_sight(
    seen: Observations, now: TrajectoryState, direct: IntArray, odds: FloatArray, config: TrajectoryConfig
) -> BoolArray:
    """Which paths (path,) are lines of sight: that of `direct` (stop,) of each stop, within the gate of one.

    Its delay, angles and power, of log odds `odds` (stop,), have to be more probable than as a single bounce or
    as clutter.
    """
    own, none = seen.take(direct), np.full((len(direct), 2), -1)
    links = [Association(np.full(len(direct), kind), none) for kind in (PathClass.LOS, PathClass.BOUNCE)]
    as_sight, as_bounce = (path_gains(own, link, now, config) for link in links)
    distance = linearise(own, links[0], now, config).square()
    result = np.zeros(len(seen.row), bool)
    is_better = as_sight + odds > np.maximum(as_bounce, 0.0)
    result[direct] = is_better & (distance < chi_square_quantile(config.gate_probability, 3))
    return result


def stepped(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> TrajectoryState:
    """Every state after steps of its own: landmarks and offsets are held, and there is no walk."""
    largest = now.per_unknown(LARGEST_STEP)
    for _ in range(STEPS):
        information, gradient = state_equations(seen, link, now, config)
        step = -np.linalg.solve(information, gradient[..., None])[..., 0]
        now = replace(now, state=now.state + np.clip(step, -largest, largest))
    return now
