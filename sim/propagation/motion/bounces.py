"""The surface around every interaction of a path: how its point may slide, and how the surface bends.

A point of reflection slides over a face, a point of diffraction along an edge; diffuse points and those of targets
stay on their bodies.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from scenes.contours.pieces import Piece
from scenes.record import FloatArray, IntArray, Record, array
from scenes.scene import Scene
from sim.propagation.diffraction.mesh_edges import MeshEdges
from sim.propagation.paths import BounceKind, Paths

N_SEEDS = 12  # per interval between breaks of a piece
N_NEWTON = 8
JOINT_M = 1e-9
ON_CONTOUR_M = 1e-6  # bounces off the top of an object lie inside its contour
UPRIGHT = 0.5  # a face whose normal rises less is vertical


@dataclass(frozen=True)
class Bounces(Record):
    """Interactions of paths that turn the same number of times, TX to RX, without transmissions."""

    body: IntArray = array("path", "bounce", dtype=int, doc="index of the surface")
    point_m: FloatArray = array("path", "bounce", "xyz", unit="m", doc="where")
    tangent: FloatArray = array(
        "path", "bounce", "slide", "xyz", doc="unit vectors along which the point slides; else 0"
    )
    bend: FloatArray = array("path", "bounce", "xyz", unit="1/m", doc="second derivative along the first tangent")


def turning_bounces(paths: Paths, n: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Kinds (path, n), surfaces (path, n) and points (path, n, xyz) of paths that turn `n` times each."""
    turns = ~np.isin(paths.bounce_kind, (BounceKind.NONE, BounceKind.REFRACTION))
    shape = (len(paths), n)
    return (
        paths.bounce_kind[turns].reshape(shape),
        paths.bounce_object[turns].reshape(shape),
        paths.vertex_m[turns].reshape(*shape, 3),
    )


def bounce_geometry(
    paths: Paths, n: int, ends_m: tuple[FloatArray, FloatArray], scene: Scene, edges: MeshEdges | None
) -> Bounces:
    """The surfaces around the `n` interactions of each path from TX to RX (xyz,); `edges` are those of meshes."""
    kind, body, point = turning_bounces(paths, n)
    tx, rx = (np.broadcast_to(end, (len(paths), 1, 3)) for end in ends_m)
    leg = np.diff(np.concatenate([tx, point, rx], axis=1), axis=1)
    along = leg / np.linalg.norm(leg, axis=2, keepdims=True)
    normal = along[:, 1:] - along[:, :-1]
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-300)
    reflects = kind == BounceKind.SPECULAR
    first_mesh = len(paths.object_name) - len(scene.clutter)
    first, second = _face_tangents(normal)
    tangent = np.where(reflects[..., None, None], np.stack([first, second], axis=2), 0.0)
    on_edge = kind == BounceKind.DIFFRACTION
    tangent[on_edge, 0] = (0.0, 0.0, 1.0)
    bend = np.zeros(point.shape)
    for index in np.unique(body[on_edge & (body >= first_mesh)]):
        here = on_edge & (body == index)
        assert edges is not None
        tangent[here, 0] = _edge_direction(edges, int(index) - first_mesh, point[here])
    upright = reflects & (np.abs(normal[..., 2]) < UPRIGHT)
    for index, item in enumerate(scene.objects):
        here = upright & (body == index)
        if here.any() and any(piece.is_curved for piece in item.contour.pieces):
            curvature, outward = _curvature_at(item.contour.pieces, point[here][:, :2])
            side = np.sign((outward * normal[here][:, :2]).sum(axis=1))
            bend[here] = -(side * curvature)[:, None] * normal[here]
    return Bounces(body, point, tangent, bend)


