"""Periodic Gaussian process by its full covariance matrix (paper, section III-B)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular

from scenes.record import FloatArray


class Likelihood(NamedTuple):
    """Log marginal likelihood, the mean radius mu in m, and the gradient by mu and beta."""

    value: float
    mu: float
    gradient: FloatArray


def chord(angle_a_rad: FloatArray, angle_b_rad: FloatArray) -> FloatArray:
    """2 sin^2((a - b) / 2) for every pair (a, b) of angles in rad: the kernel is sigma_f^2 exp(-chord / l^2)."""
    return 2 * np.sin((angle_a_rad[:, None] - angle_b_rad[None, :]) / 2) ** 2


def log_marginal_likelihood(
    chords: FloatArray, radius_m: FloatArray, beta: ArrayLike, mu: float | None = None
) -> Likelihood:
    """Log marginal likelihood of radii (ip,) and its gradient (4,) by (mu, sigma_f^2, l^2, sigma_n^2).

    `chords` (ip, ip) are those of the training angles and beta = (sigma_f^2, l^2, sigma_n^2). These are the log
    marginal likelihood and the partial derivatives of the paper, by Cholesky factorisation. Without `mu` the
    most likely mu of that beta is used, where the derivative by mu is zero: 1' K_y^-1 r / (1' K_y^-1 1).
    """
    signal_variance, length_squared, noise_variance = np.asarray(beta, float)
    n = len(radius_m)
    correlation = np.exp(-chords / length_squared)
    K_y = signal_variance * correlation
    K_y.flat[:: n + 1] += noise_variance
    factor = cho_factor(K_y, lower=True, overwrite_a=True, check_finite=False)
    inverse = cho_solve(factor, np.eye(n), check_finite=False)
    if mu is None:
        row_sum = inverse.sum(axis=0)
        mu = float(row_sum @ radius_m / row_sum.sum())

    eta = radius_m - mu
    alpha = inverse @ eta
    log_determinant = 2 * np.log(np.diagonal(factor[0])).sum()
    value = -0.5 * (eta @ alpha + log_determinant + n * np.log(2 * np.pi))
    inner = np.outer(alpha, alpha) - inverse
    weighted = inner * correlation
    by_mu = alpha.sum()
    by_signal = 0.5 * weighted.sum()
    by_length = 0.5 * signal_variance * np.vdot(weighted, chords) / length_squared**2
    by_noise = 0.5 * np.trace(inner)
    return Likelihood(float(value), mu, np.array([by_mu, by_signal, by_length, by_noise]))


@dataclass(frozen=True)
class ExactPosterior:
    """The training data in the form that prediction needs, about the mean radius mu."""

    angle_rad: FloatArray
    signal_variance: float
    length_squared: float
    cholesky_m: FloatArray  # lower factor of K_y
    weights_per_m: FloatArray  # K_y^-1 (r - mu)

    @classmethod
    def of(cls, angle_rad: FloatArray, radius_m: FloatArray, beta: ArrayLike, mu: float) -> ExactPosterior:
        """The posterior of radii (ip,) at angles (ip,) for beta = (sigma_f^2, l^2, sigma_n^2) and mu."""
        signal_variance, length_squared, noise_variance = np.asarray(beta, float)
        K_y = signal_variance * np.exp(-chord(angle_rad, angle_rad) / length_squared)
        K_y.flat[:: len(K_y) + 1] += noise_variance
        factor = cholesky(K_y, lower=True)
        weights = cho_solve((factor, True), radius_m - mu)
        return cls(angle_rad, float(signal_variance), float(length_squared), factor, weights)

    def predict(self, angle_rad: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Deviation from mu (sample,) in m, its variance in m^2, and the variance due to the unknown mu, in m^2.

        The first two are the printed predictive mean and variance. The third is (1 - k*' K_y^-1 1)^2 / (1'
        K_y^-1 1): Rasmussen and Williams 2006, equation (2.42), for a constant basis function with a vague
        prior.
        """
        cross = self.signal_variance * np.exp(-chord(self.angle_rad, angle_rad) / self.length_squared)
        whitened = self._whiten(cross)
        ones = self._whiten(np.ones(len(cross)))
        variance = np.maximum(self.signal_variance - np.sum(whitened**2, axis=0), 0.0)
        return self.weights_per_m @ cross, variance, (1 - ones @ whitened) ** 2 / (ones @ ones)

    def _whiten(self, columns: FloatArray) -> FloatArray:
        return np.asarray(solve_triangular(self.cholesky_m, columns, lower=True, check_finite=False))
