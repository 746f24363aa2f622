"""The panels of a codebook: responses of their beams over direction, and the derivatives."""

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.model.kernels import element_tangents, unit_vectors
from scenes.pose import SPEED_OF_LIGHT_M_S, direction
from scenes.record import ComplexArray, FloatArray, IntArray
from sim.signal.arrays.array import element_amplitude, panel_axes, to_panel, vertical_polarisation
from sim.signal.arrays.codebook import Codebook

DIFFERENCE_STEP_RAD = 1e-5  # for the element amplitude, which is real and smooth: the error is below 1e-9


@dataclass(frozen=True)
class Panel:
    """One panel: the weights of its beams, and the phase of every element per unit direction (device frame)."""

    weights: ComplexArray  # (beam, element), rows of zeros for the beams of other panels
    wave_vector: FloatArray  # (element, xyz): phase in rad = wave_vector @ u
    azimuth_rad: float
    tilt_rad: float
    pattern: str
    slant_rad: float
    n_summed: IntArray  # (element,) elements of the array whose weights are summed in one

    @property
    def error_weights(self) -> ComplexArray:
        """Weights (beam, element) by which independent relative errors of elements enter a response."""
        return self.weights / np.sqrt(self.n_summed)

    def amplitude(self, azimuth_rad: FloatArray, elevation_rad: FloatArray) -> FloatArray:
        """Element amplitude (direction,) in vertical polarisation."""
        amplitude = element_amplitude(
            self.pattern, *to_panel(azimuth_rad, elevation_rad, self.azimuth_rad, self.tilt_rad)
        )
        if self.slant_rad or self.tilt_rad:
            amplitude = amplitude * vertical_polarisation(
                azimuth_rad, elevation_rad, self.azimuth_rad, self.tilt_rad, self.slant_rad
            )
        return np.asarray(amplitude)


class PanelStack:
    """The elements of all panels side by side: a response is one product of matrices.

    Attributes
    ----------
    weights : (element, beam); wave_vector : (element, xyz); panel : (element,) panel of every element
    """

    def __init__(self, panels: list[Panel]) -> None:
        self._panels = panels
        self.weights = np.ascontiguousarray(np.concatenate([panel.weights.T for panel in panels]), complex)
        self.wave_vector = np.concatenate([panel.wave_vector for panel in panels])
        self.panel = np.repeat(np.arange(len(panels)), [len(panel.wave_vector) for panel in panels])

    def amplitudes(self, azimuth_rad: FloatArray, elevation_rad: FloatArray) -> FloatArray:
        """Element amplitude (panel, ...) in vertical polarisation towards directions (...)."""
        first = self._panels[0]
        if not any(panel.tilt_rad or panel.slant_rad for panel in self._panels):
            boresight = np.array([panel.azimuth_rad for panel in self._panels])
            from_boresight = azimuth_rad - boresight.reshape(-1, *(1,) * azimuth_rad.ndim)
            return element_amplitude(first.pattern, from_boresight, elevation_rad)
        return np.stack([panel.amplitude(azimuth_rad, elevation_rad) for panel in self._panels])

    def response(self, azimuth_rad: FloatArray, elevation_rad: FloatArray) -> ComplexArray:
        """Responses (direction, beam) of the beams."""
        wave = _phasor(direction(azimuth_rad, elevation_rad) @ self.wave_vector.T)
        wave *= self.amplitudes(azimuth_rad, elevation_rad)[self.panel].T
        return np.asarray(wave @ self.weights)

    def tangents(self, azimuth_rad: FloatArray, elevation_rad: FloatArray, n_angles: int) -> ComplexArray:
        """Responses and their derivatives per rad, (direction, 1 + angle, beam).

        The derivatives of the element amplitude are central differences.
        """
        step = DIFFERENCE_STEP_RAD * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])[: 1 + 2 * n_angles]
        values = self.amplitudes(azimuth_rad + step[:, :1], elevation_rad + step[:, 1:])
        slopes = (values[:, 1::2] - values[:, 2::2]) / (2 * DIFFERENCE_STEP_RAD)
        waves = element_tangents(
            unit_vectors(azimuth_rad, elevation_rad), values[:, 0], slopes, self.wave_vector, self.panel
        )
        return np.asarray(
            (waves.reshape(-1, len(self.weights)) @ self.weights).reshape(*waves.shape[:2], self.weights.shape[1])
        )


def panels_of(codebook: Codebook) -> list[Panel]:
    """The panels of a codebook; each has all beams, zero where they are another panel's."""
    wave_vector = 2 * np.pi * codebook.carrier_hz / SPEED_OF_LIGHT_M_S * codebook.element_position_m
    boresights = np.stack([codebook.panel_azimuth_rad, codebook.panel_tilt_rad], axis=1)
    panels = []
    for azimuth, tilt in np.unique(boresights, axis=0):
        beams = (boresights == (azimuth, tilt)).all(axis=1)
        panels.append(
            Panel(
                weights=np.where(beams[:, None], codebook.weights, 0.0),
                wave_vector=wave_vector @ panel_axes(azimuth, tilt),
                azimuth_rad=float(azimuth),
                tilt_rad=float(tilt),
                pattern=codebook.element_pattern,
                slant_rad=codebook.polarisation_slant_rad,
                n_summed=np.ones(codebook.weights.shape[1], int),
            )
        )
    return panels


def merged_at_horizon(panel: Panel) -> Panel:
    """The panel with elements that have equal phases in all horizontal directions summed into one."""
    horizontal = np.round(panel.wave_vector[:, :2], 12)
    places, index = np.unique(horizontal, axis=0, return_inverse=True)
    summed = np.zeros((len(panel.weights), len(places)), complex)
    np.add.at(summed.T, index, panel.weights.T)
    n_summed = np.bincount(index.ravel(), weights=panel.n_summed).astype(int)
    return replace(panel, weights=summed, wave_vector=np.pad(places, ((0, 0), (0, 1))), n_summed=n_summed)


def _phasor(phase_rad: FloatArray) -> ComplexArray:
    phasor = np.empty(phase_rad.shape, complex)
    np.cos(phase_rad, out=phasor.real)
    np.sin(phase_rad, out=phasor.imag)
    return phasor
