"""How much of the Gaussian information a Student-t estimate keeps."""

from __future__ import annotations

from functools import cache

import numpy as np


@cache
def efficiency(degrees_of_freedom: float, dimension: int) -> float:
    """Information of a Student-t estimate of whitened Gaussian errors over that of least squares.

    (E[div psi] / d)^2 / (E|psi|^2 / d) of psi(z) = z / (nu + |z|^2) for a standard normal z in d dimensions: the
    asymptotic variance of Huber, Robust Statistics, section 3.2.
    """
    nu, d = degrees_of_freedom, dimension
    radius = np.linspace(0.0, 9.0 + np.sqrt(d), 4001)
    square, share = radius**2, radius ** (d - 1) * np.exp(-(radius**2) / 2)
    share = share / share.sum()
    slope = np.sum(share * (nu + square - 2 * square / d) / (nu + square) ** 2)
    return float(slope**2 / np.sum(share * square / d / (nu + square) ** 2))
