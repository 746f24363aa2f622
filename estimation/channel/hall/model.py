"""Heights and clock biases of a campaign from its channel estimates, and the classes of all paths.

A coarse search gives starts. From each, three steps alternate: states of all paths (`classes.py`), their priors,
and a Gauss-Newton step of heights and clocks that brings versions of the same plan path together (`refine.py`).
The start of largest evidence is kept, with the votes of the coarse search: both are approximate, and their errors
differ.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimation.channel.config import LosConfig
from estimation.channel.hall import clocks
from estimation.channel.hall.classes import START, StopStates, learned_priors, stop_states
from estimation.channel.hall.clocks import N_CLOCKS, clocks_by_elevation, own_clock
from estimation.channel.hall.geometry import NO_CEILING_M, Heights
from estimation.channel.hall.paths import RangedPaths, stop_paths
from estimation.channel.hall.power import ElevationLoss, SightPower, StopPowers, stop_powers
from estimation.channel.hall.record import ClassPriors, HallModel
from estimation.channel.hall.refine import stop_equations
from estimation.channel.hall.search import (
    clock_grid,
    height_grid,
    height_log_prior,
    likely_ceilings,
    log_votes,
    starting_clocks,
    starting_heights,
    stop_votes,
)
from estimation.channel.record import ChannelEstimate
from scenes.record import BoolArray, FloatArray
from sim.signal.arrays.codebook import Codebook

CLOCK_STEPS, FIRST_STEPS, LAST_STEPS = 2, 4, 16  # of a clock alone; of every start; of the best ones
N_BEST = 3
LONGEST_STEP_M = np.array([0.1, 0.1, 0.1, clocks.LONGEST_STEP_M])  # heights and clock
LOOSE_STD_M = np.array([3.0, 3.0, 10.0, clocks.LOOSE_STD_M])  # prior of a step
AMBIGUOUS = 10.0  # by how much the merit of another solution may be lower if it is to be named
SAME_M = 0.03  # heights of one solution
# Of a ceiling in log evidence: 45 to 370 at three stops of design rooms that show theirs, -7 to 25 of false ones.
LEAST_CEILING = 35.0
N_CEILINGS = 5  # tried once more at the clocks of the best solution


@dataclass(frozen=True)
class HallLink:
    """What estimates of a campaign share: beams, powers of lines of sight, and the resolution cell in delay."""

    tx_codebook: Codebook
    rx_codebook: Codebook
    los: LosConfig
    cell_s: float

    @cached_property
    def elevation_loss(self) -> ElevationLoss:
        """What its beams lose by elevation, the same at all stops."""
        return ElevationLoss((self.tx_codebook, self.rx_codebook))


@dataclass(frozen=True)
class GivenHeights:
    """Surveyed heights of the devices above the floor, with one standard deviation; None where not surveyed."""

    tx_m: float | None = None
    rx_m: float | None = None
    std_m: float = 0.0

    @property
    def is_given(self) -> BoolArray:
        """Mask (3,) of the heights of TX, receiver and ceiling that were surveyed."""
        return np.array([self.tx_m is not None, self.rx_m is not None, False])

    @property
    def value_m(self) -> FloatArray:
        """Heights (3,); 0 where not surveyed."""
        return np.array([self.tx_m or 0.0, self.rx_m or 0.0, 0.0])


@dataclass(frozen=True)
class _Stops:
    """All estimates with paths, prepared."""

    paths: Sequence[RangedPaths]
    powers: Sequence[StopPowers]
    given: GivenHeights

    @property
    def by_elevation(self) -> bool:
        """Whether elevations tell heights and clocks: not where both devices were surveyed."""
        return not self.given.is_given[:2].all()


@dataclass(frozen=True)
class _Point:
    """Heights (3,), clock biases (stop,) and priors, with the states of all paths there."""

    heights_m: FloatArray
    clock_m: FloatArray
    priors: ClassPriors
    states: Sequence[StopStates]

    @property
    def evidence(self) -> float:
        """Log evidence of all stops with the prior of the heights."""
        return float(sum(stop.evidence for stop in self.states) + height_log_prior(self.heights_m[None])[0])


def read_hall(
    estimates: Sequence[ChannelEstimate], link: HallLink, given: GivenHeights = GivenHeights()
) -> HallModel | None:
    """Heights of floor, ceiling and receiver from the estimates of a campaign; None where no stop has two paths.

    The floor is the origin of heights. The receiver has one height at all stops; clock biases are free. Give the
    height of the TX where it is known: without it other sets of heights often explain the paths as well. Estimates
    of fewer than two paths are left out.
    """
    used = [estimate for estimate in estimates if len(estimate) > 1]
    if not used:
        return None
    stops = prepared_stops(used, link, given)
    grids = [clock_grid(paths) for paths in stops.paths]
    votes = [stop_votes(paths, clock) for paths, clock in zip(stops.paths, grids, strict=True)]
    sight = SightPower(used, stops.powers, grids, link.los)
    heights = starting_heights(votes, sight.log_prior, height_grid(given.tx_m, given.rx_m))
    points = []
    for start in heights:
        tried = starting_clocks(votes, sight.log_prior, start, N_CLOCKS)
        point = _climbed(stops, _with_best_clocks(stops, start, START, tried), FIRST_STEPS)
        points.append((point, tried))

    def merit(point: _Point) -> float:
        same_priors = _at(stops, point.heights_m, point.clock_m, START)
        return same_priors.evidence + log_votes(votes, sight.log_prior, point.heights_m)

    points.sort(key=lambda one: -merit(one[0]))
    settled = [_settled(stops, *one) for one in points[:N_BEST]]
    ranked = sorted(((merit(point), point) for point in settled), key=lambda one: -one[0])
    best = _with_checked_ceiling(stops, ranked[0][1], merit)
    ranked[0] = merit(best), best
    return _model(used, stops, ranked)


def _with_checked_ceiling(stops: _Stops, point: _Point, merit: Callable[[_Point], float]) -> _Point:
    """The point with the best of the ceilings that explain most at its clocks, or without one where none shows."""
    without = _at_ceiling(stops, point, NO_CEILING_M)
    known = zip(stops.paths, without.clock_m, strict=True)
    votes = [stop_votes(paths, np.array([clock_m])) for paths, clock_m in known]
    tried = [_at_ceiling(stops, without, one) for one in likely_ceilings(votes, without.heights_m, N_CEILINGS)]
    best = max([point, *tried], key=merit)
    return best if best.evidence - without.evidence > LEAST_CEILING else without


def _at_ceiling(stops: _Stops, point: _Point, ceiling_m: float) -> _Point:
    """The point after steps from another height of the ceiling."""
    heights_m = np.append(point.heights_m[:2], ceiling_m)
    return _climbed(stops, _at(stops, heights_m, point.clock_m, point.priors), LAST_STEPS)


def prepared_stops(estimates: Sequence[ChannelEstimate], link: HallLink, given: GivenHeights) -> _Stops:
    """Paths and powers of estimates."""
    books = (link.tx_codebook, link.rx_codebook)
    paths = [stop_paths(estimate, *books) for estimate in estimates]
    powers = [
        stop_powers(estimate, own, link.elevation_loss, link.los, link.cell_s)
        for estimate, own in zip(estimates, paths, strict=True)
    ]
    return _Stops(paths, powers, given)


def _with_best_clocks(
    stops: _Stops, heights_m: FloatArray, priors: ClassPriors, tried: Sequence[FloatArray]
) -> _Point:
    """The point at these heights with the best of the clocks tried at every stop, each after steps of its own."""
    differences, by_elevation = Heights(*heights_m).differences_m, stops.by_elevation
    best, clock = [], []
    for paths, powers, biases in zip(stops.paths, stops.powers, tried, strict=True):
        reached = [
            own_clock(paths, powers, float(bias), differences, priors, CLOCK_STEPS, by_elevation=by_elevation)
            for bias in biases
        ]
        bias, states = max(reached, key=lambda one: one[1].evidence)
        best.append(states)
        clock.append(bias)
    return _Point(heights_m, np.array(clock), priors, best)


def _settled(stops: _Stops, point: _Point, tried: Sequence[FloatArray]) -> _Point:
    """The point of largest evidence from this one, with the clocks tried once more, and those of elevations."""
    differences = Heights(*point.heights_m).differences_m
    shown = [
        clocks_by_elevation(paths, powers, differences, point.priors)
        for paths, powers in zip(stops.paths, stops.powers, strict=True)
    ]
    every = [np.concatenate([*each, [now]]) for *each, now in zip(tried, shown, point.clock_m, strict=True)]
    again = _with_best_clocks(stops, point.heights_m, point.priors, every)
    return _climbed(stops, _better(point, again), LAST_STEPS)


def _at(stops: _Stops, heights_m: FloatArray, clock_m: FloatArray, priors: ClassPriors) -> _Point:
    differences = Heights(*heights_m).differences_m
    states = [
        stop_states(paths, powers, float(bias), differences, priors)
        for paths, powers, bias in zip(stops.paths, stops.powers, clock_m, strict=True)
    ]
    return _Point(heights_m, clock_m, priors, states)


def _climbed(stops: _Stops, point: _Point, n_steps: int) -> _Point:
    """The point after steps of heights, clocks and priors, none of which lowers the evidence."""
    for _ in range(n_steps):
        point = _better(point, _at(stops, point.heights_m, point.clock_m, learned_priors(point.states)))
        information, slope = _equations(stops, point)
        step = np.linalg.solve(information, slope)
        limit = np.concatenate([LONGEST_STEP_M[:3], np.full(len(point.clock_m), LONGEST_STEP_M[3])])
        step *= min(1.0, float((limit / np.maximum(np.abs(step), 1e-12)).min()))
        for share in (1.0, 0.3, 0.1):
            heights = point.heights_m + share * step[:3]
            if not Heights(*heights).are_possible:
                continue
            trial = _at(stops, heights, point.clock_m + share * step[3:], point.priors)
            if trial.evidence >= point.evidence:
                point = trial
                break
        else:
            break
        if np.abs(step).max() < clocks.SMALLEST_STEP_M:
            break
    return point


def _better(one: _Point, two: _Point) -> _Point:
    return two if two.evidence > one.evidence else one


def _equations(stops: _Stops, point: _Point) -> tuple[FloatArray, FloatArray]:
    """Normal equations of the heights (3,) and the clocks (stop,), with a loose prior on the step."""
    n = len(point.clock_m)
    information, slope = np.zeros((3 + n, 3 + n)), np.zeros(3 + n)
    loose = np.concatenate([LOOSE_STD_M[:3], np.full(n, LOOSE_STD_M[3])])
    information[np.diag_indices(3 + n)] = 1 / loose**2
    differences, by_elevation = Heights(*point.heights_m).differences_m, stops.by_elevation
    for index, (paths, powers, states) in enumerate(zip(stops.paths, stops.powers, point.states, strict=True)):
        clock_m = float(point.clock_m[index])
        part = stop_equations(paths, powers, states, clock_m, differences, by_elevation=by_elevation)
        rows = np.array([0, 1, 2, 3 + index])
        information[np.ix_(rows, rows)] += part.information
        slope[rows] += part.slope
    for row in np.flatnonzero(stops.given.is_given):
        if stops.given.std_m > 0:
            information[row, row] += 1 / stops.given.std_m**2
            slope[row] += (stops.given.value_m[row] - point.heights_m[row]) / stops.given.std_m**2
        else:
            information[row], information[:, row], slope[row] = 0.0, 0.0, 0.0
            information[row, row] = 1.0
    return information, slope


def _model(
    estimates: Sequence[ChannelEstimate], stops: _Stops, ranked: Sequence[tuple[float, _Point]]
) -> HallModel:
    """The model at the best of the points, which come with their merits, the best first."""
    merit, best = ranked[0]
    information, _ = _equations(stops, best)
    covariance = np.asarray(np.linalg.inv(information), float)
    if stops.given.std_m == 0:
        exact = np.flatnonzero(stops.given.is_given)
        covariance[exact] = covariance[:, exact] = 0.0
    std = np.sqrt(np.diagonal(covariance))
    others = [
        (point.heights_m, other)
        for other, point in ranked[1:]
        if np.abs(point.heights_m - best.heights_m).max() > 3 * std[:3].max() + SAME_M
        and other > merit - AMBIGUOUS
    ]
    model = HallModel(
        heights_m=best.heights_m,
        covariance_m2=covariance[:3, :3],
        stop=np.array([estimate.stop for estimate in estimates]),
        clock_m=best.clock_m,
        clock_std_m=std[3:],
        merit=merit,
        other_heights_m=np.array([heights for heights, _ in others]).reshape(-1, 3),
        other_merit=np.array([other for _, other in others]),
        caveats=np.zeros(0, str),
        priors=best.priors,
        by_elevation=stops.by_elevation,
    )
    return replace(model, caveats=np.array(_caveats(stops, model), str))


def _caveats(stops: _Stops, model: HallModel) -> tuple[str, ...]:
    """What the estimates cannot tell, in words."""
    found = []
    if not model.sees_ceiling:
        found.append("no ceiling shows")
    level, floor, ceiling = np.abs(model.heights.differences_m[:3])
    std_m = float(np.max(model.height_std_m[:2] if not model.sees_ceiling else model.height_std_m))
    if abs(floor - ceiling) < 3 * std_m + 0.02:
        found.append("floor and ceiling are as far from the devices: their versions coincide")
    sees = any(paths.sees_elevation.any() for paths in stops.paths)
    if not sees and level < 3 * std_m:
        found.append("devices at equal heights: no level path shows a height difference")
    if stops.given.tx_m is None:
        found.append("height of the TX unknown: another set of heights may have nearly the same versions")
    if len(model.other_merit):
        found.append(f"{len(model.other_merit)} other solutions explain the paths nearly as well")
    return tuple(found)
