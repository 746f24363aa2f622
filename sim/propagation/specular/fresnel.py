"""Reflection off a slab and transmission through it (ITU-R P.2040-3), and their effect on the polarised field.

Time dependence exp(+j 2 pi f t), so a lossy relative permittivity has a negative imaginary part.
"""

from typing import Any

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import ComplexArray, FloatArray


def slab_reflection(
    cos_incidence: Any, relative_permittivity: Any, thickness_m: Any, frequency_hz: float
) -> tuple[ComplexArray, ComplexArray]:
    """Reflection coefficients (R_s, R_p), each of the shape of `cos_incidence`, of a slab in air.

    R = R' (1 - e^{-j2q}) / (1 - R'^2 e^{-j2q}), q = (2 pi d / lambda) sqrt(eta - sin^2 t): ITU-R P.2040-3,
    equations (37) and (43a), with the Fresnel coefficient R' of one face. R_s (TE) applies to the electric field
    normal to the plane of incidence, R_p (TM) to the field in this plane. An infinite permittivity is a perfect
    conductor, R_s = -1 and R_p = +1. Permittivity and thickness may be arrays of the same shape.
    """
    return slab(cos_incidence, relative_permittivity, thickness_m, frequency_hz)[0]


def slab_transmission(
    cos_incidence: Any, relative_permittivity: Any, thickness_m: Any, frequency_hz: float
) -> tuple[ComplexArray, ComplexArray]:
    """Transmission coefficients (T_s, T_p), each of the shape of `cos_incidence`, through a slab in air.

    T = (1 - R'^2) e^{-jq} / (1 - R'^2 e^{-j2q}): ITU-R P.2040-3, equation (43b), from one face to the other.
    Without loss |R|^2 + |T|^2 = 1. Zero through a perfect conductor.
    """
    return slab(cos_incidence, relative_permittivity, thickness_m, frequency_hz)[1]


def slab(
    cos_incidence: Any, relative_permittivity: Any, thickness_m: Any, frequency_hz: float
) -> tuple[tuple[ComplexArray, ComplexArray], tuple[ComplexArray, ComplexArray]]:
    """Coefficients ((R_s, R_p), (T_s, T_p)) of `slab_reflection` and `slab_transmission`, in one pass."""
    cosine = np.asarray(cos_incidence, float)
    permittivity = np.asarray(relative_permittivity, complex)
    perfect = ~np.isfinite(permittivity)
    eta = np.where(perfect, 1.0, permittivity)
    refracted = np.sqrt(eta - (1 - cosine**2) + 0j)
    single_way = np.exp(-2j * np.pi * np.asarray(thickness_m) * frequency_hz / SPEED_OF_LIGHT_M_S * refracted)
    faces = ((cosine - refracted) / (cosine + refracted), (eta * cosine - refracted) / (eta * cosine + refracted))
    reflection, transmission = [], []
    for face, conductor in zip(faces, (-1.0, 1.0), strict=True):
        echoes = 1 - face**2 * single_way**2
        reflection.append(np.where(perfect, conductor, face * (1 - single_way**2) / echoes))
        transmission.append(np.where(perfect, 0.0, (1 - face**2) * single_way / echoes))
    return (reflection[0], reflection[1]), (transmission[0], transmission[1])


def vertical_polarisation(direction: Any) -> FloatArray:
    """Unit vector (..., xyz) of the vertically polarised field of a wave along `direction` (..., xyz).

    It is the spherical theta vector: normal to the direction, in its vertical plane, pointing down. A wave in
    the vertical direction has azimuth 0.
    """
    k = np.asarray(direction, float)
    level = np.hypot(k[..., 0], k[..., 1])
    safe = np.where(level > 0, level, 1.0)
    cos_azimuth = np.where(level > 0, k[..., 0] / safe, 1.0)
    return np.stack([k[..., 2] * cos_azimuth, k[..., 2] * k[..., 1] / safe, -level], axis=-1)


def horizontal_polarisation(direction: Any) -> FloatArray:
    """Unit vector (..., xyz) of the horizontally polarised field of a wave along `direction` (..., xyz)."""
    return np.cross(np.asarray(direction, float), vertical_polarisation(direction))


def vertical_reflection(
    incident: Any, reflected: Any, normal: Any, reflection_s: Any, reflection_p: Any
) -> ComplexArray:
    """Gain (...) of one reflection between vertically polarised antennas.

    `incident` and `reflected` are the unit directions of travel (..., xyz) before and after, `normal` the unit
    normal of the surface on either side. The field has one part normal to the plane of incidence
    and one part in it. Each part is scaled by its coefficient; the sum is projected on the receive polarisation.
    """
    k_in, k_out = np.asarray(incident, float), np.asarray(reflected, float)
    s_vector = normal_to_plane_of_incidence(k_in, np.asarray(normal, float))
    p_in, p_out = np.cross(s_vector, k_in), np.cross(s_vector, k_out)
    sent, received = vertical_polarisation(k_in), vertical_polarisation(k_out)

    def part(basis_in: FloatArray, basis_out: FloatArray) -> FloatArray:
        return np.asarray((sent * basis_in).sum(axis=-1) * (received * basis_out).sum(axis=-1))

    return np.asarray(reflection_s * part(s_vector, s_vector) + reflection_p * part(p_in, p_out))


def normal_to_plane_of_incidence(incident: FloatArray, normal: FloatArray) -> FloatArray:
    """Unit s vector (..., xyz). At normal incidence it is an arbitrary vector along the surface."""
    across = np.cross(incident, normal)
    fallback = np.cross(normal, np.where(np.abs(normal[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    across = np.where(np.linalg.norm(across, axis=-1, keepdims=True) > 1e-9, across, fallback)
    return np.asarray(across / np.linalg.norm(across, axis=-1, keepdims=True))
