"""Base class of contours: polygons, distances, area, curvature and the radial function."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import shapely

from scenes.contours.pieces import Piece
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray, Record

BODY_SAGITTA_M = 5e-4
SAME_ANGLE_RAD = 1e-12  # a ray through the end of two chords must cross one of them in spite of rounding
OUTLINE_SAGITTA_M = 1e-6  # of the polygon that replaces the contour in distance and area computations


@dataclass(frozen=True)
class Contour(Record):
    """Boundary of a vertical prism. Distances to curved contours are accurate to 1e-6 m."""

    closed: ClassVar[bool]

    @property
    @abstractmethod
    def pieces(self) -> tuple[Piece, ...]:
        """The smooth pieces in order; counter-clockwise if the contour is closed."""

    def vertices(self, max_sagitta_m: float, max_turn_rad: float = np.pi / 4) -> FloatArray:
        """Polygon (vertex, xy) inscribed in the contour; a closed polygon does not repeat its first vertex.

        Each chord of a curved piece stays within `max_sagitta_m` of the curve, and the angle between neighbouring
        chords is at most `max_turn_rad`.
        """
        if not max_sagitta_m > 0:
            raise ValueError(f"max_sagitta_m = {max_sagitta_m}: must be > 0")
        steps = [np.linspace(0, 1, piece.n_chords(max_sagitta_m, max_turn_rad) + 1) for piece in self.pieces]
        parts = [piece.point(t[:-1]) for piece, t in zip(self.pieces, steps, strict=True)]
        if not self.closed:
            parts.append(self.pieces[-1].point(np.ones(1)))
        return np.concatenate(parts)

    @cached_property
    def outline(self) -> Any:
        """The contour as a shapely ring (closed) or line (open), within 1e-6 m."""
        vertices = self.vertices(OUTLINE_SAGITTA_M)
        outline = shapely.LinearRing(vertices) if self.closed else shapely.LineString(vertices)
        shapely.prepare(outline)
        return outline

    def body(self, max_sagitta_m: float = BODY_SAGITTA_M) -> Any:
        """The area of the contour in plan view: a shapely polygon (closed) or line (open)."""
        vertices = self.vertices(max_sagitta_m)
        return shapely.Polygon(vertices) if self.closed else shapely.LineString(vertices)

    @cached_property
    def _chords(self) -> shapely.STRtree:
        """The chords of the outline in a tree: the nearest is found without measuring to all of them."""
        vertices = shapely.get_coordinates(self.outline)
        return shapely.STRtree(shapely.linestrings(np.stack([vertices[:-1], vertices[1:]], axis=1)))

    @cached_property
    def _interior(self) -> Any:
        interior = shapely.Polygon(self.outline)
        shapely.prepare(interior)
        return interior

    @property
    def length_m(self) -> float:
        """Arc length of the whole contour in m."""
        return sum(piece.length for piece in self.pieces)

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) in m."""
        x_min, y_min, x_max, y_max = self.outline.bounds
        return x_min, y_min, x_max, y_max

    def area_m2(self) -> float:
        """Enclosed area in m^2 by Green's theorem over the pieces; zero for an open contour."""
        return sum(piece.swept_area_m2() for piece in self.pieces) if self.closed else 0.0

    def contains(self, points_m: Any) -> BoolArray:
        """Whether points (..., xy) lie inside, without the boundary. An open contour has no inside."""
        return np.asarray(self.signed_distance(points_m) < 0)

    def signed_distance(self, points_m: Any) -> FloatArray:
        """Distance (...) in m of points (..., xy) to the boundary, negative inside a closed contour."""
        points = np.asarray(points_m, float)
        flat = shapely.points(points.reshape(-1, 2))
        (row, _), near_m = self._chords.query_nearest(flat, return_distance=True, all_matches=False)
        by_row = np.empty(len(flat))
        by_row[row] = near_m
        distance = np.asarray(by_row.reshape(points.shape[:-1]))
        if not self.closed:
            return distance
        return np.where(shapely.contains_xy(self._interior, points[..., 0], points[..., 1]), -distance, distance)

    def curvature(self, spacing_m: float) -> FloatArray:
        """Signed curvature (point,) in 1/m at the points of `sample`, positive where convex from outside."""
        return self._at_samples(lambda piece, t: piece.curvature(t), spacing_m)

    def outward_normal(self, spacing_m: float) -> FloatArray:
        """Unit normals (point, xy) at the points of `sample`, to the right of the direction of the contour."""
        return self._at_samples(lambda piece, t: piece.outward_normal(t), spacing_m)

    def sample(self, spacing_m: float) -> FloatArray:
        """Points (point, xy) on the contour, at most `spacing_m` apart along each piece, including its ends."""
        return self._at_samples(lambda piece, t: piece.point(t), spacing_m)

    def _at_samples(self, of: Callable[[Piece, FloatArray], FloatArray], spacing_m: float) -> FloatArray:
        if not spacing_m > 0:
            raise ValueError(f"spacing_m = {spacing_m}: must be > 0")
        parts = []
        for piece in self.pieces:
            t = piece.equidistant(int(np.ceil(piece.length / spacing_m)))
            parts.append(of(piece, t[:-1]))
        if not self.closed:
            parts.append(of(self.pieces[-1], np.ones(1)))
        return np.concatenate(parts)

    def radius(self, center_m: Any, angle_rad: Any) -> FloatArray:
        """Radial function (...) in m: distance from the centre to the contour at each polar angle (...).

        If a ray crosses the contour more than once, the farthest crossing counts; NaN if it misses.
        """
        angle = np.asarray(angle_rad, float)
        own = shapely.get_coordinates(self.outline) - np.asarray(center_m, float)
        start, chord = own[:-1], np.diff(own, axis=0)
        ray, row = _rays_of_chords(angle.ravel(), np.arctan2(own[:, 1], own[:, 0]))
        along = np.column_stack([np.cos(angle.ravel()), np.sin(angle.ravel())])[ray]
        slant = _cross(along, chord[row])
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing_m = _cross(start[row], chord[row]) / slant
        ends_m = [np.sum(along * own[row + end], axis=1) for end in (0, 1)]
        crossing_m = np.where(slant == 0, np.maximum(*ends_m), crossing_m)
        distance = np.full(angle.size, -np.inf)
        np.maximum.at(distance, ray, crossing_m)
        return np.where(np.isfinite(distance), distance, np.nan).reshape(angle.shape)


