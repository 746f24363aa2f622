"""Closed convex contours by their support function h(psi): the distance of the tangent with normal psi.

A contour about a centre c is x(psi) = c + h n + h' e with n = (cos psi, sin psi) and e = (-sin psi, cos psi);
its radius of curvature is h + h''. Parameters are [x, y, log R, shape ...] in m, with h = R f(psi; shape):

- circle: f = 1; by its radius, [x, y, R] with R of any sign, where an estimate may pass through zero;
- ellipse: f^2 = cosh|w| + sinh|w| cos(2 psi - azimuth of w), shape w (2,). R is the geometric mean of the half
  axes, |w| the logarithm of their ratio, and the azimuth of w twice that of the long axis. A circle is not
  singular;
- rounded square: f = t + (1 - t) (E(psi - alpha) + E(psi - alpha - pi/2)), shape [log(t / (1 - t)), alpha]. With
  E = |cos| it is a square with corners rounded by a share t of its half width; E = sqrt(cos^2 + eps^2) bends
  its faces to radii of R / eps, so that x(psi) is continuous;
- harmonics: f = 1 + sum over k >= 2 of a_k cos k psi + b_k sin k psi, shape [a_2, b_2, a_3, ...].

Source: Schneider, "Convex Bodies: The Brunn-Minkowski Theory", section 1.7 (support functions).
"""

import numpy as np
from numpy.typing import ArrayLike

from estimation.execution import compiled
from scenes.record import FloatArray

CIRCLE, ELLIPSE, ROUNDED_SQUARE, HARMONICS, CIRCLE_BY_RADIUS = range(5)
CLOSED_FAMILY = {"circle": CIRCLE, "ellipse": ELLIPSE, "rounded_square": ROUNDED_SQUARE, "support_gp": HARMONICS}
FACE_BEND = 0.03  # eps of the rounded square


