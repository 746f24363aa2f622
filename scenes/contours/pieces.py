"""Smooth pieces of a contour: straight lines, circular arcs, ellipses and interpolating splines.

A piece is a curve c(t), t in [0, 1], with its first two derivatives. A closed contour runs counter-clockwise, so
the outward normal points to the right of c'(t), and the signed curvature is positive where the contour is convex
as seen from outside.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from scenes.record import FloatArray, Record, array

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

N_LENGTH_SAMPLES = 64  # arc-length table entries per interval between breaks
N_ELLIPSE_INTERVALS = 16


@dataclass(frozen=True)
class Piece(Record):
    """One smooth curve c(t) in the plane, t in [0, 1]. Normals and curvature follow from its derivatives."""

    is_curved: ClassVar[bool]

    @abstractmethod
    def point(self, t: Any) -> FloatArray:
        """Points c(t) (..., xy) in m."""

    @abstractmethod
    def derivative(self, t: Any) -> FloatArray:
        """Tangents c'(t) (..., xy) in m, not normalised."""

    @abstractmethod
    def second_derivative(self, t: Any) -> FloatArray:
        """c''(t) (..., xy) in m."""

    @property
    def breaks(self) -> FloatArray:
        """Parameters t from 0 to 1 between which the piece is analytic and turns by a small angle."""
        return np.array([0.0, 1.0])

    @property
    def length(self) -> float:
        """Arc length in m."""
        return float(self._arc_length_table[1][-1])

    def equidistant(self, n_segments: int) -> FloatArray:
        """Parameters t (n_segments + 1,) that cut the piece into parts of equal arc length."""
        t, length = self._arc_length_table
        return np.interp(np.linspace(0, length[-1], n_segments + 1), length, t)

    @cached_property
    def _arc_length_table(self) -> tuple[FloatArray, FloatArray]:
        """Parameters t and the arc length from c(0) up to them, by Gauss-Legendre quadrature per interval."""
        fine = [np.linspace(a, b, N_LENGTH_SAMPLES + 1) for a, b in pairwise(self.breaks)]
        t = np.unique(np.concatenate(fine))
        inside, weight = _gauss(t, 5)
        part = (np.linalg.norm(self.derivative(inside), axis=-1) * weight).sum(axis=1)
        return t, np.concatenate([[0.0], np.cumsum(part)])

    def swept_area_m2(self) -> float:
        """Half the integral of x dy - y dx over the piece: its contribution to the area of a closed contour."""
        t, weight = _gauss(self.breaks, 12)
        point, slope = self.point(t), self.derivative(t)
        cross = point[..., 0] * slope[..., 1] - point[..., 1] * slope[..., 0]
        return float((cross * weight).sum() / 2)

    def curvature(self, t: Any) -> FloatArray:
        """Signed curvature (...) in 1/m: (x' y'' - y' x'') / |c'|^3, positive where the piece turns left."""
        first, second = self.derivative(t), self.second_derivative(t)
        cross = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
        return np.asarray(cross / np.linalg.norm(first, axis=-1) ** 3)

    def outward_normal(self, t: Any) -> FloatArray:
        """Unit normals (..., xy) to the right of c'(t)."""
        first = self.derivative(t)
        right = np.stack([first[..., 1], -first[..., 0]], axis=-1)
        return np.asarray(right / np.linalg.norm(first, axis=-1, keepdims=True))

    def n_chords(self, max_sagitta_m: float, max_turn_rad: float) -> int:
        """Number of chords, equal in t, needed to stay within the sagitta and the turn between neighbours.

        A chord over a step h in t lies within h^2 max|c''| / 8 of the curve.
        """
        t = np.linspace(0, 1, 257)
        speed = np.linalg.norm(self.derivative(t), axis=-1)
        bend = np.linalg.norm(self.second_derivative(t), axis=-1).max()
        turn = float((np.abs(self.curvature(t)) * speed).max())
        by_sagitta = np.ceil(np.sqrt(bend / (8 * max_sagitta_m)) - 1e-9)
        return int(max(1, by_sagitta, np.ceil(turn / max_turn_rad - 1e-9)))


