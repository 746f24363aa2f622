"""Places where most paths of a stop agree on its heading and clock bias, by way of the landmarks of a walk.

A path off a wall leaves the image of the TX in that wall as a line of sight leaves the TX. So at a given place
every path tells, by way of an image or an object, the heading and the clock bias.
"""

import numpy as np

from estimation.execution import compiled
from estimation.laws.plane import bounce_equation, wrapped
from estimation.slam.walk.assignment import wall_images
from estimation.slam.walk.neighbours import neighbour_states
from estimation.slam.walk.residuals import Observations, TrajectoryState
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

REACH_STEPS, REACH_M = 3.0, (2.0, 8.0)  # half the side of the grid of places, in steps of the walk
GRID = 21  # places along a side
AGREE_M, AGREE_RAD = 0.3, 0.1  # of clock biases, beside the step of the grid, and of headings
GATE_STDS = 3.0  # of departures
MOST_PATHS = 24  # that are compared at the places of the grid
MOST_PLACES = 40  # of the grid that are refined, those where most paths agree


def agreeing_states(own: Observations, now: TrajectoryState, stop: int, max_bias_m: float) -> FloatArray:
    """States (candidate, 4) at the places about the neighbours where most paths agree."""
    place, step_m = _places(now, stop)
    path, heading, bias, is_able = _votes(_best_known(own), now, stop, place, step_m)
    is_able &= np.abs(bias) < max_bias_m
    votes, one = _most_agreed(path, heading, bias, is_able, step_m + AGREE_M)
    best = np.argsort(-votes, kind="stable")[:MOST_PLACES]
    best = best[votes[best] > 1]
    return np.column_stack([place[best], heading[best, one[best]], bias[best, one[best]]])


def sight_states(own: Observations, now: TrajectoryState, stop: int, first: int, bias_m: float) -> FloatArray:
    """States (candidate, 4) about the neighbours that the path `first` shows as a line of sight.

    Their clock biases are a given one, and those that each other path has as a single bounce. A flat array reports
    a departure from behind it as its mirror image in front, so both are tried.
    """
    measured = own.measured.copy()
    measured[:, 1] += now.offset_rad[now.session[stop]]
    others = np.delete(measured, first, axis=0)
    range_m, departure, arrival = measured[first]
    tx = own.tx_rows[first]
    states = []
    for turn in (departure, np.pi - departure):
        azimuth = tx[2] + turn
        away = np.array([np.cos(azimuth), np.sin(azimuth)])
        heading = azimuth + np.pi - arrival
        equation = bounce_equation(tx, heading, others)
        start = np.append(tx[:2] + range_m * away, 0.0)  # and one metre of bias moves it by [-away, 1]
        slope = equation.row @ np.append(-away, 1.0)
        biases = np.append(-equation.residual_m(start) / np.where(slope == 0, np.nan, slope), bias_m)
        states += [[*(tx[:2] + (range_m - bias) * away), heading, bias] for bias in biases[np.isfinite(biases)]]
    middle, reach_m = _about(now, stop)
    found = np.array(states)
    return np.asarray(found[np.abs(found[:, :2] - middle).max(axis=1) <= reach_m])


def _best_known(own: Observations) -> Observations:
    """The paths of a stop that show a place most precisely, at most `MOST_PATHS`."""
    variance = np.diagonal(own.covariance, axis1=1, axis2=2)
    square_m2 = variance[:, 0] + np.square(own.measured[:, 0]) * variance[:, 1:].sum(axis=1)
    return own.take(np.sort(np.argsort(square_m2, kind="stable")[:MOST_PATHS]))


@compiled
def _most_agreed(
    path: IntArray, heading: FloatArray, bias: FloatArray, is_able: BoolArray, agree_m: float
) -> tuple[FloatArray, IntArray]:
    """How many paths agree with the vote that most agree with, and which it is, at every place (place,).

    Votes (place, vote) of one path follow one another; of those of a path the one that agrees best counts.
    """
    votes, one = np.zeros(len(bias)), np.zeros(len(bias), np.int64)
    for k in range(len(bias)):
        able = np.flatnonzero(is_able[k])
        for i in able:
            total, most = 0.0, 0.0
            for at, j in enumerate(able):
                apart = abs(bias[k, i] - bias[k, j]) / agree_m
                if apart < 1.0:
                    turned = abs(wrapped(heading[k, i] - heading[k, j])) / AGREE_RAD
                    most = max(most, 1.0 - max(apart, turned) ** 2)
                if at + 1 == len(able) or path[able[at + 1]] != path[j]:
                    total, most = total + most, 0.0
            if total > votes[k]:
                votes[k], one[k] = total, i
    return votes, one


def _places(now: TrajectoryState, stop: int) -> tuple[FloatArray, float]:
    """A grid of places (place, 2) about the neighbours, and its step."""
    middle, reach_m = _about(now, stop)
    offset = np.linspace(-reach_m, reach_m, GRID)
    grid = np.stack(np.meshgrid(offset, offset), axis=-1).reshape(-1, 2)
    return middle + grid, float(offset[1] - offset[0])


def _about(now: TrajectoryState, stop: int) -> tuple[FloatArray, float]:
    """The middle (2,) of the neighbours of a stop, and how far from it the stop may be: a few steps."""
    steps = np.linalg.norm(np.diff(now.state[:, :2], axis=0), axis=1)
    reach_m = float(np.clip(REACH_STEPS * np.median(steps), *REACH_M)) if len(steps) else REACH_M[1]
    near = neighbour_states(now.state, stop)
    return near[-1, :2] if len(near) else now.state[stop, :2], reach_m


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
    image = np.concatenate([tx[None], wall_images(own.tx_rows[0], now.walls)[0]])
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