def support(family: int, parameter: FloatArray, psi_rad: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Values (psi, 3) of h, h' and h'' in m, and derivatives (psi, 2, parameter) of h and h' by the parameters.

    The centre's columns hold the derivatives of the tangent's distance from the origin, n and e.
    """
    psi = np.atleast_1d(np.asarray(psi_rad, float))
    value, slope = np.zeros((len(psi), 3)), np.zeros((len(psi), 2, len(parameter)))
    _support_all(family, parameter, psi, value, slope)
    slope[:, 0, 0], slope[:, 0, 1] = np.cos(psi), np.sin(psi)
    slope[:, 1, 0], slope[:, 1, 1] = -np.sin(psi), np.cos(psi)
    return value, slope


def contour_points(family: int, parameter: FloatArray, psi_rad: ArrayLike) -> FloatArray:
    """Points (psi, xy) in m of the contour where its outward normal has the azimuth psi."""
    psi = np.atleast_1d(np.asarray(psi_rad, float))
    value, _ = support(family, parameter, psi)
    normal = np.column_stack([np.cos(psi), np.sin(psi)])
    tangent = np.column_stack([-np.sin(psi), np.cos(psi)])
    return np.asarray(parameter[:2] + value[:, :1] * normal + value[:, 1:2] * tangent)


def normal_std_m(family: int, parameter: FloatArray, covariance: FloatArray, psi_rad: ArrayLike) -> FloatArray:
    """Standard deviation (psi,) in m of the contour along its normals: that of the tangent's distance."""
    _, slope = support(family, parameter, psi_rad)
    variance = np.einsum("pi,ij,pj->p", slope[:, 0], covariance, slope[:, 0])
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@compiled
def support_terms(family: int, parameter: FloatArray, psi: float, value: FloatArray, slope: FloatArray) -> None:
    """Write [h, h', h''] into `value` (3,) and d[h, h'] by the parameters into `slope` (2, parameter).

    The columns of the centre are not written.
    """
    if family == CIRCLE_BY_RADIUS:
        value[0], value[1], value[2] = parameter[2], 0.0, 0.0
        slope[0, 2], slope[1, 2] = 1.0, 0.0
        return
    radius = np.exp(parameter[2])
    if family == CIRCLE:
        value[0], value[1], value[2] = radius, 0.0, 0.0
        slope[0, 2], slope[1, 2] = radius, 0.0
        return
    shape, by_shape = parameter[3:], slope[:, 3:]
    if family == ELLIPSE:
        _ellipse(shape, psi, value, by_shape)
    elif family == ROUNDED_SQUARE:
        _rounded_square(shape, psi, value, by_shape)
    else:
        _harmonics(shape, psi, value, by_shape)
    for i in range(3):
        value[i] *= radius
    for k in range(2):
        slope[k, 2] = value[k]
        for j in range(len(shape)):
            by_shape[k, j] *= radius


@compiled
def _support_all(
    family: int, parameter: FloatArray, psi: FloatArray, value: FloatArray, slope: FloatArray
) -> None:
    for i in range(len(psi)):
        support_terms(family, parameter, psi[i], value[i], slope[i])


@compiled
def _ellipse(w: FloatArray, psi: float, value: FloatArray, slope: FloatArray) -> None:
    m = np.sqrt(w[0] ** 2 + w[1] ** 2)
    even = np.cosh(m)
    if m > 1e-3:
        odd = np.sinh(m) / m
        odd_slope = (even - odd) / m**2
    else:
        odd, odd_slope = 1 + m**2 / 6, 1.0 / 3 + m**2 / 30
    k = (np.cos(2 * psi), np.sin(2 * psi))
    k1 = (-2 * k[1], 2 * k[0])
    along, along1 = k[0] * w[0] + k[1] * w[1], k1[0] * w[0] + k1[1] * w[1]
    g, g1, g2 = even + odd * along, odd * along1, -4 * odd * along
    f = np.sqrt(g)
    value[0], value[1], value[2] = f, g1 / (2 * f), g2 / (2 * f) - g1**2 / (4 * f**3)
    for j in range(2):
        by_g = odd * w[j] + odd * k[j] + odd_slope * w[j] * along
        by_g1 = odd * k1[j] + odd_slope * w[j] * along1
        slope[0, j] = by_g / (2 * f)
        slope[1, j] = by_g1 / (2 * f) - g1 * by_g / (4 * f**3)


@compiled
def _rounded_square(shape: FloatArray, psi: float, value: FloatArray, slope: FloatArray) -> None:
    t = 1 / (1 + np.exp(-shape[0]))
    g, g1, g2 = 0.0, 0.0, 0.0
    for quarter in range(2):
        phi = psi - shape[1] - quarter * np.pi / 2
        bend = np.sqrt(np.cos(phi) ** 2 + FACE_BEND**2)
        g += bend
        g1 -= np.sin(2 * phi) / (2 * bend)
        g2 -= np.cos(2 * phi) / bend + np.sin(2 * phi) ** 2 / (4 * bend**3)
    value[0], value[1], value[2] = t + (1 - t) * g, (1 - t) * g1, (1 - t) * g2
    slope[0, 0], slope[1, 0] = t * (1 - t) * (1 - g), -t * (1 - t) * g1
    slope[0, 1], slope[1, 1] = -value[1], -value[2]


@compiled
def _harmonics(shape: FloatArray, psi: float, value: FloatArray, slope: FloatArray) -> None:
    value[0], value[1], value[2] = 1.0, 0.0, 0.0
    for pair in range(len(shape) // 2):
        k = pair + 2
        cosine, sine = np.cos(k * psi), np.sin(k * psi)
        a, b = shape[2 * pair], shape[2 * pair + 1]
        value[0] += a * cosine + b * sine
        value[1] += k * (b * cosine - a * sine)
        value[2] -= k**2 * (a * cosine + b * sine)
        slope[0, 2 * pair], slope[0, 2 * pair + 1] = cosine, sine
        slope[1, 2 * pair], slope[1, 2 * pair + 1] = -k * sine, k * cosine
