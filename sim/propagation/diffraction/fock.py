"""Uniform theory of diffraction at smooth convex surfaces: reflection near grazing and the creeping wave.

P. H. Pathak, W. D. Burnside and R. J. Marhefka, "A uniform GTD analysis of the diffraction of electromagnetic
waves by a smooth convex surface", IEEE Trans. Antennas Propag. 28 (1980) 631-642; time dependence
exp(+j 2 pi f t). The surface is a perfectly conducting cylinder; soft polarisation has the electric field along
its axis (the vertical one), hard the magnetic field.

Oblique rays: all lengths are horizontal (unfolded), and k is the horizontal wavenumber k cos(elevation).
"""

from functools import lru_cache
from typing import Any, Literal

import numpy as np

from scenes.record import ComplexArray, FloatArray
from sim.propagation.diffraction.wedge import transition_function

Polarisation = Literal["soft", "hard"]

N_NODES = 128
REAL_END, ROTATED_END = 10.0, 26.0  # the integrands are below 1e-15 there
REFLECTION_SERIES_BELOW = -6.0  # three terms are accurate to 1e-4 here
RESIDUE_SERIES_ABOVE = 3.0  # ten residues are accurate to 1e-15 here
N_RESIDUES = 10
MIN_ARGUMENT = 1e-9


def grazing_factor(
    k: Any, radius_of_curvature_m: Any, s1_m: Any, s2_m: Any, cos_incidence: Any, polarisation: Polarisation
) -> ComplexArray:
    """Correction factor of the geometrical-optics gain of a reflection off a convex contour; 1 far from grazing.

    Uniform reflection coefficient, equation (32) of Pathak, Burnside and Marhefka, over that of a plane. All
    arguments broadcast: horizontal wavenumber in 1/m, radius of curvature in m (> 0 convex; the factor is 1
    if it is not positive or infinite), horizontal lengths of the two legs in m, cosine of the horizontal
    angle of incidence in (0, 1]. The geometrical-optics gain carries the divergence of the curved surface.
    """
    k, radius, s1, s2, cosine = np.broadcast_arrays(
        *(np.asarray(value, float) for value in (k, radius_of_curvature_m, s1_m, s2_m, cos_incidence))
    )
    factor = np.ones(k.shape, complex)
    convex = np.isfinite(radius) & (radius > 0)
    k, s1, s2, cosine = k[convex], s1[convex], s2[convex], cosine[convex]
    xi = np.minimum(-2 * _size_parameter(k, radius[convex]) * cosine, -MIN_ARGUMENT)
    x = 2 * k * s1 * s2 / (s1 + s2) * cosine**2
    uniform = -np.sqrt(-4 / xi) * np.exp(-1j * xi**3 / 12) * _bracket(xi, x, polarisation)
    factor[convex] = -uniform if polarisation == "soft" else uniform
    return factor


def creeping_gain(
    k: Any, radius_m: Any, s1_m: Any, s2_m: Any, turn_rad: Any, polarisation: Polarisation
) -> ComplexArray:
    """Field in the shadow of a round cylinder over that of a free wave of the path's length s1 + radius turn + s2.

    `convex_creeping_gain` of a circle: turn_rad > 0 is the angle between the points of tangency.
    """
    radius, turn = np.asarray(radius_m, float), np.asarray(turn_rad, float)
    return convex_creeping_gain(
        k, (radius, radius), s1_m, s2_m, radius * turn, np.cbrt(radius) * turn, polarisation
    )


def convex_creeping_gain(
    k: Any, radii_m: tuple[Any, Any], s1_m: Any, s2_m: Any, arc_m: Any, bend: Any, polarisation: Polarisation
) -> ComplexArray:
    """Field in the shadow of a convex cylinder over that of a free wave of the path's length s1 + arc + s2.

    Equations (35) and (36) of Pathak, Burnside and Marhefka, all arguments broadcast: legs s1, s2 in m from the
    ends to their points of tangency, the radii of curvature there, the length of the arc between them, along
    which the wave creeps, and its bend, the integral of curvature^(2/3) in m^(1/3), which makes the Fock parameter
    xi = integral of m / radius. At the shadow boundary, arc 0, it continues the field of the lit side.
    """
    k, s1, s2 = (np.asarray(value, float) for value in (k, s1_m, s2_m))
    m1, m2 = (_size_parameter(k, np.asarray(radius, float)) for radius in radii_m)
    xi = np.maximum(np.cbrt(k / 2) * np.asarray(bend, float), MIN_ARGUMENT)
    x = k * s1 * s2 / (s1 + s2) * xi**2 / (2 * m1 * m2)
    spread = np.sqrt((s1 + np.asarray(arc_m, float) + s2) / (s1 * s2))
    return np.asarray(-np.sqrt(m1 * m2) * np.sqrt(2 / k) * _bracket(xi, x, polarisation) * spread)