@dataclass(frozen=True)
class LinePiece(Piece):
    """A straight piece from start to end."""

    start_m: FloatArray = array("xy", unit="m", doc="c(0)")
    end_m: FloatArray = array("xy", unit="m", doc="c(1)")
    is_curved = False

    def point(self, t: Any) -> FloatArray:
        """Points c(t) (..., xy) in m."""
        return np.asarray(self.start_m + np.asarray(t, float)[..., None] * (self.end_m - self.start_m))

    def derivative(self, t: Any) -> FloatArray:
        """Constant c'(t) = end - start (..., xy) in m."""
        return np.broadcast_to(self.end_m - self.start_m, (*np.shape(t), 2))

    def second_derivative(self, t: Any) -> FloatArray:
        """Zero (..., xy)."""
        return np.zeros((*np.shape(t), 2))

    @property
    def length(self) -> float:
        """Arc length in m."""
        return float(np.linalg.norm(self.end_m - self.start_m))

    def equidistant(self, n_segments: int) -> FloatArray:
        """Parameters t (n_segments + 1,) of equal arc length."""
        return np.linspace(0, 1, n_segments + 1)


@dataclass(frozen=True)
class ArcPiece(Piece):
    """A circular arc; a negative sweep runs clockwise, a sweep of 2 pi is the whole circle."""

    center_m: FloatArray = array("xy", unit="m", doc="centre of the circle")
    radius_m: float = array(unit="m", doc="radius, > 0")
    start_rad: float = array(unit="rad", doc="polar angle of c(0) about the centre")
    sweep_rad: float = array(unit="rad", doc="polar angle from c(0) to c(1)")
    is_curved = True

    @property
    def breaks(self) -> FloatArray:
        """One interval per eighth of a turn."""
        return np.linspace(0, 1, int(np.ceil(abs(self.sweep_rad) / (np.pi / 4) - 1e-9)) + 1)

    def _angle(self, t: Any) -> FloatArray:
        return np.asarray(self.start_rad + self.sweep_rad * np.asarray(t, float))

    def point(self, t: Any) -> FloatArray:
        """Points c(t) (..., xy) in m."""
        angle = self._angle(t)
        return np.asarray(self.center_m + self.radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1))

    def derivative(self, t: Any) -> FloatArray:
        """Tangents c'(t) (..., xy) in m, of constant length radius x |sweep|."""
        angle = self._angle(t)
        scale = self.radius_m * self.sweep_rad
        return np.asarray(scale * np.stack([-np.sin(angle), np.cos(angle)], axis=-1))

    def second_derivative(self, t: Any) -> FloatArray:
        """c''(t) (..., xy) in m, towards the centre."""
        angle = self._angle(t)
        scale = -self.radius_m * self.sweep_rad**2
        return np.asarray(scale * np.stack([np.cos(angle), np.sin(angle)], axis=-1))

    @property
    def length(self) -> float:
        """Arc length in m."""
        return self.radius_m * abs(self.sweep_rad)

    def equidistant(self, n_segments: int) -> FloatArray:
        """Parameters t (n_segments + 1,) of equal arc length."""
        return np.linspace(0, 1, n_segments + 1)


