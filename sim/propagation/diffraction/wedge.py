"""Uniform theory of diffraction at straight edges: the wedge of Kouyoumjian and Pathak.

"A uniform geometrical theory of diffraction for an edge in a perfectly conducting surface", Proc. IEEE 62 (1974)
1448-1461; time dependence exp(+j 2 pi f t). Lossy faces follow the heuristic of R. J. Luebbers, IEEE Trans.
Antennas Propag. 32 (1984) 70-76: their reflection coefficients multiply the terms of the two reflection
boundaries.

The exterior of the wedge is the sector 0 < phi < n pi; angles are measured from its face 0 about the edge, the
other face is called n. All fields are components along the edge (soft polarisation, which is the vertical one at
a vertical edge); perfectly conducting faces reflect them by -1. Hard polarisation takes +1.
"""

from typing import Any

import numpy as np

from scenes.record import ComplexArray, FloatArray

MIN_BOUNDARY_ANGLE = 1e-9  # rad; least distance of a term from its boundary, where it jumps


def transition_function(x: Any) -> ComplexArray:
    """Transition function F(x) = 2j sqrt(x) e^{jx} int_{sqrt(x)}^inf e^{-j t^2} dt of x >= 0, same shape.

    Kouyoumjian and Pathak, equation (26), by the Faddeeva function; F -> 1 for large x.
    """
    from scipy.special import wofz  # noqa: PLC0415  (slow to import)

    root = np.sqrt(np.asarray(x, float))
    return np.asarray(np.sqrt(np.pi) * np.exp(0.25j * np.pi) * root * wofz(np.exp(0.75j * np.pi) * root))


def wedge_coefficient(
    wavenumber: Any,
    n: Any,
    phi_in_rad: Any,
    phi_out_rad: Any,
    distance_parameter_m: Any,
    sin_beta: Any = 1.0,
    reflection_0: Any = -1.0,
    reflection_n: Any = -1.0,
) -> ComplexArray:
    """Diffraction coefficient D in sqrt(m) of a wedge with the exterior angle n pi.

    Equation (25) of Kouyoumjian and Pathak, all arguments broadcast. `phi_in_rad` points from the edge to the
    source, `phi_out_rad` to the observer, `sin_beta` is the sine of the angle between the rays and the edge, and
    the distance parameter L is that of `distance_parameter`. The reflection coefficients default to perfectly
    conducting faces in soft polarisation.
    """
    k, n = np.asarray(wavenumber, float), np.asarray(n, float)
    difference = np.asarray(phi_out_rad, float) - phi_in_rad
    total = np.asarray(phi_out_rad, float) + phi_in_rad
    k_l = k * distance_parameter_m
    terms = _term(difference, 1, n, k_l) + _term(difference, -1, n, k_l)
    terms = terms + reflection_n * _term(total, 1, n, k_l) + reflection_0 * _term(total, -1, n, k_l)
    return np.asarray(-np.exp(-0.25j * np.pi) / (2 * n * np.sqrt(2 * np.pi * k) * sin_beta) * terms)


def distance_parameter(s_in_m: Any, s_out_m: Any, sin_beta: Any = 1.0) -> FloatArray:
    """L = s' s sin^2(beta) / (s' + s) in m of a spherical wave; cylindrical waves have sin(beta) = 1."""
    s_in, s_out = np.asarray(s_in_m, float), np.asarray(s_out_m, float)
    return np.asarray(s_in * s_out / (s_in + s_out) * np.asarray(sin_beta) ** 2)


def wedge_gain(
    wavenumber: Any,
    n: Any,
    phi_in_rad: Any,
    phi_out_rad: Any,
    s_in_m: Any,
    s_out_m: Any,
    sin_beta: Any = 1.0,
    reflection_0: Any = -1.0,
    reflection_n: Any = -1.0,
) -> ComplexArray:
    """Diffracted field over that of a free wave that has travelled s' + s, broadcast.

    D sqrt((s' + s) / (s' s)): the spreading factor sqrt(s' / (s (s' + s))) of a spherical wave, and equally that
    of a cylindrical wave on an edge parallel to its axis.
    """
    s_in, s_out = np.asarray(s_in_m, float), np.asarray(s_out_m, float)
    parameter = distance_parameter(s_in, s_out, sin_beta)
    coefficient = wedge_coefficient(
        wavenumber, n, phi_in_rad, phi_out_rad, parameter, sin_beta, reflection_0, reflection_n
    )
    return np.asarray(coefficient * np.sqrt((s_in + s_out) / (s_in * s_out)))


def _term(beta: FloatArray, sign: int, n: FloatArray, k_l: FloatArray) -> ComplexArray:
    """cot((pi + sign beta) / 2n) F(k L a), a = 2 cos^2((2 n pi N - beta) / 2), N the integer of the boundary."""
    boundary = np.round((beta + sign * np.pi) / (2 * np.pi * n))
    a = 2 * np.cos((2 * np.pi * n * boundary - beta) / 2) ** 2
    angle = (np.pi + sign * beta) / (2 * n)
    offset = angle - np.pi * np.round(angle / np.pi)
    tangent = np.tan(np.where(np.abs(offset) < MIN_BOUNDARY_ANGLE, MIN_BOUNDARY_ANGLE, offset))
    a = np.where(np.abs(offset) < MIN_BOUNDARY_ANGLE, 2 * np.sin(n * MIN_BOUNDARY_ANGLE) ** 2, a)
    return np.asarray(transition_function(k_l * a) / tangent)
