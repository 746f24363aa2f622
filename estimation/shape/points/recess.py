"""A wall with one recess or one step: depth along a line that jumps by D at place a and back at place b.

    depth(t) = offset + slope t + D [a < t < b],   D ~ N(0, sigma^2),

with equal priors for all pairs a < b of a grid over the wall. A recess that reaches an end of the wall is a
step. Given a and b the model is linear and its posterior exact; pairs and sigma are weighted by their evidence.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp, ndtr

from scenes.record import FloatArray

N_EDGES = 40  # places where the depth may jump


class DepthPosterior(NamedTuple):
    """Depth along the wall under one model of it."""

    log_likelihood: float
    mean_m: FloatArray  # (sample,)
    variance_m2: FloatArray  # (sample,)


class DepthPoints(NamedTuple):
    """Points in the coordinates of a line."""

    place_m: FloatArray  # (ip,) along it
    place_std_m: FloatArray  # (ip,)
    depth_m: FloatArray  # (ip,) from it
    variance_m2: FloatArray  # (ip,) of the depth


def fit_recess(
    points: DepthPoints, at_m: FloatArray, depth_std_m: float, line_std: tuple[float, float]
) -> DepthPosterior:
    """Posterior of the depth at the places `at_m` (sample,) from end to end of the wall.

    `depth_std_m` is sigma, `line_std` the prior standard deviations of offset (m) and slope. The place of a
    point has an error, so the point is inside the recess with a probability z: its depth is z D, and z (1 - z)
    sigma^2 is added to its variance.
    """
    edge = np.linspace(min(at_m.min(), points.place_m.min()), max(at_m.max(), points.place_m.max()), N_EDGES)
    first, last = np.triu_indices(N_EDGES, 1)
    beyond = ndtr((points.place_m - edge[:, None]) / points.place_std_m)
    inside = beyond[first] - beyond[last]
    variance = points.variance_m2 + depth_std_m**2 * inside * (1 - inside)
    precision = np.array([*line_std, depth_std_m]) ** -2.0
    mean, covariance, log_likelihood = _regressions(
        points.place_m, inside, points.depth_m, 1 / variance, precision
    )
    total = float(logsumexp(log_likelihood))
    share = np.exp(log_likelihood - total)
    ramp = np.clip((at_m - edge[:, None]) / (edge[1] - edge[0]) + 0.5, 0.0, 1.0)
    within = ramp[first] - ramp[last]
    depth = mean[:, :1] + mean[:, 1:2] * at_m + mean[:, 2:] * within
    own = covariance[:, 0, 0, None] + 2 * covariance[:, 0, 1, None] * at_m
    own += covariance[:, 1, 1, None] * at_m**2 + within**2 * covariance[:, 2, 2, None]
    own += 2 * within * (covariance[:, 0, 2, None] + covariance[:, 1, 2, None] * at_m)
    own += mean[:, 2:] ** 2 * within * (1 - within)
    middle = share @ depth
    spread = share @ (own + (depth - middle) ** 2)
    return DepthPosterior(total - float(np.log(len(first))), middle, spread)


def _regressions(
    place_m: FloatArray, inside: FloatArray, depth_m: FloatArray, weight: FloatArray, precision: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Posterior means (pair, 3) of [offset, slope, D], covariances and log likelihoods (pair,), pair by pair."""
    terms = (np.ones_like(inside), np.broadcast_to(place_m, inside.shape), inside)
    information, right = np.zeros((len(inside), 3, 3)), np.zeros((len(inside), 3))
    for i, one in enumerate(terms):
        right[:, i] = np.sum(weight * one * depth_m, axis=1)
        for j, other in enumerate(terms):
            information[:, i, j] = np.sum(weight * one * other, axis=1)
    information += np.diag(precision)
    covariance = np.linalg.inv(information)
    mean = np.einsum("pij,pj->pi", covariance, right)
    square = np.sum(weight * depth_m**2, axis=1) - np.sum(right * mean, axis=1)
    log_volume = np.linalg.slogdet(information)[1] - np.log(precision).sum() - np.log(weight).sum(axis=1)
    log_likelihood = -0.5 * (square + log_volume + len(depth_m) * np.log(2 * np.pi))
    return np.asarray(mean), np.asarray(covariance), np.asarray(log_likelihood)
