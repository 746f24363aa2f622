"""Recursive peers: the extended-target Gaussian process and the star-convex random hypersurface model.

Both estimate a centre and a star-convex radius with an extended Kalman filter, point by point. The polar angle
of a point about the present centre is its place on the contour. They start from the prior circle.

Sources: Wahlstrom and Ozkan, "Extended target tracking using Gaussian processes", IEEE TSP 2015, section III;
Baum and Hanebeck, "Extended object tracking with random hypersurface models", IEEE TAES 2014, section V.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from estimation.shape.baselines.peers import (
    PRIOR_BEHIND_M,
    PRIOR_CENTER_STD_M,
    PRIOR_RADIUS_M,
    PRIOR_RADIUS_STD_M,
    closed_shape,
)
from estimation.shape.fit import ShapeFit
from estimation.shape.gp.exact import chord
from estimation.shape.points.cluster import PointCluster, ring_normals
from scenes.record import FloatArray

N_BASIS = 24
RADIUS_STD_M, LENGTH_SCALE = 0.08, 0.7  # of the deviation from a circle
HIGHEST_HARMONIC = 5
SMALLEST_RADIUS_M = 0.05
N_SAMPLES = 180

Rows = Callable[[FloatArray], FloatArray]


class _State(NamedTuple):
    """Centre (2,) and the coefficients of the radius, with their covariance."""

    mean: FloatArray
    covariance: FloatArray


def fit_recursive_gp(points: PointCluster) -> ShapeFit:
    """Extended-target Gaussian process: the radius at 24 basis angles; the periodic kernel interpolates it."""
    basis: FloatArray = np.arange(N_BASIS, dtype=np.float64) * (2 * np.pi / N_BASIS)
    prior = _kernel(basis, basis)
    factor = cho_factor(prior + 1e-9 * np.eye(N_BASIS))

    def rows(angle: FloatArray) -> FloatArray:
        return np.asarray(cho_solve(factor, _kernel(basis, angle)).T)

    def unexplained(angle: FloatArray) -> FloatArray:
        cross = _kernel(basis, angle)
        explained = np.sum(cross * cho_solve(factor, cross), axis=0)
        return np.asarray(np.maximum(_kernel(angle, angle).diagonal() - explained, 0.0))

    state = _start(points, np.full(N_BASIS, PRIOR_RADIUS_M), prior)
    for position, covariance in zip(points.position_m, points.covariance_m2, strict=True):
        state = _update(state, position, covariance, rows, unexplained)
    return _shape(state, rows, [f"radius_{k}_m" for k in range(N_BASIS)])


def fit_star_convex_rhm(points: PointCluster) -> ShapeFit:
    """Star-convex random hypersurface model with five harmonics, on the contour itself (scaling factor one).

    It filters the pseudo-measurement |p - c|^2 - r(angle)^2 - noise = 0.
    """
    harmonic = np.arange(1, HIGHEST_HARMONIC + 1)

    def rows(angle: FloatArray) -> FloatArray:
        turns = angle[:, None] * harmonic
        waves = np.stack([np.cos(turns), np.sin(turns)], axis=2).reshape(len(angle), -1)
        return np.column_stack([np.ones(len(angle)), waves])

    spread = np.repeat(RADIUS_STD_M**2 / harmonic**2, 2)
    mean = np.append(PRIOR_RADIUS_M, np.zeros(2 * HIGHEST_HARMONIC))
    state = _start(points, mean, np.diag(np.append(PRIOR_RADIUS_STD_M**2, spread)))
    for position, covariance in zip(points.position_m, points.covariance_m2, strict=True):
        state = _update_pseudo(state, position, covariance, rows)
    names = [f"{part}_{k}_m" for k in harmonic for part in ("cosine", "sine")]
    return _shape(state, rows, ["radius_m", *names])


def _kernel(a_rad: FloatArray, b_rad: FloatArray) -> FloatArray:
    correlation = np.exp(-chord(a_rad, b_rad) / LENGTH_SCALE**2)
    return np.asarray(PRIOR_RADIUS_STD_M**2 + RADIUS_STD_M**2 * correlation)


def _start(points: PointCluster, mean: FloatArray, covariance: FloatArray) -> _State:
    center = points.position_m.mean(axis=0) + PRIOR_BEHIND_M * points.away
    joint = np.zeros((len(mean) + 2, len(mean) + 2))
    joint[:2, :2] = PRIOR_CENTER_STD_M**2 * np.eye(2)
    joint[2:, 2:] = covariance
    return _State(np.concatenate([center, mean]), joint)


def _outward(state: _State, position_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vector (xy,) and azimuth (1,) of a point about the centre."""
    offset = position_m - state.mean[:2]
    azimuth = np.arctan2(offset[1], offset[0])
    return np.array([np.cos(azimuth), np.sin(azimuth)]), np.array([azimuth])


def _update(
    state: _State, position_m: FloatArray, covariance_m2: FloatArray, rows: Rows, unexplained: Rows
) -> _State:
    """Filter p = c + r(angle) u + noise at the present angle; `unexplained` is the variance beyond the basis."""
    unit, azimuth = _outward(state, position_m)
    row = rows(azimuth)[0]
    jacobian = np.hstack([np.eye(2), np.outer(unit, row)])
    noise = covariance_m2 + unexplained(azimuth)[0] * np.outer(unit, unit)
    residual = position_m - state.mean[:2] - (row @ state.mean[2:]) * unit
    return _filtered(state, jacobian, residual, noise)


def _update_pseudo(state: _State, position_m: FloatArray, covariance_m2: FloatArray, rows: Rows) -> _State:
    unit, azimuth = _outward(state, position_m)
    offset = position_m - state.mean[:2]
    row = rows(azimuth)[0]
    radius = float(row @ state.mean[2:])
    predicted = radius**2 + np.trace(covariance_m2)
    jacobian = np.concatenate([2 * radius * unit, 2 * radius * row])[None]
    variance = 4 * radius**2 * unit @ covariance_m2 @ unit + 2 * np.sum(covariance_m2**2)
    return _filtered(state, jacobian, np.array([offset @ offset - predicted]), np.array([[variance]]))


def _filtered(state: _State, jacobian: FloatArray, residual: FloatArray, noise: FloatArray) -> _State:
    cross = state.covariance @ jacobian.T
    gain = np.linalg.solve(jacobian @ cross + noise, cross.T).T
    keep = np.eye(len(state.mean)) - gain @ jacobian
    covariance = keep @ state.covariance @ keep.T + gain @ noise @ gain.T
    return _State(state.mean + gain @ residual, covariance)


def _shape(state: _State, rows: Rows, names: list[str]) -> ShapeFit:
    angle: FloatArray = np.arange(N_SAMPLES, dtype=np.float64) * (2 * np.pi / N_SAMPLES)
    row = rows(angle)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    radius = np.maximum(row @ state.mean[2:], SMALLEST_RADIUS_M)
    contour = state.mean[:2] + radius[:, None] * unit
    normal = ring_normals(contour)
    jacobian = np.hstack([normal, np.sum(normal * unit, axis=1)[:, None] * row])
    std = np.sqrt(np.einsum("sp,pq,sq->s", jacobian, state.covariance, jacobian))
    names = ["center_x_m", "center_y_m", *names]
    return closed_shape("star_convex", contour, std, state.mean, names, state.covariance)