def pekeris_function(delta: Any, polarisation: Polarisation) -> ComplexArray:
    """Pekeris caret functions ``p*(delta)`` (soft) and ``q*(delta)`` (hard) of a real argument, same shape.

    ``p* = 1/sqrt(pi) [int_0^inf V/W2 e^{-j delta t} dt + 1/2j int_-inf^0 W1/W2 e^{-j delta t} dt]`` with the
    Fock-type Airy functions V, W1, W2 (their derivatives for ``q*``): N. A. Logan, LMSD-288087 (1959). The second
    integral is along the ray arg t = -2 pi/3, where W1/W2 decays fastest. On the lit side (delta << 0) it uses the
    reflection expansion, in the shadow (delta >> 0) the residue series.
    """
    delta = np.asarray(delta, float)
    result = np.zeros(delta.shape, complex)
    lit, dark = delta < REFLECTION_SERIES_BELOW, delta > RESIDUE_SERIES_ABOVE
    near = ~(lit | dark)
    result[near] = _by_quadrature(delta[near], polarisation)
    for where, series in ((lit, _reflection_series), (dark, _residue_series)):
        pole = 1 / (2 * np.sqrt(np.pi) * delta[where])
        result[where] = np.exp(0.25j * np.pi) * series(delta[where], polarisation) + pole
    return result


def _size_parameter(k: FloatArray, radius: FloatArray) -> FloatArray:
    return np.asarray(np.cbrt(k * radius / 2))


def _bracket(xi: FloatArray, x: FloatArray, polarisation: Polarisation) -> ComplexArray:
    """e^{-j pi/4} [p*(xi) - F(x) / (2 sqrt(pi) xi)], common to the lit side and the shadow."""
    edge = transition_function(x) / (2 * np.sqrt(np.pi) * xi)
    return np.asarray(np.exp(-0.25j * np.pi) * (pekeris_function(xi, polarisation) - edge))


@lru_cache
def _integrands(polarisation: Polarisation) -> tuple[ComplexArray, ComplexArray]:
    """Exponents -j t (node,) and weighted integrands (node,) of both contours, 1/sqrt(pi) included.

    With W1(t) = 2 sqrt(pi) e^{j pi/6} Ai(t e^{j 2 pi/3}) and W2 its conjugate, W1/W2 at t = r e^{-j 2 pi/3} is
    e^{j pi/3} Ai(r) / Ai(r e^{j 2 pi/3}).
    """
    from scipy.special import airy  # noqa: PLC0415  (slow to import)

    node, weight = np.polynomial.legendre.leggauss(N_NODES)
    t, r = (node + 1) * REAL_END / 2, (node + 1) * ROTATED_END / 2
    turn = np.exp(1j * np.pi / 3)
    ai, ai_prime, bi, bi_prime = airy(t)
    near, near_prime = airy(r)[:2]
    far, far_prime = airy(r * turn**2)[:2]
    if polarisation == "soft":
        v, w = ai / (bi - 1j * ai), turn * near / far
    else:
        v, w = ai_prime / (bi_prime - 1j * ai_prime), turn**5 * near_prime / far_prime
    exponent = np.concatenate([-1j * t, 1j * r * turn])
    value = np.concatenate([v * weight * REAL_END / 2, w * turn / 2j * weight * ROTATED_END / 2])
    return exponent, value / np.sqrt(np.pi)


def _by_quadrature(delta: FloatArray, polarisation: Polarisation) -> ComplexArray:
    exponent, value = _integrands(polarisation)
    return np.asarray(np.exp(delta[:, None] * exponent) @ value)


def _reflection_series(delta: FloatArray, polarisation: Polarisation) -> ComplexArray:
    """Scattering function deep in the light: +-sqrt(-delta/4) e^{j delta^3/12} (1 +- 2j/delta^3 + ...)."""
    if polarisation == "soft":
        sign, terms = 1.0, 1 + 2j / delta**3 + 20 / delta**6 - 560j / delta**9
    else:
        sign, terms = -1.0, 1 - 2j / delta**3 - 28 / delta**6 + 896j / delta**9
    return np.asarray(sign * np.sqrt(-delta / 4) * np.exp(1j * delta**3 / 12) * terms)


def _residue_series(delta: FloatArray, polarisation: Polarisation) -> ComplexArray:
    """Scattering function as the sum of creeping waves, one per zero of Ai (soft) or Ai' (hard)."""
    from scipy.special import ai_zeros  # noqa: PLC0415  (slow to import)

    zero, zero_prime, value_at_zero_prime, slope_at_zero = ai_zeros(N_RESIDUES)
    if polarisation == "soft":
        root, strength = -zero, 1 / slope_at_zero**2
    else:
        root, strength = -zero_prime, 1 / (-zero_prime * value_at_zero_prime**2)
    waves = np.exp(delta[:, None] * root * np.exp(-5j * np.pi / 6)) @ strength
    return np.asarray(-np.exp(-1j * np.pi / 12) / (2 * np.sqrt(np.pi)) * waves)