@dataclass(frozen=True)
class EllipsePiece(Piece):
    """A whole ellipse, counter-clockwise from the tip of its first semi-axis."""

    center_m: FloatArray = array("xy", unit="m", doc="centre")
    semi_axes_m: FloatArray = array("semi_axis", unit="m", doc="first and second semi-axis, > 0")
    rotation_rad: float = array(unit="rad", doc="azimuth of the first semi-axis")
    is_curved = True

    @cached_property
    def axes_m(self) -> FloatArray:
        """Semi-axes u and v as vectors (2, xy) in m: c(t) = centre + u cos(2 pi t) + v sin(2 pi t)."""
        c, s = np.cos(self.rotation_rad), np.sin(self.rotation_rad)
        return np.asarray(self.semi_axes_m[:, None] * np.array([(c, s), (-s, c)]))

    def _of_phase(self, t: Any, quarter_turns: int) -> FloatArray:
        """Vectors u cos(p) + v sin(p) (..., xy) in m at p = 2 pi t + q pi/2."""
        phase = 2 * np.pi * np.asarray(t, float)[..., None] + quarter_turns * np.pi / 2
        u, v = self.axes_m
        return np.asarray(u * np.cos(phase) + v * np.sin(phase))

    @property
    def breaks(self) -> FloatArray:
        """Equal intervals."""
        return np.linspace(0, 1, N_ELLIPSE_INTERVALS + 1)

    def point(self, t: Any) -> FloatArray:
        """Points c(t) (..., xy) in m."""
        return np.asarray(self.center_m + self._of_phase(t, 0))

    def derivative(self, t: Any) -> FloatArray:
        """Tangents c'(t) (..., xy) in m."""
        return 2 * np.pi * self._of_phase(t, 1)

    def second_derivative(self, t: Any) -> FloatArray:
        """c''(t) (..., xy) in m, towards the centre."""
        return (2 * np.pi) ** 2 * self._of_phase(t, 2)


@dataclass(frozen=True)
class SplinePiece(Piece):
    """Interpolating cubic spline through points, its parameter proportional to the chord length between them.

    Two points give a straight line, three a parabola, more the spline with not-a-knot ends. A periodic one ends
    where it starts, with the same slope and curvature there.
    """

    points_m: FloatArray = array("knot", "xy", unit="m", doc="points passed, at least two, neighbours distinct")
    is_periodic: bool = False
    is_curved = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.points_m) < 2 or not np.all(np.isfinite(self.points_m)):
            raise ValueError(f"points_m has {len(self.points_m)} point(s): at least 2 finite ones are needed")
        step = np.linalg.norm(np.diff(self.points_m, axis=0), axis=1)
        if step.min() < 1e-9:
            raise ValueError(f"points_m[{step.argmin() + 1}] repeats the point before: all must differ")
        if self.is_periodic and np.any(self.points_m[0] != self.points_m[-1]):
            raise ValueError(f"points_m[-1] = {self.points_m[-1].tolist()}: must repeat the first point")

    @cached_property
    def _curve(self) -> CubicSpline:
        from scipy.interpolate import CubicSpline  # noqa: PLC0415  (slow to import)

        if self.is_periodic:
            return CubicSpline(self.breaks, self.points_m, bc_type="periodic")
        return CubicSpline(self.breaks, self.points_m)

    @property
    def breaks(self) -> FloatArray:
        """Parameter t of each knot; the piece is one cubic between two of them."""
        chord = np.linalg.norm(np.diff(self.points_m, axis=0), axis=1)
        return np.asarray(np.concatenate([[0.0], np.cumsum(chord)]) / chord.sum())

    def point(self, t: Any) -> FloatArray:
        """Points c(t) (..., xy) in m."""
        return np.asarray(self._curve(np.asarray(t, float)))

    def derivative(self, t: Any) -> FloatArray:
        """Tangents c'(t) (..., xy) in m."""
        return np.asarray(self._curve(np.asarray(t, float), 1))

    def second_derivative(self, t: Any) -> FloatArray:
        """c''(t) (..., xy) in m."""
        return np.asarray(self._curve(np.asarray(t, float), 2))


def _gauss(breaks: FloatArray, n_nodes: int) -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre nodes and weights, each (interval, node), for the integral over every interval."""
    node, weight = np.polynomial.legendre.leggauss(n_nodes)
    half = np.diff(breaks)[:, None] / 2
    return breaks[:-1, None] + half * (1 + node), half * weight
