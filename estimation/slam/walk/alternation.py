"""Alternation between the association of paths to landmarks and least squares for the trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimation.distributions import chi_square_quantile
from estimation.laws.plane import state_columns
from estimation.slam.config import TrajectoryConfig
from estimation.slam.mapping.noise import LEAST_GAIN, SHARES
from estimation.slam.walk.association import classify_paths, drop_unused_landmarks, reclassify_paths
from estimation.slam.walk.flats import excess_law, learned_flats, with_possible_excess
from estimation.slam.walk.planes import split_wall
from estimation.slam.walk.relocate import (
    LEAST_EVIDENCE,
    DoubtfulStops,
    Place,
    certain_landmarks,
    path_gains,
    placed,
    wall_spans,
)
from estimation.slam.walk.residuals import (
    LEAST_SPARE,
    Association,
    Observations,
    PathClass,
    TrajectoryState,
    certain_paths,
    own_bounces,
    spare_equations,
)
from estimation.slam.walk.roughness import is_rough, own_roughness
from estimation.slam.walk.sessions import split_sessions
from estimation.slam.walk.smoother import LANDMARK_INFORMATION, minimise_robust_cost, normal_equations
from estimation.steps import steps
from scenes.record import BoolArray

WALK_SHARES = (*SHARES, 0.01, 0.003, 0.001, 0.0003)  # of the floors: a whole walk tells less noise than one stop
_MOST_IN_VAIN = 2  # steps of less evidence than the best, after which no lower noise is tried
_ROUGH_ITERATIONS = 6  # enough where the association will change
_MAX_ROUNDS = 10
_STOPS_PER_CHANGE = 256  # of a walk whose association counts as constant though a path still changes
_PLACINGS = 2
_ROUGHNESS_TURNS = 2
_ROUGH_TURNS = 4
_LEVEL_PROBABILITY = 0.9  # of a bounce off a place of its own, to count for its stop
_MOST_SPLITS = 6


class Noise(NamedTuple):
    """Paths with their covariances, and settings with the roughness of surfaces."""

    seen: Observations
    config: TrajectoryConfig

    def lower(self, share: float) -> Noise:
        """With this share of the floors; the roughness of walls and objects falls with its root."""
        root = float(np.sqrt(share))
        rough = {name: root * getattr(self.config, name) for name in ("wall_roughness_m", "object_roughness_m")}
        return Noise(self.seen.with_floor(share), self.config.model_copy(update=rough))

    def with_objects_of(self, other: Noise) -> Noise:
        """With the roughness of objects of other settings."""
        rough = {"object_roughness_m": other.config.object_roughness_m}
        return Noise(self.seen, self.config.model_copy(update=rough))


class SmoothedWalk(NamedTuple):
    """A walk with the association of its paths, and the noise that it was fitted with."""

    now: TrajectoryState
    link: Association
    noise: Noise
    is_los: BoolArray
    places: dict[int, Place]  # of the stops that its landmarks placed

    @property
    def evidence(self) -> float:
        """Log evidence of all paths in use over that of clutter.

        A bounce off no landmark that is less probable than clutter counts as clutter. The unknowns are integrated
        out in Gaussian approximation: with few paths for many unknowns low noise explains anything, and is no
        better for it.
        """
        seen, config = self.noise
        gain = path_gains(seen, self.link, self.now, config)
        gain = np.where(self.link.kind == PathClass.BOUNCE, np.maximum(gain, 0.0), gain)
        information = normal_equations(seen, self.link, self.now, config).log_determinant()
        prior = (self.now.walls.size + self.now.objects.size + self.now.raised.size) * np.log(LANDMARK_INFORMATION)
        return float(gain.sum() + (prior - information) / 2)


def smooth_walk(
    seen: Observations,
    is_los: BoolArray,
    start: TrajectoryState,
    config: TrajectoryConfig,
    doubtful: DoubtfulStops | None = None,
) -> SmoothedWalk:
    """Motion prior alone, then with landmarks and sessions, then doubtful stops again, then with less noise.

    The floors of the noise and the roughness of surfaces are wide, for errors that are not in the covariances of
    paths. Lower ones follow step by step, each from the solution before; the one of most evidence is kept. All
    fall together: rough objects would hide what less noise explains. Objects that are no circles get their
    roughness back where that has more evidence. In the end every landmark gets one of its own on the same terms.
    """
    wide = Noise(seen, config)
    now, _ = _alternate(wide, wide, is_los, start, use_landmarks=False)
    walks = [_with_landmarks(wide, wide, is_los, now)]
    if doubtful is not None and config.use_landmarks:
        walks = [_relocated(walks[0], wide, doubtful)]
    if not (seen.floor.any() and config.use_landmarks):
        return walks[0]
    evidence, best = [walks[0].evidence], 0
    for share in steps(WALK_SHARES, "trial of the path noise"):
        walks.append(_with_noise(walks[-1], wide.lower(share), wide))
        evidence.append(walks[-1].evidence)
        best = int(np.argmax(evidence))
        if len(evidence) - 1 - best >= _MOST_IN_VAIN:
            break
    walks.append(_with_noise(walks[best], walks[best].noise.with_objects_of(wide), wide))
    evidence.append(walks[-1].evidence)
    best = int(np.argmax(evidence))
    walk = walks[best] if evidence[best] > evidence[0] + LEAST_GAIN else walks[0]
    if doubtful is not None:
        walk = _relocated(walk, wide, doubtful)
    own = _with_own_roughness(walk)
    walk = own if own.evidence > walk.evidence + LEAST_GAIN else walk
    return _with_unchecked_bounces(_with_rough_paths(walk, wide))


def _with_unchecked_bounces(walk: SmoothedWalk) -> SmoothedWalk:
    """The walk again, with the possible excess of bounces that nothing checks as an error."""
    (seen, config), link = walk.noise, walk.link
    unsure = with_possible_excess(seen, link, walk.now)
    if unsure is seen:
        return walk
    now = minimise_robust_cost(unsure, link, walk.now, config)
    return walk._replace(now=now, noise=Noise(unsure, config))


def _with_rough_paths(walk: SmoothedWalk, wide: Noise) -> SmoothedWalk:
    """The walk again, with the wide noise for paths that its own does not explain."""
    (seen, config), link = walk.noise, walk.link
    is_wall = np.isin(link.kind, [PathClass.WALL, PathClass.DOUBLE])
    larger = np.where(
        is_wall,
        wide.config.wall_roughness_m / config.wall_roughness_m,
        wide.config.object_roughness_m / config.object_roughness_m,
    )
    for _ in range(_ROUGH_TURNS):
        mine = is_rough(seen, wide.seen, link, larger, walk.now, config)
        covariance = np.where(mine[:, None, None], wide.seen.covariance, seen.covariance)
        mixed = Noise(replace(seen, covariance=covariance), config)
        own = replace(link, rough=np.where(mine, larger, link.rough))
        now = minimise_robust_cost(mixed.seen, own, walk.now, config)
        walk = walk._replace(now=now, link=own, noise=mixed)
    return walk


def _with_own_roughness(walk: SmoothedWalk) -> SmoothedWalk:
    """The walk again with a roughness of its own for every landmark, learned and fitted in turns."""
    seen, config = walk.noise
    for _ in range(_ROUGHNESS_TURNS):
        link = own_roughness(seen, walk.link, walk.now, config)
        walk = walk._replace(link=link, now=minimise_robust_cost(seen, link, walk.now, config))
    return walk


def _with_noise(walk: SmoothedWalk, noise: Noise, wide: Noise) -> SmoothedWalk:
    """The walk again with other noise, from the solution before.

    Landmarks found anew may be fewer, and their loss would count against the noise. So the landmarks and paths of
    the solution before are fitted too; the one of more evidence is kept.
    """
    kept = minimise_robust_cost(noise.seen, walk.link, walk.now, noise.config)
    again = _with_landmarks(noise, wide, walk.is_los, walk.now, learns_flats=False)
    found = again, walk._replace(now=kept, noise=noise)
    return _best_with_planes(found, wide)._replace(places=walk.places)


def _best_with_planes(walks: Sequence[SmoothedWalk], wide: Noise) -> SmoothedWalk:
    """The walk of most evidence, each with walls of two planes first: their shifts may look like a session."""
    return max((_with_planes(walk, wide) for walk in walks), key=lambda one: one.evidence)


def _with_planes(walk: SmoothedWalk, wide: Noise) -> SmoothedWalk:
    """The walk with walls of two planes, where that has more evidence."""
    seen, config = walk.noise
    for _ in range(_MOST_SPLITS):
        start, link = split_wall(seen, walk.link, walk.now, config)
        if np.array_equal(link.landmark, walk.link.landmark):
            break
        now = minimise_robust_cost(seen, link, start, config)
        new = reclassify_paths(wide.seen, now, walk.is_los, wall_spans(seen, link, now), wide.config)
        anew_now, new = _confirm_bounces(seen, new, minimise_robust_cost(seen, new, now, config), config)
        anew = walk._replace(now=anew_now, link=new)
        two = max(walk._replace(now=now, link=link), anew, key=lambda one: one.evidence)
        if two.evidence < walk.evidence + LEAST_GAIN:
            break
        walk = two
    return walk


def _relocated(walk: SmoothedWalk, wide: Noise, doubtful: DoubtfulStops) -> SmoothedWalk:
    """The walk with its stops where landmarks of the other, certain stops place them; they show more landmarks.

    A doubtful stop is placed in any case, from the certain ones on, and is known where its paths agree. Another
    moves where its paths have more evidence elsewhere: the mode of a stop alone may be wrong and look certain.
    """
    seen, config = walk.noise
    stops = np.arange(seen.n_stops)
    for _ in range(_PLACINGS):
        is_doubtful = doubtful.is_doubtful | (spare_equations(seen, walk.link) < LEAST_SPARE)
        certain = np.flatnonzero(~is_doubtful)
        away = np.abs(stops[:, None] - certain).min(axis=1, initial=seen.n_stops)
        is_known, places, is_settled = ~is_doubtful, {}, True
        state, is_los, is_moved = walk.now.state.copy(), walk.is_los.copy(), np.zeros(seen.n_stops, bool)
        for stop in np.argsort(away, kind="stable").tolist():
            if not (seen.row == stop).any():
                continue
            marks, spans = certain_landmarks(seen, walk.link, walk.now, ~is_doubtful & (stops != stop))
            place = placed(seen, replace(marks, state=state), spans, stop, is_known, doubtful, config)
            places[stop] = place
            if is_doubtful[stop] or place.gain > LEAST_EVIDENCE:
                state[stop], is_los[seen.row == stop], is_moved[stop] = place.state, place.is_los, True
                is_settled &= not place.is_new
            is_known[stop] |= place.evidence > LEAST_EVIDENCE
        now = replace(walk.now, state=state)
        found = _with_landmarks(walk.noise, wide, is_los, now), _reassigned(walk, wide, is_los, now, is_moved)
        walk = _best_with_planes(found, wide)._replace(places=places)
        if is_settled:
            break
    return walk


def _reassigned(
    walk: SmoothedWalk, wide: Noise, is_los: BoolArray, now: TrajectoryState, is_moved: BoolArray
) -> SmoothedWalk:
    """The walk with its landmarks and other states of some stops, whose paths are associated anew."""
    seen, config = walk.noise
    new = reclassify_paths(wide.seen, now, is_los, wall_spans(seen, walk.link, walk.now), wide.config)
    mine = is_moved[seen.row]
    link = Association(
        np.where(mine, new.kind, walk.link.kind),
        np.where(mine[:, None], new.landmark, walk.link.landmark),
        np.where(mine, 1.0, walk.link.rough),
    )
    now, link = drop_unused_landmarks(minimise_robust_cost(seen, link, now, config), link)
    now, link = _confirm_bounces(seen, link, now, config)
    return walk._replace(now=now, link=link, is_los=is_los)


def _with_landmarks(
    noise: Noise, wide: Noise, is_los: BoolArray, now: TrajectoryState, *, learns_flats: bool = True
) -> SmoothedWalk:
    """The walk with landmarks, then with sessions, each until the association is constant.

    Floor and ceiling are learned first: they take long, and other noise hardly moves them.
    """
    if wide.config.use_landmarks and wide.seen.heights is not None and learns_flats:
        now = replace(now, flats=learned_flats(wide.seen, now, is_los))
    now, link = _settled(noise, wide, is_los, now)
    while wide.config.use_sessions:
        split = split_sessions(noise.seen, link, now, noise.config)
        if len(split.offset_rad) == len(now.offset_rad):
            break
        now, link = _settled(noise, wide, is_los, split)
    return SmoothedWalk(now, link, noise, is_los, {})


def _settled(
    noise: Noise, wide: Noise, is_los: BoolArray, now: TrajectoryState
) -> tuple[TrajectoryState, Association]:
    now, link = _alternate(noise, wide, is_los, now, use_landmarks=wide.config.use_landmarks)
    return _confirm_bounces(noise.seen, link, now, noise.config)


def _confirm_bounces(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> tuple[TrajectoryState, Association]:
    """Keep a single bounce without a landmark only where the other paths of its stop do not contradict it.

    Lines of sight and shared landmarks are far more certain. Where a stop has two of them, its other bounces are
    gated against the solution without these bounces, with its covariance. Where beams show no elevation, those
    are left out of the fit as well that probably come from points higher or lower than the devices.
    """
    counted = certain_paths(seen, link) >= 2
    doubted = np.flatnonzero((link.kind == PathClass.BOUNCE) & counted[seen.row])
    kind = link.kind.copy()
    kind[doubted] = PathClass.UNUSED
    without = replace(link, kind=kind)
    alone = minimise_robust_cost(seen, without, now, config)
    covariance = normal_equations(seen, without, alone, config).covariance().states
    row = seen.row[doubted]
    terms = own_bounces(seen, alone, doubted)
    own = state_columns(seen.tx_of_path[doubted])
    covariance = covariance[row[:, None, None], own[:, :, None], own[:, None, :]]
    spread = np.einsum("pi,pij,pj->p", terms.jacobian, covariance, terms.jacobian)
    gate = chi_square_quantile(config.confirm_probability, 1)
    agrees = terms.is_feasible & (terms.value_m**2 <= gate * (terms.variance_m2 + spread))
    kind[doubted[agrees]] = PathClass.BOUNCE
    if seen.heights is not None:
        level = excess_law(*terms.excess_m(spread)).level_probability
        kind[doubted[agrees & (level < _LEVEL_PROBABILITY)]] = PathClass.LONE
    return minimise_robust_cost(seen, replace(link, kind=kind), alone, config), replace(link, kind=kind)


def _alternate(
    noise: Noise, wide: Noise, is_los: BoolArray, now: TrajectoryState, *, use_landmarks: bool
) -> tuple[TrajectoryState, Association]:
    """Alternate association and least squares until the association is constant.

    First landmarks are found from clusters in every round. Then paths are assigned to the estimated landmarks,
    which are more accurate than the clusters they come from. Paths are associated with `wide` noise: a path that
    errs by more than the `noise` of the fit has little weight there, but is no other path.
    """
    config = wide.config.model_copy(update={"use_landmarks": use_landmarks})
    link, now, spans = classify_paths(wide.seen, now, is_los, config, noise)
    for _ in range(_MAX_ROUNDS):
        now = minimise_robust_cost(noise.seen, link, now, noise.config, _ROUGH_ITERATIONS)
        before = link
        link, now, spans = classify_paths(wide.seen, now, is_los, config, noise)
        if _same(link, before, noise.seen.n_stops):
            break
    for _ in range(_MAX_ROUNDS):
        now = minimise_robust_cost(noise.seen, link, now, noise.config, _ROUGH_ITERATIONS)
        before = link
        link = reclassify_paths(wide.seen, now, is_los, spans, config)
        if _same(link, before, noise.seen.n_stops):
            break
    return drop_unused_landmarks(minimise_robust_cost(noise.seen, link, now, noise.config), link)


def _same(link: Association, other: Association, n_stops: int) -> bool:
    """Whether an association is constant: of long walks a few paths between two classes may still change."""
    is_other = (link.kind != other.kind) | (link.landmark != other.landmark).any(axis=1)
    return bool(np.count_nonzero(is_other) <= n_stops // _STOPS_PER_CHANGE)
