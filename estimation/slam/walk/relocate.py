"""Stops placed again by the landmarks of a walk, with their rivals.

A stop alone can have several modes, or none: landmarks that other stops show decide between them. A path off a
wall leaves the image of the TX in that wall as a line of sight leaves the TX. So at a given place every path
tells, by way of an image or an object, the heading and the clock bias. The places of a grid where most paths
agree, the modes of the stop alone, and the states of its neighbours are tried. Each is refined with the landmarks
held, and the one of most evidence is kept: of its paths over clutter, and of the walk.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2

from estimation.laws.plane import predict_los, residual
from estimation.laws.wall import wall_places
from estimation.slam.config import TrajectoryConfig
from estimation.slam.mapping.noise import LARGEST_RANGE_M
from estimation.slam.snapshot.refine import bounce_terms
from estimation.slam.walk.association import reclassify_paths
from estimation.slam.walk.linearise import linearise
from estimation.slam.walk.motion import motion_cost, motion_scales
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
REACH_STEPS, REACH_M = 3.0, (2.0, 8.0)  # half the side of the grid of places, in steps of the walk
GRID = 21  # places along a side
AGREE_M, AGREE_RAD = 0.3, 0.1  # of clock biases, beside the step of the grid, and of headings
GATE_STDS = 3.0  # of departures
MOST_PATHS = 24  # that are compared at the places of the grid
MOST_PLACES = 40  # of the grid that are refined, those where most paths agree
WIDE_M = 0.3  # errors of places that are not yet refined
REFINEMENTS, STEPS = 3, 3  # associations of a candidate, and steps of its state after each
LARGEST_STEP = np.array([1.0, 1.0, 0.3, 1.0])
LEAST_GAIN = 6.0  # of the log evidence, for another place
SAME = np.array([0.5, 0.1])  # m, rad: closer candidates are one mode


@dataclass(frozen=True)
class Place:
    """A stop as the landmarks place it.

    Attributes
    ----------
    state : (4,) of the best candidate; the present one if no other is better by `LEAST_GAIN`
    is_new : whether it is another place than the present one
    is_los : (path,) of the stop
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
    evidence: float
    position_std_m: float
    gap: float
    rival: FloatArray
    los_probability: float
    square_m2: float


def placed(
    seen: Observations,
    link: Association,
    now: TrajectoryState,
    stop: int,
    starts: FloatArray,
    config: TrajectoryConfig,
    max_bias_m: float,
) -> Place:
    """One stop placed by the landmarks of `now` and its neighbours, from `starts` (start, 4) and a grid."""
    own, spans = seen.of_stop(stop), wall_spans(seen, link, now)
    agreeing = _agreeing(own, now, stop, max_bias_m)
    candidates = np.concatenate([now.state[[stop]], starts, _neighbours(now, stop), agreeing])
    tiled, point = _tiled(own, now, stop, candidates)
    for paths in (_widened(tiled, 1 + len(starts)), *[tiled] * REFINEMENTS):
        los = _lines_of_sight(paths, point, config)
        link = reclassify_paths(paths, point, los, spans, config)
        information, _ = state_equations(paths, link, point, config)
        before, point = point, _stepped(paths, link, point, config)
    gain = np.bincount(tiled.row, np.maximum(path_gains(tiled, link, before, config), 0.0), len(candidates))
    score = gain - np.array([_motion(now, stop, state, config) for state in before.state])
    scales = motion_scales(config)
    score -= 0.5 * np.linalg.slogdet(information + np.diag(scales**-2.0))[1] + np.log(scales).sum()
    best = int(score.argmax()) if score.max() > score[0] + LEAST_GAIN else 0
    place, heading = before.state[:, :2] - before.state[best, :2], before.state[:, 2] - before.state[best, 2]
    is_other = (np.hypot(*place.T) > SAME[0]) | (np.abs(wrap_angle(heading)) > SAME[1])
    probability = np.exp(score - score.max()) * (is_other | (np.arange(len(score)) == best))
    probability /= probability.sum()
    has_los = los.reshape(len(candidates), -1)
    rival = int(np.where(is_other, score, -np.inf).argmax())
    return Place(
        state=before.state[best],
        is_new=best > 0 and bool(is_other[0]),
        is_los=has_los[best],
        evidence=float(score[best]),
        position_std_m=float(np.sqrt(np.trace(np.linalg.inv(information[best])[:2, :2]))),
        gap=float(score[best] - score[rival]) if is_other.any() else np.nan,
        rival=before.state[rival],
        los_probability=float(probability[has_los.any(axis=1)].sum()),
        square_m2=float(probability @ np.sum(place**2, axis=1)),
    )


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
        peak = gammaln((freedom + 1) / 2) - gammaln(freedom / 2) - 0.5 * np.log(freedom * np.pi)
        square = terms.value_m**2 / terms.variance_m2
        density = peak - (freedom + 1) / 2 * np.log1p(square / freedom) - 0.5 * np.log(terms.variance_m2)
        gain[lone] = density + np.log(LARGEST_RANGE_M)
    return gain


