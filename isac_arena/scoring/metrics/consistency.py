"""Consistency of an estimator's errors with its covariances: NEES, coverage and CRPS."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from estimation.distributions import chi_square_quantile, normal_log_density
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.metrics.statistics import finite_entries, mean, squared_mahalanobis
from scenes.record import BoolArray, FloatArray


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float


def normalised_nees(error: FloatArray, covariance: FloatArray) -> Interval:
    """Mean NEES of errors (n, k) with covariances (n, k, k), divided by k: 1 for a consistent estimator.

    The value of a consistent estimator is in the interval with probability 0.95, because the sum of n NEES is
    chi-square with n k degrees of freedom. Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications
    to Tracking and Navigation, 2001, section 5.4.2.
    """
    nees = finite_entries(squared_mahalanobis(error, covariance))
    freedom = len(nees) * error.shape[1]
    if not freedom:
        return Interval(np.nan, np.nan, np.nan)
    low, high = chi_square_quantile([0.025, 0.975], freedom) / freedom
    return Interval(float(nees.sum() / freedom), float(low), float(high))


def region_coverage(error: FloatArray, covariance: FloatArray, level: float = 0.95) -> Interval:
    """Share of errors (n, k) inside the `level` region of their covariance, with its Wilson interval."""
    nees = finite_entries(squared_mahalanobis(error, covariance))
    return share_with_interval(nees <= chi_square_quantile(level, error.shape[1]))


def consistency_metrics(prefix: str, nees: FloatArray, freedom: int) -> list[Metric]:
    """Mean NEES (n,) over its degrees of freedom, share inside the 95 % region, and the number of errors.

    NaN entries are in none of them.
    """
    inside = finite_entries(nees) <= chi_square_quantile(0.95, freedom)
    return [
        Metric(f"{prefix}.nees", mean(nees / freedom), "1", "info"),
        Metric(f"{prefix}.coverage95", mean(inside), "1", "info"),
        Metric(f"{prefix}.nees.count", len(inside), "1", "info"),
    ]


def share_with_interval(hits: BoolArray) -> Interval:
    """Share of true entries with its Wilson score interval (Wilson 1927)."""
    if not len(hits):
        return Interval(np.nan, np.nan, np.nan)
    from scipy.stats import binomtest  # noqa: PLC0415  (slow to import)

    found = binomtest(int(np.sum(hits)), len(hits)).proportion_ci(method="wilson")
    return Interval(mean(hits), float(found.low), float(found.high))


def gaussian_crps(truth: FloatArray, mean_value: FloatArray, std: FloatArray) -> FloatArray:
    """Continuous ranked probability score of Gaussian predictions, in the unit of the truth; lower is better.

    s (z (2 Phi(z) - 1) + 2 phi(z) - 1 / sqrt(pi)), z = (truth - mean) / s, and |truth - mean| where s is 0.
    Source: Gneiting and Raftery, "Strictly proper scoring rules, prediction, and estimation", JASA 102, 2007,
    equation (21). Raises `ValueError` for a negative standard deviation.
    """
    if (np.asarray(std) < 0).any():
        raise ValueError("std: must be at least 0")
    error, sigma = np.broadcast_arrays(np.asarray(truth, float) - mean_value, np.asarray(std, float))
    safe = np.where(sigma > 0, sigma, 1.0)
    z = error / safe
    score = safe * (z * (2 * ndtr(z) - 1) + 2 * np.exp(normal_log_density(z, 0.0, 1.0)) - 1 / np.sqrt(np.pi))
    return np.asarray(np.where(sigma > 0, score, np.abs(error)))
