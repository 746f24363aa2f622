"""Reflection off a slab: coefficients of ITU-R P.2040-3 and what they do to a vertically polarised wave.

Time dependence exp(+j 2 pi f t), so a lossy relative permittivity has a negative imaginary part.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import ComplexArray, FloatArray


def slab_reflection(
    cos_incidence: Any, relative_permittivity: complex, thickness_m: float, frequency_hz: float
) -> tuple[ComplexArray, ComplexArray]:
    """Reflection coefficients (R_s, R_p), each of the shape of `cos_incidence`, of a slab in air.

    R = R' (1 - e^{-j2q}) / (1 - R'^2 e^{-j2q}), q = (2 pi d / lambda) sqrt(eta - sin^2 t): ITU-R P.2040-3,
    equations (37) and (43a), R' being the Fresnel coefficient of one face. R_s (TE) is for the electric field
    normal to the plane of incidence, R_p (TM) for the field in it. An infinite permittivity is a perfect
    conductor, R_s = -1 and R_p = +1.
    """
    cosine = np.asarray(cos_incidence, float)
    if not np.isfinite(relative_permittivity):
        ones = np.ones(cosine.shape, complex)
        return -ones, ones
    refracted = np.sqrt(relative_permittivity - (1 - cosine**2) + 0j)
    face_s = (cosine - refracted) / (cosine + refracted)
    face_p = (relative_permittivity * cosine - refracted) / (relative_permittivity * cosine + refracted)
    round_trip = np.exp(-4j * np.pi * thickness_m * frequency_hz / SPEED_OF_LIGHT_M_S * refracted)
    return (
        face_s * (1 - round_trip) / (1 - face_s**2 * round_trip),
        face_p * (1 - round_trip) / (1 - face_p**2 * round_trip),
    )


def vertical_polarisation(direction: Any) -> FloatArray:
    """Unit vector (..., xyz) of the vertically polarised field of a wave along `direction` (..., xyz).

    It is the spherical theta vector: normal to the direction, in its vertical plane, pointing down. A wave
    straight up or down has azimuth 0.
    """
    k = np.asarray(direction, float)
    level = np.hypot(k[..., 0], k[..., 1])
    safe = np.where(level > 0, level, 1.0)
    cos_azimuth = np.where(level > 0, k[..., 0] / safe, 1.0)
    return np.stack([k[..., 2] * cos_azimuth, k[..., 2] * k[..., 1] / safe, -level], axis=-1)


def vertical_reflection(
    incident: Any, reflected: Any, normal: Any, reflection_s: Any, reflection_p: Any
) -> ComplexArray:
    """Gain (...) of one reflection between vertically polarised antennas.

    `incident` and `reflected` are the unit directions of travel (..., xyz) before and after, `normal` the unit
    normal of the surface on either side. The field is split into the parts normal to and in the plane of
    incidence, each is scaled by its coefficient, and the sum is projected on the receiver's polarisation.
    """
    k_in, k_out = np.asarray(incident, float), np.asarray(reflected, float)
    s_vector = _normal_to_plane_of_incidence(k_in, np.asarray(normal, float))
    p_in, p_out = np.cross(s_vector, k_in), np.cross(s_vector, k_out)
    sent, received = vertical_polarisation(k_in), vertical_polarisation(k_out)

    def part(basis_in: FloatArray, basis_out: FloatArray) -> FloatArray:
        return np.asarray((sent * basis_in).sum(axis=-1) * (received * basis_out).sum(axis=-1))

    return np.asarray(reflection_s * part(s_vector, s_vector) + reflection_p * part(p_in, p_out))


def _normal_to_plane_of_incidence(incident: FloatArray, normal: FloatArray) -> FloatArray:
    """Unit s vector (..., xyz); at normal incidence, where any will do, one along the surface."""
    across = np.cross(incident, normal)
    fallback = np.cross(normal, np.where(np.abs(normal[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    across = np.where(np.linalg.norm(across, axis=-1, keepdims=True) > 1e-9, across, fallback)
    return np.asarray(across / np.linalg.norm(across, axis=-1, keepdims=True))
