"""Gaussian-process (GP) regression of a radial function r = f(angle) + n (paper, section III-B).

The kernel is the periodic squared exponential with period 2 pi, the mean is an unknown constant mu, and mu and
beta = (sigma_f^2, l^2, sigma_n^2) maximise the log marginal likelihood by its analytic gradient.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import Bounds, minimize

from scenes.record import FloatArray

# Bounds of the search: standard deviations relative to the rms radius, the length scale as it is. They keep
# the covariance matrix well conditioned; an optimum beyond them describes the same function in practice.
SIGNAL_STD_BOUNDS = (1e-4, 10.0)
NOISE_STD_BOUNDS = (1e-3, 10.0)
LENGTH_SCALE_BOUNDS = (0.05, 10.0)
SMALLEST_SCALE_M = 0.01

PAPER_START = np.array([[4.0, 4.0, 4.0]])  # beta of sigma_f = l = sigma_n = 2


@dataclass(frozen=True)
class RadialGp:
    """A fitted radial function: the learned parameters and what prediction needs of the training data."""

    angle_rad: FloatArray
    mean_m: float
    signal_std_m: float
    length_scale: float
    noise_std_m: float
    log_likelihood: float
    mean_uncertainty: bool
    cholesky_m: FloatArray  # lower factor of K_y
    weights_per_m: FloatArray  # K_y^-1 (r - mu)

    def predict(self, angle_rad: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation in m of the radius f at angles (sample,) in rad.

        The printed predictive mean and variance. With `mean_uncertainty` the variance of the learned mean is
        added, (1 - k*' K_y^-1 1)^2 / (1' K_y^-1 1): Rasmussen and Williams 2006, equation (2.42), for a
        constant basis function with a vague prior.
        """
        chords = chord(self.angle_rad, np.asarray(angle_rad, float))
        cross = self.signal_std_m**2 * np.exp(-chords / self.length_scale**2)  # k* as columns
        mean = self.mean_m + self.weights_per_m @ cross
        whitened = self._whiten(cross)
        variance = np.maximum(self.signal_std_m**2 - np.sum(whitened**2, axis=0), 0.0)
        if self.mean_uncertainty:
            ones = self._whiten(np.ones(len(cross)))
            variance += (1 - ones @ whitened) ** 2 / (ones @ ones)
        return mean, np.sqrt(variance)

    def _whiten(self, columns: FloatArray) -> FloatArray:
        return np.asarray(solve_triangular(self.cholesky_m, columns, lower=True, check_finite=False))


def fit_radial_gp(
    angle_rad: FloatArray,
    radius_m: FloatArray,
    start: Literal["paper", "data"] = "data",
    mean_uncertainty: bool = True,
    noise_floor_std_m: float = 0.0,
) -> RadialGp:
    """Fit the radial function to contour points at angle (ip,) in rad and radius (ip,) in m, one or more.

    `start` is `paper`: l = sigma_f = sigma_n = 2; or `data`: the most likely result of three starts taken from
    the data. The search runs over log beta with mu at its best for each beta, so mu needs no start. sigma_n
    stays at or above `noise_floor_std_m`.

    Raises
    ------
    ValueError
        Where there is no point, or angles and radii differ in number.
    """
    if len(angle_rad) == 0 or len(angle_rad) != len(radius_m):
        raise ValueError(
            f"radial GP: {len(angle_rad)} angles and {len(radius_m)} radii given, the same number of at least "
            "1 is needed"
        )
    chords = chord(angle_rad, angle_rad)
    bounds = _search_bounds(radius_m, noise_floor_std_m)
    starts = PAPER_START if start == "paper" else _data_starts(angle_rad, radius_m)
    optima = [_maximise_likelihood(chords, radius_m, first, bounds) for first in starts]
    log_likelihood, beta = max(optima, key=lambda optimum: optimum[0])

    mu = log_marginal_likelihood(chords, radius_m, beta).mu
    signal_std, length_scale, noise_std = np.sqrt(beta)
    K_y = signal_std**2 * np.exp(-chords / length_scale**2) + noise_std**2 * np.eye(len(radius_m))
    factor = cholesky(K_y, lower=True)
    return RadialGp(
        angle_rad=angle_rad,
        mean_m=mu,
        signal_std_m=float(signal_std),
        length_scale=float(length_scale),
        noise_std_m=float(noise_std),
        log_likelihood=log_likelihood,
        mean_uncertainty=mean_uncertainty,
        cholesky_m=factor,
        weights_per_m=cho_solve((factor, True), radius_m - mu),
    )


