"""Contours: the 2-D boundaries of all objects of a scene, which are vertical prisms over them.

Read `base.py` first: a `Contour` is a chain of smooth pieces (`pieces.py`). Closed contours run counter-clockwise;
open ones are thin walls. A new kind of contour is a frozen dataclass that defines `closed` and `pieces`.
"""

from scenes.contours.base import Contour
from scenes.contours.pieces import ArcPiece, EllipsePiece, LinePiece, Piece, SplinePiece
from scenes.contours.polygons import Polygon, Polyline, RoundedPolygon, rectangle
from scenes.contours.smooth import Circle, ClosedSpline, Ellipse, OpenSpline

__all__ = [
    "ArcPiece",
    "Circle",
    "ClosedSpline",
    "Contour",
    "Ellipse",
    "EllipsePiece",
    "LinePiece",
    "OpenSpline",
    "Piece",
    "Polygon",
    "Polyline",
    "RoundedPolygon",
    "SplinePiece",
    "rectangle",
]