def _face_tangents(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors (..., xyz) in faces with these normals, the first one horizontal."""
    level = np.stack([-normal[..., 1], normal[..., 0], np.zeros(normal.shape[:-1])], axis=-1)
    size = np.linalg.norm(level, axis=-1, keepdims=True)
    level = np.where(size > 1e-6, level / np.maximum(size, 1e-300), [1.0, 0.0, 0.0])
    other = np.cross(normal, level)
    return level, other / np.maximum(np.linalg.norm(other, axis=-1, keepdims=True), 1e-300)


def _edge_direction(edges: MeshEdges, mesh: int, point_m: FloatArray) -> FloatArray:
    """Unit vectors (point, xyz) along the edges of a mesh on which points (point, xyz) lie."""
    mine = np.flatnonzero(edges.mesh == mesh)
    offset = point_m[:, None] - edges.start_m[mine]
    place = (offset * edges.along[mine]).sum(axis=2)
    place = np.clip(place, 0.0, edges.length_m[mine])
    away = np.linalg.norm(offset - place[..., None] * edges.along[mine], axis=2)
    return np.asarray(edges.along[mine[away.argmin(axis=1)]])


def bounce_pieces(paths: Paths, scene: Scene) -> IntArray:
    """On which smooth piece of a contour with curved ones each bounce (path, bounce) lies; 0 on all else."""
    found = np.zeros(paths.bounce_kind.shape, dtype=np.int64)
    reflects = paths.bounce_kind == BounceKind.SPECULAR
    for index, item in enumerate(scene.objects):
        pieces = item.contour.pieces
        here = reflects & (paths.bounce_object == index)
        if here.any() and len(pieces) > 1 and any(piece.is_curved for piece in pieces):
            nearest, _, away_m = _nearest_place(pieces, paths.vertex_m[here][:, :2])
            found[here] = np.where(away_m < ON_CONTOUR_M, nearest, 0)
    return found


def _curvature_at(pieces: tuple[Piece, ...], point_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Curvature (point,) in 1/m and outward normal (point, xy) of a contour at points (point, xy) on it."""
    nearest, t, _ = _nearest_place(pieces, point_m)
    curvature, normal = np.zeros(len(point_m)), np.zeros(point_m.shape)
    for index, piece in enumerate(pieces):
        here = nearest == index
        curvature[here] = piece.curvature(t[here]) if piece.is_curved else 0.0
        normal[here] = piece.outward_normal(t[here])
    return curvature, normal


def _nearest_place(pieces: tuple[Piece, ...], point_m: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Piece (point,), its parameter t and the distance in m of the place nearest to points (point, xy)."""
    nearest = np.zeros(len(point_m), dtype=np.int64)
    place, apart = np.zeros(len(point_m)), np.full(len(point_m), np.inf)
    for index, piece in enumerate(pieces):
        t = _nearest(piece, point_m)
        away = np.linalg.norm(piece.point(t) - point_m, axis=1)
        nearer = away < apart
        nearest[nearer], place[nearer], apart[nearer] = index, t[nearer], away[nearer]
    return nearest, place, apart


def _nearest(piece: Piece, point_m: FloatArray) -> FloatArray:
    """Parameters t (point,) of the places of a piece nearest to points (point, xy), by Newton's method."""
    breaks = piece.breaks
    seeds = np.unique(np.concatenate([np.linspace(a, b, N_SEEDS + 1) for a, b in pairwise(breaks)]))
    apart = np.linalg.norm(piece.point(seeds)[None] - point_m[:, None], axis=2)
    t = seeds[apart.argmin(axis=1)]
    closes = np.linalg.norm(piece.point(1.0) - piece.point(0.0)) < JOINT_M  # its ends are one place
    for _ in range(N_NEWTON):
        offset, first, second = piece.point(t) - point_m, piece.derivative(t), piece.second_derivative(t)
        slope = (offset * first).sum(axis=1)
        bend = (first * first).sum(axis=1) + (offset * second).sum(axis=1)
        t = t - slope / np.where(bend > 0, bend, (first * first).sum(axis=1))
        t = t % 1.0 if closes else np.clip(t, 0.0, 1.0)
    return np.asarray(t)
