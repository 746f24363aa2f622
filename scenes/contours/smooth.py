"""Smooth contours: circle, ellipse, closed spline, and the open thin wall along a spline."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from scenes.contours.base import Contour, check_distinct, check_not_crossing
from scenes.contours.pieces import ArcPiece, EllipsePiece, Piece, SplinePiece
from scenes.record import FloatArray, array


@dataclass(frozen=True)
class Circle(Contour):
    """A circle; distance, area and radial function in closed form."""

    center_m: FloatArray = array("xy", unit="m", doc="centre")
    radius_m: float = array(unit="m", doc="radius")
    closed = True

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_center(self.center_m)
        if not (np.isfinite(self.radius_m) and self.radius_m > 0):
            raise ValueError(f"radius_m = {self.radius_m}: must be > 0")

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """One arc over the whole circle, from the angle 0 on."""
        return (ArcPiece(self.center_m, self.radius_m, 0.0, 2 * np.pi),)

    def area_m2(self) -> float:
        """Pi r^2."""
        return float(np.pi * self.radius_m**2)

    def signed_distance(self, points_m: Any) -> FloatArray:
        """|p - centre| - radius (...) in m of points (..., xy)."""
        return np.asarray(np.linalg.norm(np.asarray(points_m, float) - self.center_m, axis=-1) - self.radius_m)

    def radius(self, center_m: Any, angle_rad: Any) -> FloatArray:
        """Far root of |centre + rho u - circle centre| = radius (...) in m; NaN where the ray misses."""
        angle = np.asarray(angle_rad, float)
        offset = np.asarray(center_m, float) - self.center_m
        along = np.cos(angle) * offset[0] + np.sin(angle) * offset[1]
        square = along**2 - offset @ offset + self.radius_m**2
        distance = -along + np.sqrt(np.maximum(square, 0))
        return np.where((square >= 0) & (distance >= 0), distance, np.nan)


@dataclass(frozen=True)
class Ellipse(Contour):
    """An ellipse; area and radial function in closed form."""

    center_m: FloatArray = array("xy", unit="m", doc="centre")
    semi_axes_m: FloatArray = array("semi_axis", unit="m", doc="first and second semi-axis")
    rotation_rad: float = array(unit="rad", doc="azimuth of the first semi-axis")
    closed = True

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_center(self.center_m)
        if self.semi_axes_m.shape != (2,) or not np.all((self.semi_axes_m > 0) & np.isfinite(self.semi_axes_m)):
            raise ValueError(f"semi_axes_m = {self.semi_axes_m.tolist()}: must be two lengths > 0")
        if not np.isfinite(self.rotation_rad):
            raise ValueError(f"rotation_rad = {self.rotation_rad}: must be finite")

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """One piece all round."""
        return (EllipsePiece(self.center_m, self.semi_axes_m, self.rotation_rad),)

    def area_m2(self) -> float:
        """Pi a b."""
        return float(np.pi * self.semi_axes_m.prod())

    def radius(self, center_m: Any, angle_rad: Any) -> FloatArray:
        """Far root (...) in m of the quadratic of the ray, with the ellipse as the unit circle; NaN for a miss."""
        angle = np.asarray(angle_rad, float)
        c, s = np.cos(self.rotation_rad), np.sin(self.rotation_rad)
        to_unit_circle = np.array([(c, s), (-s, c)]) / self.semi_axes_m[:, None]
        offset = to_unit_circle @ (np.asarray(center_m, float) - self.center_m)
        along = np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ to_unit_circle.T
        a, half_b = (along * along).sum(axis=-1), along @ offset
        root = half_b**2 - a * (offset @ offset - 1)
        distance = (-half_b + np.sqrt(np.maximum(root, 0))) / a
        return np.where((root >= 0) & (distance >= 0), distance, np.nan)


@dataclass(frozen=True)
class ClosedSpline(Contour):
    """A smooth solid: periodic cubic spline in chord length. Clockwise points are put in reverse order."""

    points_m: FloatArray = array("vertex", "xy", unit="m", doc="points passed, the first one not repeated")
    closed = True

    def __post_init__(self) -> None:
        super().__post_init__()
        check_distinct("points_m", self.points_m, 3)
        if np.linalg.norm(self.points_m[0] - self.points_m[-1]) < 1e-9:
            raise ValueError(f"points_m[{len(self.points_m) - 1}] repeats the first point: leave it out")
        check_not_crossing("points_m", self)
        if self.area_m2() < 0:
            object.__setattr__(self, "points_m", self.points_m[::-1])
            for name in ("pieces", "outline"):  # computed from the points in their first order
                vars(self).pop(name, None)

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """One periodic spline."""
        return (SplinePiece(np.vstack([self.points_m, self.points_m[:1]]), is_periodic=True),)


@dataclass(frozen=True)
class OpenSpline(Contour):
    """An open thin curved wall: interpolating cubic spline in chord length."""

    points_m: FloatArray = array("vertex", "xy", unit="m", doc="points passed from one end to the other")
    closed = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check_distinct("points_m", self.points_m, 3)
        check_not_crossing("points_m", self)

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """One spline."""
        return (SplinePiece(self.points_m),)


def _check_center(center_m: FloatArray) -> None:
    if not np.all(np.isfinite(center_m)):
        raise ValueError(f"center_m = {center_m.tolist()}: must be finite")
