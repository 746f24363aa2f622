"""Clutter: objects given as triangle meshes.

The exact solver handles vertical prisms only, so the ray tracer finds the reflections off meshes. `mesh_crossings`
finds where a mesh blocks a path. Every triangle is a flat face: it reflects, it diffracts at its edges and, with
transmission, paths go through it. A faceted round mesh therefore reflects to few receivers, and these reflections
are too strong. Draw round things as objects with a round contour.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import shapely

from scenes.motion.motion import Motion
from scenes.objects.material import Material
from scenes.objects.scene_object import OVERLAP_TOLERANCE_M, SceneObject
from scenes.pose import LARGEST_LENGTH_M
from scenes.record import BoolArray, FloatArray, IntArray, Record, array

END_CLEARANCE_M = 1e-6  # a crossing nearer to an end of the leg than this is the face that the leg starts on
SAME_CROSSING_M = 1e-9  # closer crossings of a leg count once: they lie on an edge that two faces share
LEAST_PLAN_AREA_M2 = 1e-9  # a triangle that covers less stands upright
MAX_TABLE_ENTRIES = 2_000_000  # legs x triangles held at once
PROBE = np.array([0.123_456, 0.234_567, 1.0])  # direction of the inside test: parallel to no usual edge


@dataclass(frozen=True)
class Clutter(Record):
    """A triangle mesh of one material, closed or open. `kind` is one of `scenes.scene.OBJECT_KINDS`.

    Raises `ValueError` for an empty mesh, coordinates that are not finite, a mesh without area, and a non-manifold
    mesh: one in which an edge (a pair of vertex indices) belongs to more than two faces. Two bodies may share an
    edge: then equal numbers of faces run along it in both directions.
    """

    name: str
    kind: str
    material: Material
    vertices_m: FloatArray = array("vertex", "xyz", unit="m", doc="corners of the triangles")
    faces: IntArray = array("face", "corner", dtype=int, doc="vertex index of each corner")
    motion: Motion | None = None
    scale: float = 1.0  # metres of one unit of its file

    def __post_init__(self) -> None:
        super().__post_init__()
        if not len(self.faces) or self.faces.shape[1] != 3:
            raise ValueError(f"mesh '{self.name}' has no triangles: at least one is needed")
        if self.faces.min() < 0 or self.faces.max() >= len(self.vertices_m):
            raise ValueError(f"mesh '{self.name}': a face names a vertex that is not there")
        bad = np.flatnonzero(~(np.abs(self.vertices_m) <= LARGEST_LENGTH_M).all(axis=1))
        if len(bad):
            place = self.vertices_m[bad[0]].tolist()
            raise ValueError(
                f"mesh '{self.name}': vertex {bad[0]} = {place} must be finite, up to {LARGEST_LENGTH_M:g}"
            )
        if not self.area_m2() > 0:
            raise ValueError(f"mesh '{self.name}': its faces have no area")
        uses, balance = self._edge_uses
        n_crowded = int(((uses > 2) & (balance != 0)).sum())
        if n_crowded:
            raise ValueError(
                f"mesh '{self.name}' is not manifold: {n_crowded} edge(s) belong to more than two faces"
            )

    @property
    def bounds_m(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest coordinates, each (xyz,) in m."""
        used = self.vertices_m[self.faces].reshape(-1, 3)
        return used.min(axis=0), used.max(axis=0)

    @property
    def unit_hint(self) -> str:
        """What to do where the mesh has the size of another unit, which depends on the scale that is given."""
        if self.scale == 1.0:
            return "a file in millimetres needs scale = 0.001"
        return f"scale = {self.scale:g} is given; a file in metres needs 1, one in millimetres 0.001"

    @property
    def pivot_m(self) -> FloatArray:
        """The point (xyz,) that way-points refer to and that the mesh turns about: the middle of its bounds."""
        return np.asarray(np.mean(self.bounds_m, axis=0))

    @property
    def is_closed(self) -> bool:
        """Whether the mesh has an inside: every edge belongs to two faces, or to four where bodies touch."""
        return bool(np.all(self._edge_uses[0] % 2 == 0))

    @cached_property
    def plan_outlines_m(self) -> list[FloatArray]:
        """Outlines (point, xy) in m of the areas that the mesh covers in plan view, first point last again."""
        corners, upright = self._plan_corners
        covered = shapely.union_all(shapely.polygons(corners[~upright]))
        return [shapely.get_coordinates(part.exterior) for part in shapely.get_parts(covered)]

    def plan_distance_m(self, points_m: Any) -> FloatArray:
        """Distance (point,) in m of points (point, xy) to the nearest outline or upright face in plan view."""
        corners, upright = self._plan_corners
        lines = [*map(shapely.LineString, self.plan_outlines_m), *shapely.linestrings(corners[upright])]
        points = shapely.points(np.asarray(points_m, float))
        _, distance = shapely.STRtree(lines).query_nearest(points, return_distance=True, all_matches=False)
        return np.asarray(distance)

    @cached_property
    def _plan_corners(self) -> tuple[FloatArray, BoolArray]:
        """Corners (face, corner, xy) in m in plan view, and which faces stand upright (face,)."""
        corners = self.vertices_m[self.faces][..., :2]
        return corners, np.abs(np.linalg.det(np.diff(corners, axis=1))) < LEAST_PLAN_AREA_M2

    def overlaps(self, item: SceneObject) -> bool:
        """Whether the mesh and an object have a common part that is thicker than 1 mm."""
        (low, high), (item_low, item_high) = self.bounds_m, item.bounds_m
        if ((high < item_low) | (low > item_high)).any():
            return False
        rim_m = OVERLAP_TOLERANCE_M / 2
        body = item.contour.body()
        sides = [body.buffer(-rim_m)] if item.contour.closed else [body.offset_curve(s * rim_m) for s in (-1, 1)]
        parts = self._plan_between(item.z_min_m + rim_m, item.z_max_m - rim_m)
        if all(shapely.intersects(side, parts).any() for side in sides):
            return True
        inner = shapely.point_on_surface(sides[0])
        height_m = (item.z_min_m + item.z_max_m) / 2
        return not inner.is_empty and bool(self.contains([[inner.x, inner.y, height_m]])[0])

    def _plan_between(self, low_m: float, high_m: float) -> Any:
        """The parts of the faces between two heights, in plan view; faces beyond are left out."""
        corner = self.vertices_m[self.faces]
        start, along = corner, np.roll(corner, -1, axis=1) - corner  # (face, edge, xyz)
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = (np.array([low_m, high_m]) - start[..., 2:]) / along[..., 2:]
        within = (start[..., 2] >= low_m) & (start[..., 2] <= high_m)
        level = along[..., 2] == 0
        first = np.where(level, np.where(within, 0.0, 2.0), ends.min(axis=-1).clip(0.0))
        last = np.where(level, 1.0, ends.max(axis=-1).clip(max=1.0))
        face, edge = np.nonzero(first <= last)
        share = np.stack([first[face, edge], last[face, edge]], axis=1)
        points = start[face, edge, None, :2] + share[..., None] * along[face, edge, None, :2]
        corners = shapely.points(points.reshape(-1, 2))
        parts = shapely.multipoints(corners, indices=np.unique(np.repeat(face, 2), return_inverse=True)[1])
        return shapely.convex_hull(parts)

    def area_m2(self) -> float:
        """Area of all faces in m^2."""
        a, b, c = np.moveaxis(self.vertices_m[self.faces], 1, 0)
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)

    def contains(self, points_m: Any) -> BoolArray:
        """Whether points (point, xyz) lie inside a closed mesh: their rays cross it an odd number of times."""
        points = np.asarray(points_m, float)
        if not self.is_closed:
            return np.zeros(len(points), bool)
        low, high = self.bounds_m
        inside = np.all((points >= low) & (points <= high), axis=1)
        reach = 2 * np.linalg.norm(high - low)
        hits, _, _ = _hits(self, points[inside], points[inside] + reach * PROBE)
        inside[inside] = np.bincount(hits, minlength=int(inside.sum())) % 2 == 1
        return np.asarray(inside)

    @cached_property
    def _edge_uses(self) -> tuple[IntArray, IntArray]:
        """Number of faces at each edge (edge,), and their sum with sign by direction along the edge (edge,)."""
        edges = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        edges = edges[edges[:, 0] != edges[:, 1]]
        way = np.sign(edges[:, 1] - edges[:, 0])
        _, edge = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
        edge = np.reshape(edge, -1)
        return np.bincount(edge), np.bincount(edge, weights=way).astype(int)


