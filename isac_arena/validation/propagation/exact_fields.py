"""Exact fields near conducting edges and cylinders: eigenfunction series and integrals, slow and obvious.

Time dependence exp(+j 2 pi f t). `sign` is the reflection of the surface: -1 for soft polarisation (the field
vanishes on it), +1 for hard polarisation (its normal derivative does). Line sources give H0(k r) in free space,
H0 the Hankel function of the second kind, the point source exp(-j k r) / r.
"""

from typing import Any

import numpy as np
from scipy.special import fresnel, hankel2, jv

from scenes.record import ComplexArray, FloatArray

N_QUADRATURE = 200


def wedge_series(k: float, n: float, source: tuple[float, float], rho_m: float, phi_rad: Any, sign: int) -> Any:
    """Total field (angle,) of a line source at (rho', phi') in the exterior 0 < phi < n pi of a wedge.

    (1/n) sum_m e_m J_{m/n}(k rho<) H_{m/n}(k rho>) [cos(m (phi - phi') / n) +- cos(m (phi + phi') / n)]: C. A.
    Balanis, Advanced Engineering Electromagnetics, section 13.3. The two radii must differ: the closer they are,
    the more slowly the series converges.
    """
    low, high = sorted((source[0], rho_m))
    m = np.arange(int(n * (k * low + 12 * np.cbrt(k * low) + 30)))
    radial = jv(m / n, k * low) * hankel2(m / n, k * high) * np.where(m > 0, 2, 1) / n
    difference, total = np.asarray(phi_rad) - source[1], np.asarray(phi_rad) + source[1]
    return (np.cos(np.multiply.outer(difference, m / n)) + sign * np.cos(np.multiply.outer(total, m / n))) @ radial


def half_plane_sommerfeld(k: float, phi_in_rad: float, rho_m: Any, phi_rad: Any, sign: int) -> ComplexArray:
    """Total field (...) of the plane wave exp(j k rho cos(phi - phi')) on a half plane phi = 0.

    A. Sommerfeld, Math. Annalen 47 (1896), by Fresnel integrals.
    """

    def sheet(angle: FloatArray) -> ComplexArray:
        bound = -np.sqrt(2 * k * rho_m) * np.cos(angle / 2)
        sine, cosine = fresnel(np.sqrt(2 / np.pi) * bound)
        rest = np.sqrt(np.pi / 2) * ((0.5 - cosine) - 1j * (0.5 - sine))
        return np.asarray(np.exp(1j * (k * rho_m * np.cos(angle) + np.pi / 4)) / np.sqrt(np.pi) * rest)

    phi = np.asarray(phi_rad, float)
    return sheet(phi - phi_in_rad) + sign * sheet(phi + phi_in_rad)


def half_plane_point_source(
    k: float, source: tuple[float, float], rho_m: float, phi_rad: Any, rise_m: float, sign: int
) -> ComplexArray:
    """Total field (angle,) of a point source at (rho', phi') before a half plane, `rise_m` above it.

    Each sheet is k/2j int_{-inf}^m H1(k R cosh t) dt, sinh m = 2 sqrt(rho rho') cos(angle / 2) / R: H. M.
    Macdonald, Proc. London Math. Soc. 14 (1915). With y = R cosh t the integral from |m| on runs down the path of
    steepest descent y = R1 - j s^2, R1 being the length over the edge.
    """
    over_edge = np.hypot(source[0] + rho_m, rise_m)
    node, weight = np.polynomial.legendre.leggauss(N_QUADRATURE)
    end = np.sqrt(40 / k)
    s, weight = (node + 1) * end / 2, weight * end / 2

    def sheet(angle: FloatArray) -> ComplexArray:
        half = np.cos(angle / 2)
        square = over_edge**2 - 4 * source[0] * rho_m * half**2
        y = over_edge - 1j * s**2
        root = np.sqrt(4 * source[0] * rho_m * half[:, None] ** 2 - s**2 * (2j * over_edge + s**2))
        tail = k / 2j * (hankel2(1, k * y) / root * -2j * s) @ weight
        distance = np.sqrt(square)
        return np.asarray(np.where(half > 0, np.exp(-1j * k * distance) / distance - tail, tail))

    phi = np.asarray(phi_rad, float)
    return sheet(phi - source[1]) + sign * sheet(phi + source[1])


def cylinder_series(
    k: float, radius_m: float, tx_xy_m: FloatArray, rx_xy_m: FloatArray, sign: int
) -> ComplexArray:
    """Scattered field (receiver,) of a line source at (xy,) and a conducting cylinder about the origin.

    -sum_n a_n H_n(k rho) H_n(k rho') e^{j n (phi - phi')} with a_n = J_n(ka) / H_n(ka) (soft) or the ratio of
    the derivatives (hard): C. A. Balanis, Advanced Engineering Electromagnetics, section 11.5. The ratios fall off
    before the Hankel functions of the far argument grow, so that nothing overflows.
    """
    ka = k * radius_m
    order = np.arange(int(ka + 8 * np.cbrt(ka) + 20))
    if sign < 0:
        ratio = jv(order, ka) / hankel2(order, ka)
    else:
        ratio = (jv(order - 1, ka) - jv(order + 1, ka)) / (hankel2(order - 1, ka) - hankel2(order + 1, ka))
    rx = np.atleast_2d(rx_xy_m)
    turn = np.arctan2(rx[:, 1], rx[:, 0]) - np.arctan2(tx_xy_m[1], tx_xy_m[0])
    radial = ratio * hankel2(order, k * np.hypot(*tx_xy_m)) * np.where(order > 0, 2, 1)
    at_rx = hankel2(order, k * np.hypot(rx[:, 0], rx[:, 1])[:, None])
    return np.asarray(-(radial * at_rx * np.cos(turn[:, None] * order)).sum(axis=1))