def _rays_of_chords(ray_rad: FloatArray, vertex_rad: FloatArray) -> tuple[IntArray, IntArray]:
    """Ray and chord (crossing,) of all crossings, from the angles of rays and of the ends of chords."""
    turned = ray_rad % (2 * np.pi)
    order = np.argsort(turned)
    once = turned[order]
    rays = np.concatenate([once - 2 * np.pi, once, once + 2 * np.pi])
    turn = wrap_angle(np.diff(vertex_rad))
    low = np.where(turn < 0, vertex_rad[1:], vertex_rad[:-1]) % (2 * np.pi)
    width = np.where(np.abs(turn) < np.pi - SAME_ANGLE_RAD, np.abs(turn), 2 * np.pi)  # the centre is on the chord
    first = np.searchsorted(rays, low - SAME_ANGLE_RAD)
    count = np.searchsorted(rays, low + width + SAME_ANGLE_RAD) - first
    row = np.repeat(np.arange(len(turn)), count)
    place = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + first[row]
    return order[place % max(len(once), 1)], row


def _cross(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])


def check_distinct(name: str, points_m: FloatArray, n_least: int) -> None:
    """Raise `ValueError` unless there are at least `n_least` finite points and neighbours differ."""
    if len(points_m) < n_least or not np.all(np.isfinite(points_m)):
        raise ValueError(f"{name} has {len(points_m)} point(s): at least {n_least} finite ones are needed")
    step = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    if step.min() < 1e-9:
        raise ValueError(f"{name}[{step.argmin() + 1}] repeats the point before: neighbours must differ")


def check_not_crossing(name: str, contour: Contour) -> None:
    """Raise `ValueError` if a contour meets itself, except at its two ends."""
    if not shapely.is_simple(contour.outline):
        raise ValueError(f"{name}: the contour they give crosses itself, which it must not")
