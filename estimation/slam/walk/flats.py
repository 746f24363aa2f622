"""Bounces off floor and ceiling at a given trajectory: with horizontal beams they look like bounces off walls.

Floor and ceiling scatter weakly at any place. Such paths share no landmark, and there are many. Taken as level,
each is too long, never too short: together they pull clock biases and positions. Where the height of a surface is
known, its paths obey the law of level ones (`estimation.laws.flat`). So the heights of floor and ceiling are
learned from all paths of the campaign, and every path is told to be level or not.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from estimation.laws.flat import flat_log_densities
from estimation.slam.walk.linearise import path_heights
from estimation.slam.walk.residuals import (
    Association,
    Observations,
    PathClass,
    TrajectoryState,
    certain_paths,
    own_bounces,
    without_heading_offsets,
)
from scenes.record import BoolArray, FloatArray

_LEAST_M, _MOST_M = 0.4, 12.0  # of a surface above or below both devices
_COARSE_M, _FINE_M = 0.1, 0.02  # steps of the heights that are tried
_MOST_SURFACES = 2
_CLUTTER_PER_M = 0.05  # density of the lengths of other paths
_SHARE = 0.2  # of paths off a surface, where it is searched
_LEAST_GAIN = 10.0  # of a surface, in log evidence
_SHARE_STEPS = 10
_NEVER, _MOST_LOG = -1e3, 50.0
_LEVEL_STEPS = 30
_PSEUDO = 2.0  # paths that the prior of each share counts for
_EXCESS_M = 0.2, 0.02, 2.0  # mean excess length of paths that are not level: at first, least and most


def learned_flats(seen: Observations, now: TrajectoryState, is_los: BoolArray) -> FloatArray:
    """Heights (surface,) over the receiver of floor and ceiling, as far as the paths show them.

    Devices at equal heights see both from above: then a surface above stands for one as far below.
    """
    difference_m = path_heights(seen).difference_m
    low, high = difference_m.min(initial=0.0), difference_m.max(initial=0.0)
    away = np.arange(_LEAST_M, _MOST_M, _COARSE_M)
    grid = np.concatenate([high + away, low - away]) if high > low else away
    coarse = _log_densities(seen, now, ~is_los, np.append(np.nan, grid))
    other, found = np.logaddexp(coarse[0], np.log(_CLUTTER_PER_M)), list[float]()
    for _ in range(_MOST_SURFACES):
        best = grid[int(np.argmax(_gains(coarse[1:], other)))]
        near = best + np.arange(-_COARSE_M, _COARSE_M + _FINE_M / 2, _FINE_M)
        fine = _log_densities(seen, now, ~is_los, near)
        gain = _gains(fine, other)
        chosen = int(np.argmax(gain))
        if gain[chosen] < _LEAST_GAIN:
            break
        found.append(float(near[chosen]))
        other = np.logaddexp(other, np.log(_SHARE) + fine[chosen])
    return np.array(found)


def off_flats(seen: Observations, now: TrajectoryState, is_los: BoolArray, height_m: FloatArray) -> BoolArray:
    """Paths (path,) that are more probable off surfaces at these heights (surface,) than as level bounces."""
    result = np.zeros(len(is_los), bool)
    if len(height_m) and not is_los.all():
        density = _log_densities(seen, now, ~is_los, np.append(np.nan, height_m))
        result[~is_los] = _log_odds(np.logaddexp.reduce(density[1:], axis=0), density[0]) > 0.0
    return result


class ExcessLaw(NamedTuple):
    """By how much bounces off places of their own are longer than as level ones.

    Attributes
    ----------
    level_probability : (path,) that the place is as high as the devices, against higher or lower
    variance_m2 : expected squared excess of a bounce of which nothing else is known
    """

    level_probability: FloatArray
    variance_m2: float


def excess_law(excess_m: FloatArray, std_m: FloatArray) -> ExcessLaw:
    """The law of bounces that are longer by `excess_m` (path,) than as level ones, with standard deviations.

    A place at another height makes a bounce longer only, by an amount with exponential law. Shares and mean are
    learned (EM), and a share of clutter.
    """
    mean_m, share = _EXCESS_M[0], np.full(3, 1 / 3)
    level = -0.5 * np.square(excess_m / std_m) - np.log(np.sqrt(2 * np.pi) * std_m)
    clutter = np.full(len(excess_m), np.log(_CLUTTER_PER_M))
    for _ in range(_LEVEL_STEPS):
        ratio = std_m / mean_m
        place = excess_m / std_m - ratio
        raised = ratio**2 / 2 - excess_m / mean_m + log_ndtr(place) - np.log(mean_m)
        joint = np.stack([level, raised, clutter]) + np.log(share)[:, None]
        weight = np.exp(joint - np.logaddexp.reduce(joint, axis=0))
        share = (weight.sum(axis=1) + _PSEUDO) / (len(excess_m) + 3 * _PSEUDO)
        hazard = np.exp(-0.5 * place**2 - log_ndtr(place)) / np.sqrt(2 * np.pi)
        own_m = std_m * (place + hazard)  # expected excess of each, if it is not level
        total = weight[1].sum() + _PSEUDO
        mean_m = float(np.clip((weight[1] @ own_m + _PSEUDO * _EXCESS_M[0]) / total, *_EXCESS_M[1:]))
    probability = 1 / (1 + np.exp(np.clip(joint[1] - joint[0], -_MOST_LOG, _MOST_LOG)))
    return ExcessLaw(probability, float(share[1] / share[:2].sum() * 2 * mean_m**2))


def with_possible_excess(seen: Observations, link: Association, now: TrajectoryState) -> Observations:
    """The paths, with the excess that bounces have elsewhere as an error of those that nothing checks.

    Where a stop has no line of sight and fewer than two paths off shared landmarks, its bounces agree with each
    other at a wrong place too, if all of them are too long.
    """
    if seen.heights is None:
        return seen
    has_los = np.bincount(seen.row[link.kind == PathClass.LOS], minlength=seen.n_stops) > 0
    is_unchecked = ((certain_paths(seen, link) < 2) & ~has_los)[seen.row]
    is_bounce = np.isin(link.kind, (PathClass.BOUNCE, PathClass.LONE))
    known, mine = is_bounce & ~is_unchecked, is_bounce & is_unchecked
    if not mine.any():
        return seen
    law = excess_law(*own_bounces(seen, now, np.flatnonzero(known)).excess_m())
    covariance = seen.covariance.copy()
    covariance[mine, 0, 0] += law.variance_m2
    return replace(seen, covariance=covariance)


def _log_densities(seen: Observations, now: TrajectoryState, path: BoolArray, height_m: FloatArray) -> FloatArray:
    """Log density (height, path) of some paths, at heights over the receiver; NaN for an upright surface."""
    own = seen.take(path)
    measured = without_heading_offsets(seen, now, np.flatnonzero(path))
    ends = path_heights(own)
    density: FloatArray = flat_log_densities(
        own.tx_rows,
        own.states(now.state),
        measured,
        own.covariance,
        height_m,
        ends.difference_m,
        ends.boresight_rad,
    )
    return density


def _gains(density: FloatArray, other: FloatArray) -> FloatArray:
    """Gain (height,) in log evidence of surfaces with log densities (height, path) over that of `other`."""
    ratio = np.exp(np.minimum(density - other, _MOST_LOG))
    return np.asarray(np.log1p(_SHARE * (ratio - 1)).sum(axis=1))


def _log_odds(flat: FloatArray, level: FloatArray) -> FloatArray:
    """Log odds (path,) of surfaces against a level bounce, with the share of either learned."""
    ratio = np.where(np.isfinite(flat), np.maximum(flat, _NEVER) - np.maximum(level, _NEVER), -_MOST_LOG)
    ratio = np.clip(ratio, -_MOST_LOG, _MOST_LOG)
    is_bounce = np.maximum(flat, level) > np.log(_CLUTTER_PER_M)
    odds = 1.0
    for _ in range(_SHARE_STEPS if is_bounce.any() else 0):
        share = float((1 / (1 + np.exp(-ratio[is_bounce]) / odds)).mean())
        odds = float(np.clip(share / max(1 - share, np.finfo(float).tiny), 0.01, 100.0))
    return np.asarray(ratio + np.log(odds))