def placed_vertices(
    vertices_m: FloatArray, position_m: Sequence[float], scale: float, rotation_rad: Sequence[float]
) -> FloatArray:
    """Vertices (vertex, xyz) after scaling, rotation about the world x, y and z axes in this order, and shift."""
    result = scale * np.asarray(vertices_m, float)
    for axis, angle in enumerate(rotation_rad):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[[first, second], [first, second]] = np.cos(angle)
        turn[first, second], turn[second, first] = -np.sin(angle), np.sin(angle)
        result = result @ turn.T
    return np.asarray(result + np.asarray(position_m, float))


class MeshCrossings(NamedTuple):
    """Crossings of legs with a mesh, in no particular order."""

    leg: IntArray  # (crossing,) index of the leg
    share: FloatArray  # (crossing,) place along the leg, 0 at its start and 1 at its end
    normal: FloatArray  # (crossing, xyz) unit normal of the face, of either side


def mesh_crossings(item: Clutter, start_m: FloatArray, end_m: FloatArray) -> MeshCrossings:
    """Crossings of legs (leg, xyz) -> (leg, xyz) with a mesh. A crossing on the edge of two faces counts once."""
    start, end = np.atleast_2d(start_m), np.atleast_2d(end_m)
    near = np.flatnonzero(_meets_box(*item.bounds_m, start, end))
    leg, share, face = _hits(item, start[near], end[near])
    leg = near[leg]
    length = np.maximum(np.linalg.norm(end - start, axis=1), END_CLEARANCE_M)[leg]
    order = np.lexsort([share, leg])
    place = (share * length)[order]
    is_new = np.ones(len(order), bool)
    is_new[1:] = (np.diff(leg[order]) != 0) | (np.diff(place) > SAME_CROSSING_M)
    kept = order[is_new]
    margin = END_CLEARANCE_M / length
    kept = kept[(share[kept] > margin[kept]) & (share[kept] < 1 - margin[kept])]
    a, b, c = np.moveaxis(item.vertices_m[item.faces[face[kept]]], 1, 0)
    normal = np.cross(b - a, c - a)
    return MeshCrossings(leg[kept], share[kept], normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _meets_box(low: FloatArray, high: FloatArray, start: FloatArray, end: FloatArray) -> BoolArray:
    """Whether the bounding boxes of legs meet a box (leg,)."""
    return np.asarray(np.all((np.minimum(start, end) <= high) & (np.maximum(start, end) >= low), axis=1))


def _hits(item: Clutter, start: FloatArray, end: FloatArray) -> tuple[IntArray, FloatArray, IntArray]:
    """Leg (hit,), position along the leg as a share of its length (hit,), and triangle (hit,) of each crossing.

    Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
    """
    corner = item.vertices_m[item.faces]
    edge_1, edge_2 = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    legs, shares, triangles = [np.zeros(0, int)], [np.zeros(0)], [np.zeros(0, int)]
    step = max(1, MAX_TABLE_ENTRIES // len(corner))
    for first in range(0, len(start), step):
        along = (end - start)[first : first + step, None]
        offset = start[first : first + step, None] - corner[:, 0]
        normal = np.cross(along, edge_2)
        scale = (normal * edge_1).sum(axis=-1)
        scale = np.where(scale == 0, np.nan, scale)
        u = (normal * offset).sum(axis=-1) / scale
        turned = np.cross(offset, edge_1)
        v = (turned * along).sum(axis=-1) / scale
        share = (turned * edge_2).sum(axis=-1) / scale
        leg, triangle = np.nonzero((u >= 0) & (v >= 0) & (u + v <= 1) & (share >= 0) & (share <= 1))
        legs.append(leg + first)
        shares.append(share[leg, triangle])
        triangles.append(triangle)
    return np.concatenate(legs), np.concatenate(shares), np.concatenate(triangles)
