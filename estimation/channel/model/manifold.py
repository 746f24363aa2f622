"""The beam manifold: responses of a codebook's beams over direction, their derivatives, and their geometry.

Distances on the manifold are Fubini-Study: ds = |P g'| / |g| dangle, with P the projection orthogonal to the
response g. They measure how fast a normalised response changes, independent of scale and phase; a uniform aperture
moves by pi / sqrt(3) over one Rayleigh cell, along any axis.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Self

import numpy as np

from estimation.channel.model.panels import Panel, PanelStack, merged_at_horizon, panels_of
from scenes.pose import wrap_angle
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray
from sim.signal.arrays.codebook import Codebook

CELL = np.pi / np.sqrt(3)  # length on the manifold of one Rayleigh cell of a uniform aperture
SCAN_STEP_RAD = np.deg2rad(0.5)
HIGHEST_ELEVATION_RAD = np.deg2rad(75.0)
DARKEST = 10 ** (-30 / 20)  # least amplitude of the best beam, over the strongest beam, in a covered direction
REAL_TOLERANCE = 1e-8  # relative imaginary part that is a rounding error
NULL = 1e-16  # power of a response, relative to that of the weights, that is a rounding error
FLAT = 1e-6  # length on the manifold below which beams do not resolve directions
ELEVATION_SHARE = 0.03  # of the information of the bare elements, above which beams resolve elevation


class Manifold:
    """Responses G (direction, beam) of a codebook's beams and their derivatives over direction.

    If the beams do not resolve elevation (`n_angles` 1), the elevation is taken as zero, and the angle of a path
    of another elevation is the cone angle of its panel. `n_angles` can be given to keep the angles that a device's
    designed beams observe when its weights are replaced by estimated ones.

    Attributes
    ----------
    n_beams, n_angles : number of beams, and of angles (azimuth, or azimuth and elevation) they observe
    azimuth_range_rad, elevation_range_rad : directions the beams cover; `is_closed` if azimuths are a full circle
    hides_elevation : whether the model has elevations that only a second panel makes observable
    """

    n_beams: int
    n_angles: int
    azimuth_range_rad: tuple[float, float]
    elevation_range_rad: tuple[float, float]
    is_closed: bool
    hides_elevation: bool = False

    def __init__(self, codebook: Codebook, n_angles: int | None = None) -> None:
        self._set_panels(panels_of(codebook))
        self.n_beams = len(codebook)
        self.n_angles = 2
        self.elevation_range_rad = (0.0, 0.0)
        self._scan_azimuths()
        self.n_angles = n_angles or (2 if self._sees_elevation() else 1)
        if self.n_angles == 1:
            self._set_panels([merged_at_horizon(panel) for panel in self._panels])
        else:
            self._scan_elevations()

    def _set_panels(self, panels: list[Panel]) -> None:
        self._panels, self._stack = panels, PanelStack(panels)
        self._alone = [PanelStack([panel]) for panel in panels]

    def combined(self, matrix: ComplexArray | FloatArray) -> Self:
        """The manifold of linear combinations of beams: responses G @ matrix.T, for `matrix` (output, beam)."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        other._set_panels([replace(panel, weights=matrix @ panel.weights) for panel in self._panels])
        other.n_beams = len(matrix)
        return other

    def with_hidden_elevation(self) -> Self:
        """The manifold over azimuth and elevation for horizontal beams on several upright panels; else itself.

        One panel observes only the cone angle of a path about its boresight. Two panels observe two,
        and so the elevation up to its sign. Its effect on the rows, equal for all beams, is part of the gain.
        """
        several = len({panel.azimuth_rad for panel in self._panels}) > 1
        if self.n_angles == 2 or not several or any(panel.tilt_rad for panel in self._panels):
            return self
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        other.n_angles, other.hides_elevation = 2, True
        return other

    def best_panel_rad(self, angles: FloatArray) -> FloatArray:
        """Boresight azimuth (direction,) of the panel of the best beam towards `angles` (direction, angle)."""
        azimuth, elevation = self._split(angles)
        strongest = [np.abs(panel.response(azimuth, elevation)).max(axis=1, initial=0.0) for panel in self._alone]
        boresight = np.array([panel.azimuth_rad for panel in self._panels])
        return np.asarray(boresight[np.argmax(strongest, axis=0)])

    def is_behind(self, angles: FloatArray) -> BoolArray:
        """Whether `angles` (direction, angle) are behind all panels, (direction,)."""
        azimuth = self._split(angles)[0]
        return np.asarray(np.all([np.cos(azimuth - panel.azimuth_rad) < 0 for panel in self._panels], axis=0))

    def mirrored(self, angles: FloatArray) -> FloatArray:
        """Mirror images of `angles` (direction, angle) at the upright plane of their best panel.

        An array in this plane has the same phases there: only the patterns of its elements tell front from back.
        """
        mirror = np.asarray(angles, float).copy()
        mirror[:, 0] = wrap_angle(2 * self.best_panel_rad(angles) + np.pi - mirror[:, 0])
        return mirror

    def in_front(self, azimuth_rad: FloatArray) -> FloatArray:
        """Azimuths (direction,), those behind all panels replaced by their mirror images: what phases can tell."""
        angles = np.zeros((len(azimuth_rad), self.n_angles))
        angles[:, 0] = azimuth_rad
        return np.asarray(np.where(self.is_behind(angles), self.mirrored(angles)[:, 0], azimuth_rad))

    def weights(self) -> ComplexArray:
        """Weights (beam, element) of all panels side by side: their span holds every response."""
        return np.concatenate([panel.weights for panel in self._panels], axis=1)

    @property
    def is_real(self) -> bool:
        """Whether all responses are real up to rounding, as those of symmetric arrays are."""
        response = self.response(self.grid(1.0))
        return bool(np.abs(response.imag).max() <= REAL_TOLERANCE * np.abs(response).max())

    def response(self, angles: FloatArray) -> ComplexArray:
        """Responses (direction, beam) towards `angles` (direction, angle) in rad, in the device frame."""
        return self._stack.response(*self._split(angles))

    def element_power(self, angles: FloatArray) -> FloatArray:
        """Power (direction, beam) of the beams' elements towards `angles`, added without regard to phase."""
        azimuth, elevation = self._split(angles)
        power = np.zeros((len(azimuth), self.n_beams))
        for panel in self._panels:
            weights = np.square(np.abs(panel.error_weights)).sum(axis=1)
            power += np.square(panel.amplitude(azimuth, elevation))[:, None] * weights
        return power

    def element_covariance(self, angles: FloatArray, beam: IntArray) -> ComplexArray:
        """Covariance (beam, beam) of the responses of some beams in one direction (angle,), by errors of elements.

        Errors are relative, independent and of unit power.
        """
        azimuth, elevation = self._split(angles)
        total = np.zeros((len(beam), len(beam)), complex)
        for panel in self._panels:
            weights = panel.amplitude(azimuth, elevation)[0] * panel.error_weights[beam]
            total += weights @ weights.conj().T
        return total

    def element_noise(self, along: ComplexArray, angles: FloatArray) -> FloatArray:
        """Power (vector, direction) along `along` (vector, beam) of the errors of responses towards `angles`.

        Errors of the elements are relative, independent and of unit power: the quadratic form of the vectors with
        the covariance of `element_covariance`, of all beams.
        """
        azimuth, elevation = self._split(angles)
        power = np.zeros((len(along), len(azimuth)))
        for panel in self._panels:
            seen = np.square(np.abs(along.conj() @ panel.error_weights)).sum(axis=1)
            power += np.outer(seen, np.square(panel.amplitude(azimuth, elevation)))
        return power

    def tangents(self, angles: FloatArray) -> ComplexArray:
        """Responses and their derivatives per rad, (direction, 1 + angle, beam)."""
        return self._stack.tangents(*self._split(angles), self.n_angles)

    def metric(self, angles: FloatArray) -> FloatArray:
        """Fubini-Study metric (direction, angle, angle) in rad^-2; zero if there is no response."""
        tangents = self.tangents(angles)
        value, slopes = tangents[:, :1], tangents[:, 1:]
        power = (np.abs(value) ** 2).sum(axis=2, keepdims=True)
        power[power <= NULL * sum((np.abs(panel.weights) ** 2).sum() for panel in self._panels)] = np.inf
        along = (slopes * value.conj()).sum(axis=2, keepdims=True) / power
        across = slopes - along * value
        return np.asarray((across @ across.conj().swapaxes(1, 2)).real / power)

    def rates(self, angles: FloatArray) -> FloatArray:
        """Length on the manifold per rad (direction, angle), along each angle alone."""
        return np.asarray(np.sqrt(np.diagonal(self.metric(angles), axis1=1, axis2=2)))

    @lru_cache(maxsize=32)  # noqa: B019  manifolds are few and live long
    def grid(self, oversampling: float) -> FloatArray:
        """Directions (direction, angle) in rad that the beams cover, `oversampling` per Rayleigh cell.

        Points are evenly spaced on the manifold: along azimuth for one angle; for two on circles of elevation.
        Directions that no beam covers (nulls of a single beam) are left out. Beams that do not resolve directions
        have one point, at their strongest direction.
        """
        step = CELL / oversampling
        levels = self._levels(step) if self.n_angles == 2 else np.zeros(1)
        grid = np.concatenate([self._row(np.array([level]), step) for level in levels])[:, : self.n_angles]
        gain = np.linalg.norm(self.response(grid), axis=1)
        return np.asarray(grid[gain >= DARKEST * gain.max()])

    def azimuths(self) -> FloatArray:
        """Fine, even azimuths (azimuth,) that the beams cover; a closed circle without its end."""
        low, high = self.azimuth_range_rad
        n = max(2, round((high - low) / SCAN_STEP_RAD) + 1)
        return np.linspace(low, high, n - self.is_closed, endpoint=not self.is_closed)

    def elevations(self) -> FloatArray:
        """Fine, even elevations (elevation,) that the beams cover; only zero for one angle."""
        low, high = self.elevation_range_rad
        return np.linspace(low, high, max(2, round((high - low) / (4 * SCAN_STEP_RAD)) + 1))

    def _split(self, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
        angles = np.asarray(angles, float).reshape(-1, self.n_angles)
        return angles[:, 0], angles[:, 1] if self.n_angles == 2 else np.zeros(len(angles))

    def _row(self, elevation_rad: FloatArray, step: float) -> FloatArray:
        """Directions (direction, 2) at one elevation, evenly spaced on the manifold by at most `step`."""
        azimuth = self.azimuths()
        angles = np.stack([azimuth, np.broadcast_to(elevation_rad, azimuth.shape)], axis=1)[:, : self.n_angles]
        speed = self.rates(angles)[:, 0]
        strongest = azimuth[int(np.argmax(np.linalg.norm(self.response(angles), axis=1)))]
        if self.is_closed:
            azimuth, speed = np.append(azimuth, azimuth[0] + 2 * np.pi), np.append(speed, speed[0])
        even = _evenly(azimuth, speed, step, strongest, is_closed=self.is_closed)
        return np.stack([wrap_angle(even), np.broadcast_to(elevation_rad, even.shape)], axis=1)

    def _levels(self, step: float) -> FloatArray:
        """Elevations (level,) at most `step` apart on the manifold at any azimuth."""
        elevation, azimuth = self.elevations(), self.azimuths()[::4]
        speed = [self.rates(np.stack([azimuth, np.full(len(azimuth), e)], axis=1))[:, 1].max() for e in elevation]
        return _evenly(elevation, np.array(speed), step, float(elevation.mean()), is_closed=False)

    def _scan_azimuths(self) -> None:
        """Set the azimuths in front of a panel that its beams cover; all gaps except the widest are bridged."""
        azimuth = np.arange(-np.pi, np.pi - SCAN_STEP_RAD / 2, SCAN_STEP_RAD)
        gain = np.max([self._best_gain(azimuth, e) for e in np.linspace(-0.6, 0.6, 7)], axis=0)
        in_front = np.any([np.cos(azimuth - panel.azimuth_rad) > 0 for panel in self._panels], axis=0)
        seen = np.flatnonzero(in_front & (gain >= DARKEST * gain[in_front].max()))
        gaps = np.diff(seen, append=seen[0] + len(azimuth))
        widest = int(np.argmax(gaps))
        self.is_closed = bool(gaps[widest] == 1)
        first = seen[(widest + 1) % len(seen)]
        length_rad = (len(azimuth) - (0 if self.is_closed else gaps[widest])) * SCAN_STEP_RAD
        self.azimuth_range_rad = (float(azimuth[first]), float(azimuth[first] + length_rad))

    def _scan_elevations(self) -> None:
        """Set the elevations around the beams' own that some beam covers at some azimuth."""
        elevation = np.arange(-HIGHEST_ELEVATION_RAD, HIGHEST_ELEVATION_RAD + 1e-9, SCAN_STEP_RAD)
        azimuth = self.azimuths()[::4]
        gain = np.array([self._best_gain(azimuth, e).max() for e in elevation])
        seen = elevation[gain >= DARKEST * gain.max()]
        self.elevation_range_rad = (float(seen[0]), float(seen[-1]))

    def _best_gain(self, azimuth_rad: FloatArray, elevation_rad: float) -> FloatArray:
        angles = np.stack([azimuth_rad, np.full(len(azimuth_rad), elevation_rad)], axis=1)
        return np.asarray(np.abs(self.response(angles)).max(axis=1))

    def _sees_elevation(self) -> bool:
        """Whether elevation changes the beams, up to scale and phase, in a way that azimuth does not.

        Compared with elements that are sampled one by one: the variance of their phase slope.
        """
        azimuth = self.azimuths()
        angles = np.stack([azimuth, np.zeros(len(azimuth))], axis=1)
        metric = self.metric(angles)
        across = np.maximum(metric[:, 0, 0], np.finfo(float).tiny)
        share = metric[:, 1, 1] - metric[:, 0, 1] ** 2 / across
        bare = max(float(panel.wave_vector[:, 2].var()) for panel in self._panels)
        return bool(bare > 0 and np.median(share) > ELEVATION_SHARE * bare)


def _evenly(position: FloatArray, speed: FloatArray, step: float, middle: float, *, is_closed: bool) -> FloatArray:
    """Positions along a curve of this `speed`, evenly spaced by at most `step`.

    An open curve has its outermost points half a step inside its ends; a curve of zero length has only its
    `middle`.
    """
    length = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(position))])
    n = max(1, int(np.ceil(length[-1] / step)))
    if length[-1] < FLAT:
        return np.array([middle])
    fractions = (np.arange(n) + (0.0 if is_closed else 0.5)) / n
    return np.asarray(np.interp(fractions * length[-1], length, position))