def _neighbours(now: TrajectoryState, stop: int) -> FloatArray:
    """The states (2, 4) of the nearest stops, and between them where there are two."""
    n = len(now.state)
    if n < 2:
        return np.empty((0, 4))
    near = now.state[[max(stop - 1, 0) if stop else 1, stop + 1 if stop + 1 < n else n - 2]].copy()
    near[:, 3] = near[:, 3].mean()
    return np.concatenate([near, near.mean(axis=0, keepdims=True)])


def _motion(now: TrajectoryState, stop: int, state: FloatArray, config: TrajectoryConfig) -> float:
    """Cost of the walk about a stop, were it in this state."""
    low, high = max(stop - 2, 0), min(stop + 3, len(now.state))
    part = now.state[low:high].copy()
    part[stop - low] = state
    return motion_cost(part, now.course[low : high - 2], config)


def _agreeing(own: Observations, now: TrajectoryState, stop: int, max_bias_m: float) -> FloatArray:
    """States (candidate, 4) at the places about the neighbours where most paths agree."""
    place, step_m = _places(now, stop)
    path, heading, bias, is_able = _votes(_best_known(own), now, stop, place, step_m)
    is_able &= np.abs(bias) < max_bias_m
    states, votes = np.empty((len(place), 4)), np.zeros(len(place))
    for k in np.flatnonzero(is_able.any(axis=1)):
        able = np.flatnonzero(is_able[k])
        said = np.column_stack([heading[k, able], bias[k, able]])
        votes[k], one = _most_agreed(path[able], said, step_m + AGREE_M)
        states[k] = [*place[k], *said[one]]
    best = np.argsort(-votes, kind="stable")[:MOST_PLACES]
    return np.asarray(states[best[votes[best] > 1]])


def _best_known(own: Observations) -> Observations:
    """The paths of a stop that show a place most precisely, at most `MOST_PATHS`."""
    variance = np.diagonal(own.covariance, axis1=1, axis2=2)
    square_m2 = variance[:, 0] + np.square(own.measured[:, 0]) * variance[:, 1:].sum(axis=1)
    best = np.sort(np.argsort(square_m2, kind="stable")[:MOST_PATHS])
    return replace(
        own,
        row=own.row[best],
        measured=own.measured[best],
        covariance=own.covariance[best],
        link=own.tx_of_path[best],
    )


def _most_agreed(path: IntArray, said: FloatArray, agree_m: float) -> tuple[float, int]:
    """How many paths agree with the vote (vote, 2) of heading and bias that most agree with, and which it is."""
    apart = np.abs(said[:, None, 1] - said[:, 1]) / agree_m
    turned = np.abs(wrap_angle(said[:, None, 0] - said[:, 0])) / AGREE_RAD
    agree = np.maximum(1 - np.maximum(apart, turned) ** 2, 0.0)
    first = np.flatnonzero(np.diff(path, prepend=-1))
    total = np.maximum.reduceat(agree, first, axis=1).sum(axis=1)
    best = int(total.argmax())
    return float(total[best]), best


def _places(now: TrajectoryState, stop: int) -> tuple[FloatArray, float]:
    """A grid of places (place, 2) about the middle of the neighbours, as wide as a few steps of the walk."""
    steps = np.linalg.norm(np.diff(now.state[:, :2], axis=0), axis=1)
    reach_m = float(np.clip(REACH_STEPS * np.median(steps), *REACH_M)) if len(steps) else REACH_M[1]
    near = _neighbours(now, stop)
    middle = near[-1, :2] if len(near) else now.state[stop, :2]
    offset = np.linspace(-reach_m, reach_m, GRID)
    grid = np.stack(np.meshgrid(offset, offset), axis=-1).reshape(-1, 2)
    return middle + grid, float(offset[1] - offset[0])


