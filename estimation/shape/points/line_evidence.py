"""Evidence of a straight wall by importance sampling: the azimuth of a short wall is far from normal.

A segment is (azimuth, offset, log noise scale, middle, log length). Its points are uniform over it, each with
its covariance, or are outliers. Student densities propose segments, first about the fitted line, then about the
moments of the draws; the weights add up to the evidence. The draws come from a fixed Sobol sequence, so results
repeat exactly.
"""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.special import logsumexp, ndtri

from estimation.distributions import chi_square_quantile
from estimation.execution import compiled
from estimation.inference.least_squares import student_t_log_peak
from scenes.record import FloatArray

N_DRAWS = 1024
N_ROUNDS = 3
DEGREES_OF_FREEDOM = 5.0
SMALLEST_STD = 0.02  # of a proposal, in any parameter
TEMPER_BELOW_DRAWS = 50.0  # effective draws; with fewer, the weights are flattened before the moments
TEMPER = 0.3


def importance_evidence(
    log_density: Callable[[FloatArray], FloatArray], mean: FloatArray, covariance: FloatArray
) -> float:
    """Log integral of a density of parameters (draw, parameter); mean and covariance are the first proposal."""
    normal, spread = _quasi_normal(len(mean))
    total = -np.inf
    for _ in range(N_ROUNDS):
        root: FloatArray = np.asarray(np.linalg.cholesky(covariance), np.float64)
        draws = mean + (normal * spread[:, None]) @ root.T
        log_weight = log_density(draws) - _log_student(normal * spread[:, None], root)
        total = float(logsumexp(log_weight))
        if not np.isfinite(total):
            break
        weight = np.exp(log_weight - total)
        if 1 / np.sum(weight**2) < TEMPER_BELOW_DRAWS:
            weight = np.exp(TEMPER * (log_weight - log_weight.max()))
            weight /= weight.sum()
        mean = weight @ draws
        deviation = draws - mean
        covariance = (weight * deviation.T) @ deviation + SMALLEST_STD**2 * np.eye(len(mean))
    return total - math.log(N_DRAWS)


def _log_student(scaled: FloatArray, root: FloatArray) -> FloatArray:
    """Log density (draw,) of draws at `scaled` (draw, parameter) times the root of their scale matrix."""
    freedom, size = DEGREES_OF_FREEDOM, len(root)
    constant = student_t_log_peak(freedom, size) - np.log(np.diagonal(root)).sum()
    return np.asarray(constant - 0.5 * (freedom + size) * np.log1p(np.sum(scaled**2, axis=1) / freedom))


@lru_cache(maxsize=4)
def _quasi_normal(size: int) -> tuple[FloatArray, FloatArray]:
    """Sobol points as independent standard normals (draw, size) and the scales (draw,) of a Student density."""
    from scipy.stats.qmc import Sobol  # noqa: PLC0415  (slow to import)

    uniform = Sobol(size + 1, scramble=False).random(2 * N_DRAWS)[N_DRAWS:] + 0.25 / N_DRAWS
    return ndtri(uniform[:, :-1]), np.sqrt(
        DEGREES_OF_FREEDOM / chi_square_quantile(uniform[:, -1], DEGREES_OF_FREEDOM)
    )


@compiled
def segment_log_likelihood(
    segment: FloatArray,
    offset_m: FloatArray,
    covariance_m2: FloatArray,
    outlier_share: float,
    log_outlier_density: float,
) -> FloatArray:
    """Log likelihood (draw,) of segments (draw, 5) for points at `offset_m` (ip, xy) from their origin."""
    value = np.zeros(len(segment))
    background = outlier_share * math.exp(log_outlier_density)
    for k in range(len(segment)):
        cosine, sine = math.cos(segment[k, 0]), math.sin(segment[k, 0])
        scale, length = math.exp(2 * segment[k, 2]), math.exp(segment[k, 4])
        for i in range(len(offset_m)):
            x, y = offset_m[i, 0], offset_m[i, 1]
            xx, xy, yy = covariance_m2[i, 0, 0], covariance_m2[i, 0, 1], covariance_m2[i, 1, 1]
            across = scale * (sine**2 * xx - 2 * sine * cosine * xy + cosine**2 * yy)
            mixed = scale * (cosine * sine * (yy - xx) + (cosine**2 - sine**2) * xy)
            lengthwise = scale * (cosine**2 * xx + 2 * sine * cosine * xy + sine**2 * yy)
            distance = cosine * y - sine * x - segment[k, 1]
            place = cosine * x + sine * y - segment[k, 3] - mixed / across * distance
            std = math.sqrt(2 * (lengthwise - mixed**2 / across))
            share = 0.5 * (math.erf((place + length / 2) / std) - math.erf((place - length / 2) / std))
            density = math.exp(-0.5 * distance**2 / across) / math.sqrt(2 * math.pi * across) * share / length
            value[k] += math.log((1 - outlier_share) * density + background)
    return value
