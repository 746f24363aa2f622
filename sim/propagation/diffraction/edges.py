"""The vertical diffracting edges of a scene: corners of solids, door jambs and the ends of thin walls."""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import shapely

from scenes.contours.base import Contour
from scenes.record import FloatArray, IntArray, Record, array
from scenes.scene import Scene, SceneObject

TOUCH_M = 1e-3  # objects closer than this touch: a fifth of a wavelength at 60 GHz
MIN_TURN_RAD = np.deg2rad(1.0)  # a contour that turns less at a joint, or a wedge flatter than this, is smooth

FULL_TURN = 2 * np.pi


@dataclass(frozen=True)
class Edges(Record):
    """Convex edges of the union of all objects.

    The free sector about an edge opens counter-clockwise from face 0 to face n and is wider than pi.
    """

    position_m: FloatArray = array("edge", "xy", unit="m", doc="the edge in plan view")
    z_min_m: FloatArray = array("edge", unit="m", doc="lower end")
    z_max_m: FloatArray = array("edge", unit="m", doc="upper end")
    face_0_rad: FloatArray = array("edge", unit="rad", doc="azimuth of face 0, away from the edge")
    opening_rad: FloatArray = array("edge", unit="rad", doc="free angle n pi from face 0 to face n")
    object: IntArray = array("edge", dtype=int, doc="index of the object whose corner it is")
    object_0: IntArray = array("edge", dtype=int, doc="index of the object of face 0")
    object_n: IntArray = array("edge", dtype=int, doc="index of the object of face n")


class Sector(NamedTuple):
    """Sector around a point inside an object: `extent_rad` counter-clockwise from `start_rad` (thin wall: 0)."""

    start_rad: float
    extent_rad: float
    object: int


class Gap(NamedTuple):
    """A free sector around a point, and the two objects at its sides."""

    face_0_rad: float
    opening_rad: float
    object_0: int
    object_n: int


def find_edges(scene: Scene) -> Edges:
    """All vertical edges of a scene.

    A corner is where two pieces of a contour meet at an angle, or where a thin wall ends. The free
    angle between all touching objects decides, separately for each range of heights: flush faces have no edge
    between them, and a corner that a second object fills has no edge. Concave corners do not diffract to first
    order and are omitted, as are the horizontal edges of objects.
    """
    found = []
    for owner, item in enumerate(scene.objects):
        for corner in [] if item.target else _corners(item.contour):
            found += _edges_at(corner, owner, scene.objects)
    found = _without_repetitions(found)
    columns = list(zip(*found, strict=True)) if found else [()] * 8
    position = np.reshape(np.asarray(columns[0], float), (-1, 2))
    return Edges(position, *(np.asarray(column) for column in columns[1:]))


EdgeRow = tuple[FloatArray, float, float, float, float, int, int, int]


def _corners(contour: Contour) -> list[FloatArray]:
    """Points (xy,) where the direction of the contour jumps, and the two ends of an open contour."""
    pieces = contour.pieces
    following = [*pieces[1:], pieces[0]] if contour.closed else list(pieces[1:])
    corners = []
    for piece, after in zip(pieces, following, strict=False):
        turn = _azimuth(after.derivative(0.0)) - _azimuth(piece.derivative(1.0))
        if abs((turn + np.pi) % FULL_TURN - np.pi) > MIN_TURN_RAD:
            corners.append(piece.point(1.0))
    if not contour.closed:
        corners += [pieces[0].point(0.0), pieces[-1].point(1.0)]
    return corners


def _edges_at(corner: FloatArray, owner: int, objects: tuple[SceneObject, ...]) -> list[EdgeRow]:
    """Edges at one corner of an object: one per range of heights with the same free sector."""
    sectors = {
        index: _sectors(item.contour, index, corner)
        for index, item in enumerate(objects)
        if _is_near(item.contour, corner)
    }
    low, high = objects[owner].z_min_m, objects[owner].z_max_m
    rims = {z for index in sectors for z in (objects[index].z_min_m, objects[index].z_max_m)}
    levels = sorted({low, high} | {z for z in rims if low < z < high})
    rows: list[EdgeRow] = []
    for z_min, z_max in pairwise(levels):
        middle = (z_min + z_max) / 2
        present = [index for index in sectors if objects[index].z_min_m < middle < objects[index].z_max_m]
        for gap in _wide_gaps([sector for index in present for sector in sectors[index]]):
            row = (corner, z_min, z_max, gap.face_0_rad, gap.opening_rad, owner, gap.object_0, gap.object_n)
            below = next((k for k, old in enumerate(rows) if old[2] == z_min and old[3:] == row[3:]), None)
            if below is None:
                rows.append(row)
            else:
                rows[below] = (corner, rows[below][1], *row[2:])
    return rows