def _votes(
    own: Observations, now: TrajectoryState, stop: int, place: FloatArray, step_m: float
) -> tuple[IntArray, FloatArray, FloatArray, BoolArray]:
    """What paths say at each place by way of sources: their rising index (vote,), and (place, vote) for the rest.

    That is the heading, the clock bias, and whether the vote counts. Sources are the TX, its images in the walls,
    and the objects. A ray from an image has to meet the place; one to an object has to meet the object, whatever
    the place.
    """
    measured = own.measured.copy()
    measured[:, 1] += now.offset_rad[now.session[stop]]
    tx, heading_rad = own.tx_rows[0, :2], own.tx_rows[0, 2]
    normal = np.column_stack([np.cos(now.walls[:, 0]), np.sin(now.walls[:, 0])])
    image = np.concatenate([tx[None], tx + 2 * (now.walls[:, 1] - normal @ tx)[:, None] * normal])
    departure = measured[:, 1] + heading_rad
    ray = np.column_stack([departure, 2 * now.walls[:, 0] + np.pi - departure[:, None]])
    std_rad = GATE_STDS * np.sqrt(own.covariance[:, 1, 1])
    centre, radius = now.objects[:, :2], now.objects[:, 2]
    to_object = np.linalg.norm(centre - tx, axis=1)
    side = np.arctan2(*(centre - tx).T[::-1])
    wide = std_rad[:, None] + np.abs(radius) / np.maximum(to_object, 1e-3)
    is_met = np.abs(wrap_angle(departure[:, None] - side)) < wide
    path, source = np.concatenate([np.indices(ray.shape).reshape(2, -1), np.nonzero(is_met)], axis=1)
    n_rays = ray.size
    first = np.concatenate([image, centre])[np.concatenate([source[:n_rays], len(image) + source[n_rays:]])]
    before = np.concatenate([np.zeros(n_rays), (to_object - 2 * np.abs(radius))[source[n_rays:]]])
    leg = place[:, None] - first
    length = np.linalg.norm(leg, axis=2)
    azimuth = np.arctan2(leg[..., 1], leg[..., 0])
    miss = np.abs(wrap_angle(azimuth[:, :n_rays] - ray.ravel()))
    is_able = np.ones(azimuth.shape, bool)
    is_able[:, :n_rays] = miss < np.repeat(std_rad, ray.shape[1]) + step_m / np.maximum(length[:, :n_rays], step_m)
    bias = measured[path, 0] - before - length
    heading = azimuth + np.pi - measured[path, 2]
    order = np.argsort(path, kind="stable")
    return path[order], heading[:, order], bias[:, order], is_able[:, order]


def _tiled(
    own: Observations, now: TrajectoryState, stop: int, states: FloatArray
) -> tuple[Observations, TrajectoryState]:
    """The paths of a stop once for every state (candidate, 4), each as a stop of its own."""
    n, m = len(states), len(own.measured)
    tiled = replace(
        own,
        n_stops=n,
        row=np.repeat(np.arange(n), m),
        measured=np.tile(own.measured, (n, 1)),
        covariance=np.tile(own.covariance, (n, 1, 1)),
        link=np.tile(own.link, n),
    )
    session = np.full(n, now.session[stop])
    course = np.zeros((max(n - 2, 0), 2))
    return tiled, replace(now, state=states.copy(), session=session, course=course)


def _widened(seen: Observations, first: int) -> Observations:
    """The paths as they may look from places that err by `WIDE_M`, from the stop `first` on."""
    angle = WIDE_M / np.maximum(seen.measured[:, 0], WIDE_M)
    std = np.column_stack([np.full(len(angle), WIDE_M), angle, angle]) * (seen.row >= first)[:, None]
    return replace(seen, covariance=seen.covariance + np.square(std)[:, None] * np.eye(3))


def _lines_of_sight(seen: Observations, now: TrajectoryState, config: TrajectoryConfig) -> BoolArray:
    """Which paths (path,) are lines of sight: the earliest of each stop, if it is within the gate of one."""
    order = np.lexsort((seen.measured[:, 0], seen.row))
    first = order[np.unique(seen.row[order], return_index=True)[1]]
    error = residual(
        without_heading_offsets(seen, now, first), predict_los(seen.tx_rows[first], now.state[seen.row[first]])
    )
    distance = np.einsum("pi,pi->p", error, np.linalg.solve(seen.covariance[first], error[..., None])[..., 0])
    result = np.zeros(len(seen.row), bool)
    result[first] = distance < chi2.ppf(config.gate_probability, 3)
    return result


def _stepped(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> TrajectoryState:
    """Every state after steps of its own: landmarks and offsets are held, and there is no walk."""
    for _ in range(STEPS):
        information, gradient = state_equations(seen, link, now, config)
        step = -np.linalg.solve(information, gradient[..., None])[..., 0]
        now = replace(now, state=now.state + np.clip(step, -LARGEST_STEP, LARGEST_STEP))
    return now
