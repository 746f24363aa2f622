"""Maximum a posteriori fit of one contour to delays and angles, with common offsets and a ghost component.

A path belongs to the contour with probability 1 - q; its errors are Gaussian with its covariance plus, to first
order, that of its RX pose. Otherwise it is a ghost, uniform over a window. Unknowns are the parameters of the
contour, one delay offset, one arrival offset and one departure offset per session. Levenberg-Marquardt finds the
minimum on the path-weighted normal equations (the expectation-maximisation bound). Covariance and evidence are
those of Laplace.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from estimation.inference.least_squares import Attempt, Schedule, damped_step, minimise
from estimation.laws.contour import SpecularPaths, predict_reflection
from estimation.laws.support import HARMONICS
from estimation.shape.reflection.path_likelihood import (
    N_COMMON,
    normal_equations,
    path_covariance,
    path_weights,
    squared_distances,
)
from estimation.shape.reflection.reflections import ReflectionConfig, Reflections
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray

CHI2_MEDIAN = 2.366  # of 3 degrees of freedom
FAR_OFF = 4.0  # squared errors over their expected median, above which the covariances are enlarged at first
_FIXED_STD = 1e-7
_MAX_STEPS = 60
_CONVERGED_NAT = 1e-7
_MAX_REFRESHES = 4


@dataclass(frozen=True)
class Prior:
    """Independent priors: Gaussian, or flat over a width where the precision is 0.

    A flat prior counts in the evidence as the Gaussian of the same peak density, so that paths without
    information on a parameter do not change the evidence.
    """

    mean: FloatArray  # (parameter,)
    precision: FloatArray  # (parameter,)
    flat_width: FloatArray  # (parameter,) of the flat ones

    def log_density(self, value: FloatArray) -> FloatArray:
        """Log density (...) at parameters (..., parameter)."""
        flat = self.precision == 0
        norm = np.log(self.precision[~flat] / (2 * np.pi)).sum() / 2 - np.log(self.flat_width[flat]).sum()
        return np.asarray(norm - 0.5 * (value - self.mean) ** 2 @ self.precision)

    @property
    def evidence_precision(self) -> FloatArray:
        """Precision (parameter,), for flat priors that of the Gaussian of the same peak density."""
        flat = self.precision == 0
        return np.where(flat, 2 * np.pi / np.where(flat, self.flat_width, 1.0) ** 2, self.precision)


@dataclass(frozen=True)
class Optimum:
    """The most likely contour with its offsets, Laplace covariance and evidence."""

    parameter: FloatArray  # (parameter,)
    offset: FloatArray  # (2 + session,) delay in m, arrival, departure of each session in rad
    covariance: FloatArray  # (parameter + 2 + session, ...) of parameter and offset together
    log_evidence: float
    inlier: FloatArray  # (path,) probability of belonging to the contour
    paths: SpecularPaths

    @property
    def parameter_covariance(self) -> FloatArray:
        """Covariance (parameter, parameter) with the offsets unknown."""
        m = len(self.parameter)
        return self.covariance[:m, :m]


def maximise_posterior(
    family: int,
    start: FloatArray,
    prior: Prior,
    data: Reflections,
    config: ReflectionConfig,
    refreshes: int = _MAX_REFRESHES,
) -> Optimum | None:
    """The local maximum of the posterior from `start` (parameter,); None where the information is singular.

    Far from the optimum all paths would be ghosts: the covariances are then enlarged at first and reduced step
    by step. The contribution of the pose errors to the path covariances is constant during a search; searches
    are repeated with the new contribution until the result stays the same, at most `refreshes` times.
    """
    m = len(start)
    full = with_offsets(prior, data.n_sessions, config)
    value = np.concatenate([start, np.zeros(N_COMMON + data.n_sessions)])
    value[m:] = full.mean[m:]
    exact_pose = not np.any(data.rx_covariance)
    for _ in range(1 if exact_pose else refreshes):
        paths = predict_reflection(family, value[:m], data.tx, data.rx_state)
        weight, log_norm = path_weights(paths, data, config)
        before = value
        for scale in _cooling(squared_distances(paths, value[m:], data, weight)):
            hot = log_norm - 1.5 * np.log(scale)
            value = _descend(family, value, full, data, weight / scale, hot, config)
        if np.max(np.abs(value - before)) < 1e-6:
            break
    paths = predict_reflection(family, value[:m], data.tx, data.rx_state)
    if not exact_pose:
        weight, log_norm = path_weights(paths, data, config)
    minus_log, _, hessian, inlier = normal_equations(paths, value[m:], data, weight, log_norm, config)
    hessian = hessian + np.diag(full.evidence_precision)
    try:
        factor = cho_factor(hessian, lower=True)
    except (np.linalg.LinAlgError, ValueError):
        return None
    log_determinant = 2 * np.sum(np.log(np.diagonal(factor[0])))
    evidence = (
        float(full.log_density(value)) - minus_log + 0.5 * (len(value) * np.log(2 * np.pi) - log_determinant)
    )
    return Optimum(value[:m], value[m:], cho_solve(factor, np.eye(len(value))), evidence, inlier, paths)


def best_start(
    family: int, starts: FloatArray, prior: Prior, data: Reflections, config: ReflectionConfig
) -> FloatArray:
    """The start, of (start, parameter), with the highest posterior density at zero offsets.

    The covariances are scaled so that the start with the least median error has the expected median error.
    """
    square, log_norm = np.empty((2, len(starts), len(data)))
    exact_pose = not np.any(data.rx_covariance)
    for i, start in enumerate(starts):
        paths = predict_reflection(family, start, data.tx, data.rx_state)
        if i == 0 or not exact_pose:
            weight, log_norm[i] = path_weights(paths, data, config)
        else:
            log_norm[i] = log_norm[0]
        square[i] = squared_distances(paths, np.zeros(N_COMMON + data.n_sessions), data, weight)
    scale = max(np.median(square, axis=1).min() / CHI2_MEDIAN, 1.0)
    log_inlier = log_norm - 1.5 * np.log(scale) - 0.5 * square / scale
    density = np.logaddexp(log_inlier, config.log_ghost_density).sum(axis=1)
    density += prior.log_density(starts)
    return np.asarray(starts[np.argmax(np.nan_to_num(density, nan=-np.inf))])


def path_squares(family: int, found: Optimum, data: Reflections) -> FloatArray:
    """Squared Mahalanobis distances (path,) of paths from what a fitted contour with its offsets predicts.

    The covariances of paths and poses count, that of the contour does not. Sessions without paths in the fit get
    its mean departure offset.
    """
    paths = predict_reflection(family, found.parameter, data.tx, data.rx_state)
    n_known = len(found.offset) - N_COMMON
    missing = np.full(max(data.n_sessions - n_known, 0), found.offset[N_COMMON:].mean())
    weight = np.asarray(np.linalg.inv(path_covariance(paths, data)), float)
    return squared_distances(paths, np.concatenate([found.offset, missing]), data, weight)


def with_offsets(prior: Prior, n_sessions: int, config: ReflectionConfig) -> Prior:
    """The prior of the parameters of a contour, then those of the delay, arrival and departure offsets."""
    std = np.array(
        [
            1e-9 * SPEED_OF_LIGHT_M_S * config.delay_offset_std_ns,
            np.deg2rad(config.aoa_offset_std_deg),
            *n_sessions * [np.deg2rad(config.aod_offset_std_deg)],
        ]
    )
    precision = np.maximum(std, _FIXED_STD) ** -2.0
    return Prior(
        np.concatenate([prior.mean, np.zeros(len(std))]),
        np.concatenate([prior.precision, precision]),
        np.concatenate([prior.flat_width, np.ones(len(std))]),
    )


def _cooling(square: FloatArray) -> list[float]:
    """Factors on the covariances, falling to 1; the first one makes the median squared error usual."""
    first = float(np.median(square)) / CHI2_MEDIAN
    if not first > FAR_OFF:
        return [1.0]
    return [*np.geomspace(first, 1.0, int(np.ceil(np.log10(first))) + 1)]


def _descend(
    family: int,
    value: FloatArray,
    prior: Prior,
    data: Reflections,
    weight: FloatArray,
    log_norm: FloatArray,
    config: ReflectionConfig,
) -> FloatArray:
    m = len(value) - N_COMMON - data.n_sessions

    def evaluate(at: FloatArray) -> _PosteriorPoint:
        paths = predict_reflection(family, at[:m], data.tx, data.rx_state)
        cost, gradient, hessian, _ = normal_equations(paths, at[m:], data, weight, log_norm, config)
        away = at - prior.mean
        cost += 0.5 * float(np.sum(prior.precision * away**2))
        return _PosteriorPoint(at, cost, gradient + prior.precision * away, hessian + np.diag(prior.precision))

    def attempt(at: _PosteriorPoint, damping: float) -> Attempt[_PosteriorPoint] | None:
        step = damped_step(at.hessian, at.gradient, damping)
        if family <= HARMONICS:
            step[2:m] = np.clip(step[2:m], -1.0, 1.0)
        trial = evaluate(at.value + step)
        if not trial.cost < at.cost and -at.gradient @ step < _CONVERGED_NAT:
            return None
        return Attempt(trial, at.cost, trial.cost)

    return minimise(evaluate(value), attempt, Schedule(_MAX_STEPS, absolute=_CONVERGED_NAT)).value


class _PosteriorPoint(NamedTuple):
    value: FloatArray  # (parameter + 2 + session,)
    cost: float
    gradient: FloatArray
    hessian: FloatArray