def _is_near(contour: Contour, point: FloatArray) -> bool:
    x_min, y_min, x_max, y_max = contour.bounds_m
    if not (x_min - TOUCH_M <= point[0] <= x_max + TOUCH_M and y_min - TOUCH_M <= point[1] <= y_max + TOUCH_M):
        return False
    return bool(contour.signed_distance(point) <= TOUCH_M)


def _sectors(contour: Contour, index: int, point: FloatArray) -> list[Sector]:
    """Sectors that a touching contour fills around a point: all, one sector, or single directions (thin walls)."""
    if contour.signed_distance(point) < -TOUCH_M:
        return [Sector(0.0, FULL_TURN, index)]
    ahead, back = _directions(contour, point)
    if contour.closed:
        return [Sector(ahead[0], (back[0] - ahead[0]) % FULL_TURN, index)]
    return [Sector(azimuth, 0.0, index) for azimuth in (*ahead, *back)]


def _directions(contour: Contour, point: FloatArray) -> tuple[list[float], list[float]]:
    """Azimuths of a contour away from the point nearest to `point`, forward and backward along the contour.

    At an open end one of the two is empty, unless a thin wall meets itself there.
    """
    pieces = contour.pieces
    starts = [piece for piece in pieces if np.linalg.norm(piece.point(0.0) - point) <= TOUCH_M]
    ends = [piece for piece in pieces if np.linalg.norm(piece.point(1.0) - point) <= TOUCH_M]
    if starts or ends:
        ahead = [_azimuth(piece.derivative(0.0)) for piece in starts]
        return ahead, [_azimuth(-piece.derivative(1.0)) for piece in ends]
    along = contour.outline.project(shapely.Point(point))
    before, after = (
        np.asarray(contour.outline.interpolate(along + step).coords[0]) for step in (-TOUCH_M / 2, TOUCH_M / 2)
    )
    return [_azimuth(after - before)], [_azimuth(before - after)]


def _wide_gaps(sectors: list[Sector]) -> list[Gap]:
    """Free sectors wider than pi between the filled ones, by a counter-clockwise sweep from the first one."""
    if not sectors:
        return []
    first = min(sector.start_rad % FULL_TURN for sector in sectors)
    turned = sorted(((s.start_rad - first) % FULL_TURN, s.extent_rad, s.object) for s in sectors)
    reached, at = turned[0][1], turned[0][2]
    gaps = []
    for start, extent, item in [*turned[1:], (FULL_TURN, 0.0, turned[0][2])]:
        if start - reached > np.pi + MIN_TURN_RAD:
            gaps.append(Gap((first + reached) % FULL_TURN, start - reached, at, item))
        if start + extent > reached:
            reached, at = start + extent, item
    return gaps


def _without_repetitions(rows: list[EdgeRow]) -> list[EdgeRow]:
    """Edges without repetitions: one edge per place, range of heights and free sector."""
    kept: list[EdgeRow] = []
    for row in rows:
        if not any(_is_same(row, other) for other in kept):
            kept.append(row)
    return kept


def _is_same(row: EdgeRow, other: EdgeRow) -> bool:
    if np.linalg.norm(row[0] - other[0]) > TOUCH_M or min(row[2], other[2]) <= max(row[1], other[1]):
        return False
    turn = (row[3] - other[3] + np.pi) % FULL_TURN - np.pi
    return bool(abs(turn) < MIN_TURN_RAD and abs(row[4] - other[4]) < MIN_TURN_RAD)


def _azimuth(vector: FloatArray) -> float:
    return float(np.arctan2(vector[..., 1], vector[..., 0]))
