"""Periodic Gaussian process by its Fourier (Karhunen-Loeve) expansion: its cost hardly grows with the points.

On the circle the kernel is a sum of harmonics (Abramowitz and Stegun 1964, 9.6.34),

    exp(-2 sin^2(d / 2) / l^2) = sum_k w_k cos(k d),   w_0 = e^-z I_0(z),  w_k = 2 e^-z I_k(z),  z = 1 / l^2,

so K_y = sigma_f^2 Phi W Phi' + sigma_n^2 I with Phi = [1, cos t, sin t, cos 2t, sin 2t, ...]. With
B = I + (sigma_f / sigma_n)^2 W^1/2 Phi' Phi W^1/2 all that the likelihood asks follows from sums over the points
that are made once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrf, dpotrs

from estimation.shape.gp.exact import Likelihood
from estimation.shape.gp.harmonic_terms import harmonic_terms, needed_order, weights
from scenes.record import FloatArray


class FourierSums:
    """Sums over the points that give Phi' Phi and Phi' (r - mean r), computed when their harmonics are needed."""

    def __init__(self, angle_rad: FloatArray, radius_m: FloatArray) -> None:
        self.n_points = len(angle_rad)
        self.mean_radius_m = float(radius_m.mean())
        self.residual_m = radius_m - self.mean_radius_m
        self.square_m2 = float(self.residual_m @ self.residual_m)
        self._turn = np.exp(1j * angle_rad)
        self._order = -1
        self._gram = np.zeros((0, 0))
        self._moment = np.zeros(0)

    def up_to(self, order: int) -> tuple[FloatArray, FloatArray]:
        """Phi' Phi (feature, feature) and Phi' (r - mean r) (feature,) of the harmonics 0 .. order."""
        if order > self._order:
            self._extend(order + order // 4)
        n_features = 2 * order + 1
        return np.ascontiguousarray(self._gram[:n_features, :n_features]), self._moment[:n_features]

    def _extend(self, order: int) -> None:
        power = np.ones(self.n_points, dtype=complex)
        sums, moments = np.empty(2 * order + 1, complex), np.empty(order + 1, complex)
        for k in range(2 * order + 1):
            sums[k] = power.sum()
            if k <= order:
                moments[k] = self.residual_m @ power
            power *= self._turn
        column = np.arange(order + 1)
        row = column[:, None]
        up, down = sums[row + column], sums[np.abs(row - column)]
        odd = np.sign(column - row) * down.imag  # sum of sin((k - j) t) in row j, column k
        n_features = 2 * order + 1
        gram = np.empty((n_features, n_features))  # 1, cos t, sin t, cos 2t, sin 2t, ...
        gram[0::2, 0::2] = (down.real - up.real) / 2  # rows and columns of sines; 0 belongs to the constant
        gram[1::2, 1::2] = ((up.real + down.real) / 2)[1:, 1:]
        gram[1::2, 0::2] = ((up.imag + odd) / 2)[1:, :]
        gram[0::2, 1::2] = gram[1::2, 0::2].T
        gram[0, 0] = self.n_points
        gram[0, 1::2] = gram[1::2, 0] = sums[1 : order + 1].real
        gram[0, 2::2] = gram[2::2, 0] = sums[1 : order + 1].imag
        self._order, self._gram = order, gram
        self._moment = np.empty(n_features)
        self._moment[0] = moments[0].real
        self._moment[1::2], self._moment[2::2] = moments[1:].real, moments[1:].imag


def log_marginal_likelihood_fourier(sums: FourierSums, beta: ArrayLike) -> Likelihood:
    """As `exact.log_marginal_likelihood` with the most likely mu, in a time without the number of points."""
    beta = np.asarray(beta, float)
    n, order = sums.n_points, needed_order(beta[1], sums.n_points * beta[0] / beta[2])
    value, shift, by_log_beta, _ = harmonic_terms(*sums.up_to(order), sums.square_m2, n, order, np.log(beta))
    return Likelihood(value, sums.mean_radius_m + shift, np.array([0.0, *(by_log_beta / beta)]))


@dataclass(frozen=True)
class FourierPosterior:
    """Posterior of the coefficients of the harmonics about the mean radius mu."""

    scale_m: FloatArray  # prior standard deviation sigma_f w^1/2 of every feature (feature,)
    factor: FloatArray  # lower Cholesky factor of B
    coefficient: FloatArray  # of the features times their scale, for r - mu
    ones: FloatArray  # the same for radii that are all 1 m
    ones_square_per_m2: float  # 1' K_y^-1 1

    @classmethod
    def of(cls, sums: FourierSums, beta: ArrayLike, mu: float) -> FourierPosterior:
        """The posterior for beta = (sigma_f^2, l^2, sigma_n^2) and the mean radius mu."""
        signal_variance, length_squared, noise_variance = (float(value) for value in np.asarray(beta, float))
        order = needed_order(length_squared, sums.n_points * signal_variance / noise_variance)
        weight = np.repeat(weights(length_squared, order)[0], 2)[
            1:
        ]  # of the features 1, cos t, sin t, cos 2t, ...
        factor, q = _factor(sums, weight, signal_variance, noise_variance)
        v = dpotrs(factor, q, lower=1)[0]
        return cls(
            scale_m=np.sqrt(signal_variance * weight),
            factor=factor,
            coefficient=v[:, 0] - (mu - sums.mean_radius_m) * v[:, 1],
            ones=v[:, 1],
            ones_square_per_m2=float(sums.n_points / noise_variance - q[:, 1] @ v[:, 1]),
        )

    def predict(self, angle_rad: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `ExactPosterior.predict`."""
        turns = np.arange(1, len(self.scale_m) // 2 + 1)[:, None] * angle_rad
        feature = np.empty((len(self.scale_m), len(angle_rad)))
        feature[0] = 1
        feature[1::2], feature[2::2] = np.cos(turns), np.sin(turns)
        feature *= self.scale_m[:, None]
        whitened = solve_triangular(self.factor, feature, lower=True, check_finite=False)
        of_mean = (1 - self.ones @ feature) ** 2 / self.ones_square_per_m2
        return self.coefficient @ feature, np.sum(whitened**2, axis=0), of_mean


def _factor(
    sums: FourierSums, weight: FloatArray, signal_variance: float, noise_variance: float
) -> tuple[FloatArray, FloatArray]:
    """Lower Cholesky factor of B, and q (feature, 2) of r - mean r and of ones."""
    gram, moment = sums.up_to(len(weight) // 2)
    scale = np.sqrt(signal_variance / noise_variance * weight)
    B = gram * scale
    B *= scale[:, None]
    B.flat[:: len(B) + 1] += 1
    factor = dpotrf(B, lower=1, overwrite_a=1)[0]
    q = np.stack([moment, gram[:, 0]], axis=1) * (scale / np.sqrt(noise_variance))[:, None]
    return factor, q
