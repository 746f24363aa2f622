"""Fisher information of a beam pair of unknown phase: two expectations over Rician amplitudes.

A pair receives y = exp(j psi) mu + w with psi uniform and w circular Gaussian of unit variance per sample. The
likelihood marginalised over psi is exp(-|y|^2 - |mu|^2) I0(2 |mu^H y|). Its score along a derivative d of mu is

    -2 Re(mu^H d) + 2 r(2 |z|) Re(exp(-j arg z) d^H y),    z = mu^H y,  r = I1 / I0,

and with d = alpha mu + d', d' orthogonal to mu, the covariance of two scores is

    J_ab = 4 A(g) Re(alpha_a) Re(alpha_b) + 2 B(g) Re(d'_a^H d'_b),    g = |mu|^2,
    A(g) = E[(|z| r(2 |z|) - g)^2],    B(g) = E[r(2 |z|)^2],

since d'^H w is independent of z. Im(alpha), the phase of the pair, is unobservable. |z| = sqrt(g) |sqrt(g) + n| is
Rician. A(g) tends to g / 2 and B(g) to 1 for strong pairs, which only lose their phase; both vanish for weak ones.
"""

from functools import cache

import numpy as np
from scipy.special import i0e, i1e

from scenes.record import FloatArray

_TABLE_SNR = (1e-6, 1e6)  # outside it the expansions below are exact to 1e-6
_TABLE_POINTS = 1500
_QUADRATURE_POINTS = 160
_REACH = 7.0  # of the Rician amplitude about sqrt(g): the probability outside is 1e-21


def pair_information(snr: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A and B of pairs with SNR g = |mu|^2 / sigma^2 over all their samples, any shape, from a table."""
    log_table, a_over_snr, b_table = _table()
    low, high = _TABLE_SNR
    log_snr = np.log(np.clip(snr, low, high))
    a = snr * np.interp(log_snr, log_table, a_over_snr)
    b = np.interp(log_snr, log_table, b_table)
    weak = snr < low
    return np.where(weak, np.square(snr), a), np.where(weak, snr, b)


def exact_pair_information(snr: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A and B (n,) of positive SNRs (n,) by Gauss-Legendre quadrature over the Rician density."""
    node, weight = np.polynomial.legendre.leggauss(_QUADRATURE_POINTS)
    centre = np.sqrt(snr)[:, None]
    low, high = np.maximum(centre - _REACH, 0.0), centre + _REACH
    amplitude = (low + high) / 2 + (high - low) / 2 * node
    argument = 2 * centre * amplitude
    density = 2 * amplitude * np.exp(-np.square(amplitude - centre)) * i0e(argument)
    share = density * weight * (high - low) / 2
    ratio = i1e(argument) / i0e(argument)
    a = (share * np.square(centre * amplitude * ratio - snr[:, None])).sum(axis=1)
    return a, (share * np.square(ratio)).sum(axis=1)


@cache
def _table() -> tuple[FloatArray, FloatArray, FloatArray]:
    snr = np.geomspace(*_TABLE_SNR, _TABLE_POINTS)
    a, b = exact_pair_information(snr)
    return np.log(snr), a / snr, b
