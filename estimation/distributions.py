"""Quantiles and log densities of common distributions, for `scipy.stats` takes a second to import."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaln, gammaincinv, gammaln, xlogy

from scenes.record import FloatArray


def chi_square_quantile(probability: ArrayLike, degrees: ArrayLike) -> FloatArray:
    """Value that a chi-square variable of so many degrees of freedom is below with a probability."""
    return np.asarray(2 * gammaincinv(np.asarray(degrees) / 2, probability))


def chi_square_log_density(value: ArrayLike, degrees: ArrayLike) -> FloatArray:
    """Log density of a chi-square variable of so many degrees of freedom."""
    half, value = np.asarray(degrees) / 2, np.asarray(value)
    return np.asarray(xlogy(half - 1, value) - value / 2 - gammaln(half) - half * np.log(2))


def f_log_density(value: ArrayLike, degrees: ArrayLike, degrees_below: ArrayLike) -> FloatArray:
    """Log density of the ratio of two chi-square variables, each over its degrees of freedom (F distribution)."""
    m, n, value = np.asarray(degrees), np.asarray(degrees_below), np.asarray(value)
    shape = xlogy(m / 2, m) + xlogy(n / 2, n) + xlogy(m / 2 - 1, value)
    return np.asarray(shape - (m + n) / 2 * np.log(n + m * value) - betaln(m / 2, n / 2))


def normal_log_density(value: ArrayLike, mean: float, std: float) -> FloatArray:
    """Log density of a normal variable."""
    return np.asarray(-np.square((np.asarray(value) - mean) / std) / 2 - np.log(std * np.sqrt(2 * np.pi)))
