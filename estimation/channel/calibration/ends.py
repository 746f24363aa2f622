"""The two ends of a link as sums of their elements, and the factors that no path shows."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from estimation.channel.coherent.plan import nominal_manifold
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import ComplexArray, FloatArray, IntArray
from sim.signal.arrays.array import element_amplitude, steering_vector, to_panel, vertical_polarisation
from sim.signal.arrays.codebook import Codebook

DIFFERENCE_RAD = 1e-5  # between angles, for slopes of responses
SAME_PLACE = 0.02  # of a wavelength, up to which displacements are equal


@dataclass(frozen=True)
class End:
    """What one device adds to the paths in their directions, as built.

    Attributes
    ----------
    matrix : (path, beam, factor) slopes of the response over the factors of the device
    response : (path, beam)
    slopes : (angle, path, beam) of the response, per rad
    """

    matrix: ComplexArray
    response: ComplexArray
    slopes: ComplexArray

    @classmethod
    def towards(cls, codebook: Codebook, factors: ComplexArray, angles: FloatArray) -> Self:
        """The end with its factors, as `designed_factors` orders them, towards `angles` (path, angle)."""
        element, coupling = np.split(factors, [codebook.size("element")])
        pairs = coupled_pairs(codebook)[: len(coupling)]
        mixed = np.eye(len(element)) + np.tensordot(coupling, pairs, axes=1)

        def elements(towards: FloatArray, of: ComplexArray | FloatArray) -> ComplexArray:
            return element_matrix(codebook, *azimuth_elevation(towards), of)

        matrix = elements(angles, mixed)
        by_coupling = [(elements(angles, one) @ element)[:, :, None] for one in pairs]
        steps = DIFFERENCE_RAD * np.eye(angles.shape[1])
        slopes = [(elements(angles + s, mixed) - elements(angles - s, mixed)) @ element for s in steps]
        return cls(
            matrix=np.concatenate([matrix, *by_coupling], axis=2),
            response=matrix @ element,
            slopes=np.stack(slopes) / (2 * DIFFERENCE_RAD),
        )


def designed_factors(codebook: Codebook) -> ComplexArray:
    """Factors of a device as designed: 1 for every element, then 0 for every kind of coupling."""
    return np.append(np.ones(codebook.size("element"), complex), np.zeros(len(coupled_pairs(codebook))))


def as_built(codebook: Codebook, factors: ComplexArray) -> Codebook:
    """The codebook of a device with these factors in its weights."""
    element, coupling = np.split(factors, [codebook.size("element")])
    pairs = coupled_pairs(codebook)[: len(coupling)]
    weights = codebook.weights * element
    return replace(codebook, weights=weights + weights @ np.tensordot(coupling, pairs, axes=1))


def coupled_pairs(codebook: Codebook) -> FloatArray:
    """Masks (kind, element, element) of the pairs of elements that couple alike.

    Coupling depends on the displacement alone, up to its sign, as in an array without edges. Beams that do not
    resolve elevation see the sums of columns: only coupling along the rows shows there.
    """
    apart, kinds = _displacements(codebook)
    return np.array([(apart == kind).all(axis=2) for kind in kinds], float).reshape(len(kinds), *apart.shape[:2])


def coupling_levels(codebook: Codebook) -> FloatArray:
    """Coupling (kind,) of every kind of `coupled_pairs` over that of neighbours half a wavelength apart.

    It falls as a wave does, in proportion to the distance (Balanis, Antenna Theory, section 8.7). Where beams see
    columns, the coupling of all their elements adds up.
    """
    apart, kinds = _displacements(codebook)
    distance = np.linalg.norm(apart * SAME_PLACE, axis=2)
    level = np.divide(0.5, distance, out=np.zeros(distance.shape), where=distance > 0)
    seen = slice(2) if nominal_manifold(codebook).n_angles == 1 else slice(3)
    alike = [(apart[..., seen] == kind[seen]).all(axis=2) for kind in kinds]
    return np.asarray([level[pairs].sum() for pairs in alike] / coupled_pairs(codebook).sum(axis=(1, 2)))


def _displacements(codebook: Codebook) -> tuple[IntArray, IntArray]:
    """Displacements (element, element, xyz) without sign, in steps of `SAME_PLACE`; their kinds (kind, xyz)."""
    wavelength_m = SPEED_OF_LIGHT_M_S / codebook.carrier_hz
    position = codebook.element_position_m / wavelength_m
    apart = np.round(np.abs(position[:, None] - position) / SAME_PLACE).astype(int)
    couples = apart.any(axis=2)
    if nominal_manifold(codebook).n_angles == 1:
        couples &= apart[..., 2] == 0
    return apart, np.unique(apart[couples], axis=0)


def element_matrix(
    codebook: Codebook,
    azimuth_rad: FloatArray,
    elevation_rad: FloatArray,
    coupling: ComplexArray | FloatArray | None = None,
) -> ComplexArray:
    """What every element adds to every beam (direction, beam, element) towards directions in the device frame.

    `coupling` (element, element) says what each element has of the wave at every other; by default only its own.
    """
    matrix = np.empty((len(azimuth_rad), *codebook.weights.shape), complex)
    panels = np.stack([codebook.panel_azimuth_rad, codebook.panel_tilt_rad], axis=1)
    slant = codebook.polarisation_slant_rad
    for panel, tilt in np.unique(panels, axis=0):
        beams = np.flatnonzero((panels == (panel, tilt)).all(axis=1))
        local = to_panel(azimuth_rad, elevation_rad, panel, tilt)
        gain = element_amplitude(codebook.element_pattern, *local)
        if slant or tilt:
            gain = gain * vertical_polarisation(azimuth_rad, elevation_rad, panel, tilt, slant)
        wave = steering_vector(codebook.element_position_m, codebook.carrier_hz, *local) * gain[:, None]
        matrix[:, beams] = codebook.weights[beams] * (wave if coupling is None else wave @ coupling)[:, None]
    return matrix


def azimuth_elevation(angles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Azimuth and elevation (direction,) of `angles` (direction, angle): horizontal where there is one angle."""
    return angles[:, 0], angles[:, 1] if angles.shape[1] == 2 else np.zeros(len(angles))


def with_responses(codebook: Codebook, element: ComplexArray, beam: ComplexArray) -> Codebook:
    """The codebook with its elements (element,) and beams (beam,) multiplied by these factors."""
    return replace(codebook, weights=codebook.weights * element * beam[:, None])


def without_gauge(codebook: Codebook, factors: ComplexArray) -> ComplexArray:
    """Factors without what is unobservable: a common complex factor and a linear phase of the elements.

    The phase slope is fitted by weighted least squares, so errors of less than pi cause no ambiguity of 2 pi.
    """
    element, coupling = np.split(factors, [codebook.size("element")])
    position = codebook.element_position_m[:, 1:]
    position = position - position.mean(axis=0)
    base = np.column_stack([np.ones(len(element)), position])
    weight = np.abs(element)
    turned = element * np.exp(-1j * np.angle(element.sum()))
    slope, *_ = np.linalg.lstsq(base * weight[:, None], np.angle(turned) * weight, rcond=None)
    turned = turned * np.exp(-1j * base @ slope)
    return np.append(turned / np.sqrt(np.mean(np.abs(turned) ** 2)), coupling)
