"""Contours of straight sides: polygons, with sharp or rounded corners, and open thin walls."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely

from scenes.arguments import need_each
from scenes.contours.base import Contour, check_distinct, check_not_crossing
from scenes.contours.pieces import ArcPiece, LinePiece, Piece
from scenes.record import FloatArray, array

LEAST_THICKNESS_M = 1e-6


@dataclass(frozen=True)
class Polygon(Contour):
    """A simple polygon. Clockwise vertices are put in counter-clockwise order."""

    vertices_m: FloatArray = array("vertex", "xy", unit="m", doc="corners, the first one not repeated")
    closed = True

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_simple(self.vertices_m)
        if not shapely.LinearRing(self.vertices_m).is_ccw:
            object.__setattr__(self, "vertices_m", self.vertices_m[::-1])

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """One line per edge."""
        return tuple(_lines([*self.vertices_m, self.vertices_m[0]]))


@dataclass(frozen=True)
class RoundedPolygon(Contour):
    """A simple polygon with rounded corners: arcs tangent to both sides. Radius 0 is a sharp corner."""

    vertices_m: FloatArray = array("vertex", "xy", unit="m", doc="corners before rounding")
    corner_radius_m: FloatArray = array("vertex", unit="m", doc="radius of the arc at each corner, >= 0")
    closed = True

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_simple(self.vertices_m)
        if not shapely.LinearRing(self.vertices_m).is_ccw:
            object.__setattr__(self, "vertices_m", self.vertices_m[::-1])
            object.__setattr__(self, "corner_radius_m", self.corner_radius_m[::-1])
        self._check_radii()

    @property
    def _turn_rad(self) -> FloatArray:
        """Angle (vertex,) by which the outline turns left at each corner."""
        after = np.roll(self.vertices_m, -1, axis=0) - self.vertices_m
        before = np.roll(after, 1, axis=0)
        cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        return np.asarray(np.arctan2(cross, (before * after).sum(axis=1)))

    def _check_radii(self) -> None:
        for index, radius in enumerate(self.corner_radius_m):
            if not (np.isfinite(radius) and radius >= 0):
                raise ValueError(f"corner_radius_m[{index}] = {radius}: must be >= 0")
        cut = self.corner_radius_m * np.abs(np.tan(self._turn_rad / 2))
        edge = np.linalg.norm(np.roll(self.vertices_m, -1, axis=0) - self.vertices_m, axis=1)
        excess = cut + np.roll(cut, -1) - edge
        if excess.max() > 1e-9:
            worst = int(excess.argmax())
            following = (worst + 1) % len(edge)
            raise ValueError(
                f"corner_radius_m = {self.corner_radius_m.tolist()}: the arcs at corners {worst} and {following}"
                f" take {edge[worst] + excess[worst]:.3f} m of a side that is {edge[worst]:.3f} m long"
            )
        check_not_crossing("corner_radius_m", self)

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """Alternating lines and arcs, starting at the end of the first corner."""
        pieces: list[Piece] = []
        corners = self.vertices_m
        ahead = np.roll(corners, -1, axis=0) - corners
        ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
        turn = self._turn_rad
        cut = self.corner_radius_m * np.abs(np.tan(turn / 2))
        for here in range(len(corners)):
            there = (here + 1) % len(corners)
            start = corners[here] + cut[here] * ahead[here]
            end = corners[there] - cut[there] * ahead[here]
            if np.linalg.norm(end - start) > 1e-9:
                pieces.append(LinePiece(start, end))
            if cut[there] > 1e-9:
                pieces.append(_fillet(end, ahead[here], float(self.corner_radius_m[there]), float(turn[there])))
        return tuple(pieces)


@dataclass(frozen=True)
class Polyline(Contour):
    """An open thin wall of straight pieces."""

    points_m: FloatArray = array("vertex", "xy", unit="m", doc="corners from one end to the other")
    closed = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check_distinct("points_m", self.points_m, 2)
        check_not_crossing("points_m", self)

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """One line per pair of neighbours."""
        return tuple(_lines(list(self.points_m)))


def rectangle(x_m: tuple[float, float], y_m: tuple[float, float]) -> Polygon:
    """Axis-parallel rectangle between two x and two y coordinates."""
    for name, pair in (("x_m", x_m), ("y_m", y_m)):
        need_each(name, pair, float, int, np.number)
        if len(pair) != 2:
            raise ValueError(f"{name} = {list(pair)}: must be two numbers")
        if not pair[0] < pair[1]:
            raise ValueError(f"{name} = {list(pair)}: the first must be smaller than the second")
    return Polygon(np.array([(x_m[0], y_m[0]), (x_m[1], y_m[0]), (x_m[1], y_m[1]), (x_m[0], y_m[1])]))


def _lines(points: list[FloatArray]) -> list[Piece]:
    return [LinePiece(start, end) for start, end in pairwise(points)]


def _fillet(start_m: FloatArray, tangent: FloatArray, radius_m: float, turn_rad: float) -> ArcPiece:
    """Arc that starts at `start_m` along `tangent` and turns by `turn_rad`, to the left if positive."""
    side = np.sign(turn_rad)
    to_center = side * np.array([-tangent[1], tangent[0]])
    start_rad = float(np.arctan2(-to_center[1], -to_center[0]))
    return ArcPiece(start_m + radius_m * to_center, radius_m, start_rad, turn_rad)


def _check_simple(vertices: FloatArray) -> None:
    check_distinct("vertices_m", vertices, 3)
    if np.linalg.norm(vertices[0] - vertices[-1]) < 1e-9:
        raise ValueError(f"vertices_m[{len(vertices) - 1}] repeats the first vertex: leave it out")
    outline = shapely.Polygon(vertices)
    if not outline.is_valid:
        reason = shapely.is_valid_reason(outline)
        raise ValueError(f"vertices_m = {vertices.tolist()}: sides must not cross or coincide ({reason})")
    if outline.buffer(-LEAST_THICKNESS_M / 2).is_empty:
        raise ValueError(f"vertices_m = {vertices.tolist()}: the outline has no thickness")
