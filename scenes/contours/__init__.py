"""Contours: the 2-D boundaries over which all objects of a scene stand as vertical prisms.

A contour is a chain of smooth pieces. Closed contours run counter-clockwise; open ones are thin walls. A new kind
of contour is a frozen dataclass that says `closed` and returns its `pieces`; all else follows from them.
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