def chord(angle_a_rad: FloatArray, angle_b_rad: FloatArray) -> FloatArray:
    """2 sin^2((a - b) / 2) for every pair (a, b) of angles in rad: the kernel is sigma_f^2 exp(-chord / l^2)."""
    return 2 * np.sin((angle_a_rad[:, None] - angle_b_rad[None, :]) / 2) ** 2


class Likelihood(NamedTuple):
    """Log marginal likelihood, the mean radius mu in m it holds for, and its gradient by (mu, *beta)."""

    value: float
    mu: float
    gradient: FloatArray


def log_marginal_likelihood(
    chords: FloatArray, radius_m: FloatArray, beta: ArrayLike, mu: float | None = None
) -> Likelihood:
    """Log marginal likelihood of radii (ip,) and its gradient (4,) by (mu, sigma_f^2, l^2, sigma_n^2).

    `chords` (ip, ip) are those of the training angles and beta = (sigma_f^2, l^2, sigma_n^2). The paper's log
    marginal likelihood and partial derivatives, with K_y^-1 by its Cholesky factor. Without `mu` it is the
    most likely one for that beta, where the derivative by mu is zero: 1' K_y^-1 r / (1' K_y^-1 1).
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


def _maximise_likelihood(
    chords: FloatArray, radius_m: FloatArray, start: FloatArray, bounds: FloatArray
) -> tuple[float, FloatArray]:
    """Log likelihood and beta at the optimum over log beta, by L-BFGS-B; mu follows from beta at each step."""

    def negative(log_beta: FloatArray) -> tuple[float, FloatArray]:
        beta = np.exp(log_beta)
        likelihood = log_marginal_likelihood(chords, radius_m, beta)
        return -likelihood.value, -likelihood.gradient[1:] * beta

    first = np.log(np.clip(start, *bounds))
    found = minimize(negative, first, jac=True, method="L-BFGS-B", bounds=Bounds(*np.log(bounds)))
    return -float(found.fun), np.exp(found.x)


def _search_bounds(radius_m: FloatArray, noise_floor_std_m: float) -> FloatArray:
    """Lower and upper bounds (2, 3) of beta."""
    scale = max(float(np.sqrt(np.mean(radius_m**2))), SMALLEST_SCALE_M)
    noise = np.maximum(scale * np.array(NOISE_STD_BOUNDS), noise_floor_std_m)
    return np.stack([scale * np.array(SIGNAL_STD_BOUNDS), LENGTH_SCALE_BOUNDS, noise], axis=1) ** 2


def _data_starts(angle_rad: FloatArray, radius_m: FloatArray) -> FloatArray:
    """Starts (3, 3) of beta from the spread of the radii and the differences between neighbours in angle.

    Two take the spread as signal, with a short and a long length scale; one takes nearly all of it as noise.
    """
    around = radius_m[np.argsort(angle_rad)]
    spread = max(float(np.var(radius_m)), SMALLEST_SCALE_M**2)
    noise = max(0.5 * float(np.mean((around - np.roll(around, 1)) ** 2)), 1e-4 * spread)
    return np.array([[spread, 0.3**2, noise], [spread, 1.0, noise], [0.01 * spread, 1.0, spread]])
