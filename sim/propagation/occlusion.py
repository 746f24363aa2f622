"""Crossings of straight legs with the faces of a scene, exact in 2.5 D: plan view and height."""

from dataclasses import dataclass, field

import numpy as np

from scenes.contours.pieces import LinePiece
from scenes.objects import clutter as meshes
from scenes.objects.clutter import Clutter
from scenes.record import BoolArray, FloatArray, IntArray, Record, array, concatenate
from scenes.scene import Scene
from sim.propagation.specular.curves import Curves, joined_curves
from sim.propagation.specular.plan_view import cross, dot, norm
from sim.propagation.specular.surfaces import HorizontalFace, curves_of_piece, horizontal_faces

OCCLUDER_SAGITTA_M = 1e-4  # a leg that starts at a corner may start this far from it
END_CLEARANCE_M = 1e-6  # crossings nearer to an end of the leg than this are ignored: the leg ends on a face
MAX_TABLE_ENTRIES = 2_000_000  # legs x faces held at once
N_BISECTIONS = 54


@dataclass(frozen=True)
class Occluders(Record):
    """All vertical faces of a scene, its curved walls, the lids of its solids, and its meshes.

    `first_mesh` is the index of the first mesh among all surfaces.
    """

    edge_start_m: FloatArray = array("edge", "xy", unit="m", doc="start of each flat face in plan view")
    edge_end_m: FloatArray = array("edge", "xy", unit="m", doc="end of each flat face in plan view")
    edge_surface: IntArray = array("edge", dtype=int, doc="index of the object")
    z_min_m: FloatArray = array("object", unit="m", doc="lower rim of each object")
    z_max_m: FloatArray = array("object", unit="m", doc="upper rim of each object")
    conics: Curves = field(default_factory=lambda: joined_curves([]))
    cubics: Curves = field(default_factory=lambda: joined_curves([]))
    lids: tuple[HorizontalFace, ...] = ()
    clutter: tuple[Clutter, ...] = ()
    first_mesh: int = 0


@dataclass(frozen=True)
class Crossings(Record):
    """Crossings of legs with faces, in no particular order."""

    leg: IntArray = array("crossing", dtype=int, doc="index of the leg")
    share: FloatArray = array("crossing", doc="place along the leg, 0 at its start and 1 at its end")
    surface: IntArray = array("crossing", dtype=int, doc="index of the object")
    normal: FloatArray = array("crossing", "xyz", doc="unit normal of the face, of either side")


def surface_names(scene: Scene) -> list[str]:
    """Names of all surfaces: the objects in order, then 'floor', 'ceiling' and clutter if present."""
    planes = [name for name in ("floor", "ceiling") if getattr(scene, name) is not None]
    return [*scene.object_names, *planes, *(mesh.name for mesh in scene.clutter)]


def occluders(scene: Scene, without: int = -1) -> Occluders:
    """Faces of all objects but one. Floor and ceiling are omitted: both ends of a leg lie between them."""
    flat, curved = [], []
    for index, item in enumerate(scene.objects):
        if index == without:
            continue
        for piece in item.contour.pieces:
            if isinstance(piece, LinePiece):
                flat.append((piece.start_m, piece.end_m, index))
            else:
                curved += curves_of_piece(piece, index, closed=True, max_segments=1)
    return Occluders(
        np.array([one[0] for one in flat]).reshape(-1, 2),
        np.array([one[1] for one in flat]).reshape(-1, 2),
        np.array([one[2] for one in flat], int),
        np.array([item.z_min_m for item in scene.objects]),
        np.array([item.z_max_m for item in scene.objects]),
        joined_curves([one for one in curved if one.is_conic[0]]),
        joined_curves([one for one in curved if not one.is_conic[0]]),
        tuple(
            level
            for level in horizontal_faces(scene)
            if level.surface < len(scene.objects) and level.surface != without
        ),
        scene.clutter,
        len(surface_names(scene)) - len(scene.clutter),
    )


def is_blocked(faces: Occluders, start_m: FloatArray, end_m: FloatArray) -> BoolArray:
    """Mask (leg,) of legs (leg, xyz) -> (leg, xyz) that cross a face, a lid or a mesh between their ends."""
    result = np.zeros(len(np.atleast_2d(start_m)), bool)
    result[leg_crossings(faces, start_m, end_m).leg] = True
    return result


def sees_tx(scene: Scene) -> BoolArray:
    """Mask (stop,) of stops of the walk with a free line of sight to the TX, where everything is at the start."""
    stops = scene.walk.positions_m()
    return ~is_blocked(occluders(scene), np.broadcast_to(scene.tx.position_m, stops.shape), stops)


def leg_crossings(faces: Occluders, start_m: FloatArray, end_m: FloatArray) -> Crossings:
    """All crossings of legs (leg, xyz) -> (leg, xyz) with faces, lids and mesh triangles between their ends."""
    start, end = np.atleast_2d(start_m), np.atleast_2d(end_m)
    n_faces = faces.size("edge") + len(faces.conics) + len(faces.cubics)
    step = max(1, MAX_TABLE_ENTRIES // max(1, n_faces))
    parts = [_none()]
    for first in range(0, len(start), step):
        leg = slice(first, first + step)
        for find in (_edges, _conics, _cubics):
            found = find(faces, start[leg], end[leg])
            parts.append(_between(found, faces, start[leg], end[leg], first))
    parts += [_lid(lid, start, end) for lid in faces.lids]
    for index, item in enumerate(faces.clutter, start=faces.first_mesh):
        met = meshes.mesh_crossings(item, start, end)
        parts.append(Crossings(met.leg, met.share, np.full(len(met.leg), index), met.normal))
    return concatenate(parts, "crossing")


def _none() -> Crossings:
    none = np.zeros(0)
    return Crossings(none.astype(int), none, none.astype(int), np.zeros((0, 3)))


def _between(found: Crossings, faces: Occluders, start: FloatArray, end: FloatArray, first: int) -> Crossings:
    """The crossings between the lower and upper rim and away from the ends; leg numbers start at `first`."""
    leg, share = found.leg, found.share
    along = end[leg] - start[leg]
    margin = END_CLEARANCE_M / np.sqrt((along * along).sum(axis=1))
    height = start[leg, 2] + share * along[:, 2]
    kept = (share > margin) & (share < 1 - margin)
    kept &= (height >= faces.z_min_m[found.surface]) & (height <= faces.z_max_m[found.surface])
    return Crossings(leg[kept] + first, share[kept], found.surface[kept], found.normal[kept])


def _edges(faces: Occluders, start: FloatArray, end: FloatArray) -> Crossings:
    """Crossing of p + u r (leg) and q + v s (face) in plan view."""
    r, s = (end - start)[:, :2], faces.edge_end_m - faces.edge_start_m
    q = faces.edge_start_m
    determinant = r[:, 0, None] * s[:, 1] - r[:, 1, None] * s[:, 0]
    x, y = q[:, 0] - start[:, 0, None], q[:, 1] - start[:, 1, None]
    along_leg = x * s[:, 1] - y * s[:, 0]
    along_face = x * r[:, 1, None] - y * r[:, 0, None]
    size = np.abs(determinant)
    along_leg, along_face = along_leg * np.sign(determinant), along_face * np.sign(determinant)
    crossing = (along_leg > 0) & (along_leg < size) & (along_face >= 0) & (along_face <= size)
    leg, edge = np.nonzero(crossing)
    normal = np.column_stack([s[edge, 1], -s[edge, 0], np.zeros(len(edge))])
    normal /= norm(s)[edge, None]
    return Crossings(leg, along_leg[leg, edge] / size[leg, edge], faces.edge_surface[edge], normal)


def _conics(faces: Occluders, start: FloatArray, end: FloatArray) -> Crossings:
    """Crossings with o + a cos p + b sin p: roots of a quadratic where o is the origin and a, b the axes."""
    conics = faces.conics
    leg, curve = _near(conics, start, end)
    o, a, b, (first, sweep) = (
        conics.coefficient[curve, 0, 0],
        conics.coefficient[curve, 0, 1],
        conics.coefficient[curve, 0, 2],
        conics.coefficient[curve, 0, 3].T,
    )
    scale = cross(a, b)[:, None]
    offset, along = start[leg, :2] - o, (end - start)[leg, :2]
    p = np.column_stack([cross(offset, b), cross(a, offset)]) / scale
    r = np.column_stack([cross(along, b), cross(a, along)]) / scale
    square, half = dot(r, r), dot(p, r)
    root = half * half - square * (dot(p, p) - 1)
    parts = []
    for sign in (-1.0, 1.0):
        share = (sign * np.sqrt(np.maximum(root, 0)) - half) / np.where(square > 0, square, 1.0)
        place = p + share[:, None] * r
        turned = np.arctan2(place[:, 1], place[:, 0]) - first
        t = (turned * np.sign(sweep)) % (2 * np.pi) / np.abs(sweep)
        hit = (root > 0) & (square > 0) & (share > 0) & (share < 1) & (t <= 1)
        parts.append(_on_curve(conics, leg[hit], curve[hit], share[hit], t[hit]))
    return concatenate(parts, "crossing")


def _cubics(faces: Occluders, start: FloatArray, end: FloatArray) -> Crossings:
    """Crossings with cubics: roots of n . (c(t) - start), where n is normal to the leg."""
    cubics = faces.cubics
    leg, curve = _near(cubics, start, end)
    along = (end - start)[leg, :2]
    weights = cubics.coefficient[curve, 0]
    weights[:, 3] -= start[leg, :2]
    w = cross(along[:, None], weights)
    row, t = _roots_in_unit(w)
    leg, curve, along = leg[row], curve[row], along[row]
    point, _, _ = cubics.at(curve, t)
    share = dot(point - start[leg, :2], along) / dot(along, along)
    hit = (share > 0) & (share < 1)
    return _on_curve(cubics, leg[hit], curve[hit], share[hit], t[hit])


def _on_curve(curves: Curves, leg: IntArray, curve: IntArray, share: FloatArray, t: FloatArray) -> Crossings:
    _, first, _ = curves.at(curve, t)
    normal = np.column_stack([curves.normal(curve, first), np.zeros(len(leg))])
    return Crossings(leg, share, curves.surface[curve], normal)


def _near(curves: Curves, start: FloatArray, end: FloatArray) -> tuple[IntArray, IntArray]:
    """Legs and curves (pair,) for which the leg crosses the disc of the curve in plan view; no vertical legs."""
    r = (end - start)[:, :2]
    square = dot(r, r)
    x = curves.center_m[:, 0] - start[:, 0, None]
    y = curves.center_m[:, 1] - start[:, 1, None]
    along, aside = x * r[:, 0, None] + y * r[:, 1, None], x * r[:, 1, None] - y * r[:, 0, None]
    limit = curves.reach_m * np.sqrt(square)[:, None]
    near = (np.abs(aside) <= limit) & (along >= -limit) & (along <= square[:, None] + limit)
    leg, curve = np.nonzero(near & (square > 0)[:, None])
    return leg, curve


def _roots_in_unit(w: FloatArray) -> tuple[IntArray, FloatArray]:
    """Rows and roots t in [0, 1) of cubics w0 t^3 + ... + w3 (row, 4): bisection between turning points."""
    a, b, c = 3 * w[:, 0], 2 * w[:, 1], w[:, 2]
    root = np.sqrt(np.maximum(b * b - 4 * a * c, 0))
    q = -(b + np.where(b >= 0, root, -root)) / 2
    turning = [np.clip(np.where(d != 0, n / np.where(d != 0, d, 1.0), 0.0), 0, 1) for n, d in ((q, a), (c, q))]
    knots = np.sort(np.column_stack([np.zeros(len(w)), *turning, np.ones(len(w))]), axis=1)
    low, high = knots[:, :-1].ravel(), knots[:, 1:].ravel()
    row = np.repeat(np.arange(len(w)), 3)
    sign = [_polynomial(w[row], t) >= 0 for t in (low, high)]
    changes = sign[0] != sign[1]
    row, low, high, above = row[changes], low[changes], high[changes], sign[0][changes]
    for _ in range(N_BISECTIONS):
        middle = (low + high) / 2
        same = (_polynomial(w[row], middle) >= 0) == above
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return row, (low + high) / 2


def _polynomial(w: FloatArray, t: FloatArray) -> FloatArray:
    return np.asarray(((w[:, 0] * t + w[:, 1]) * t + w[:, 2]) * t + w[:, 3])


def _lid(lid: HorizontalFace, start: FloatArray, end: FloatArray) -> Crossings:
    """Crossings of legs with a lid: at its height and inside its outline."""
    before, after = start[:, 2] - lid.z_m, end[:, 2] - lid.z_m
    leg = np.flatnonzero(before * after < 0)
    share = before[leg] / (before[leg] - after[leg])
    length = np.sqrt(((end[leg] - start[leg]) ** 2).sum(axis=1))
    off_ends = (share * length > END_CLEARANCE_M) & ((1 - share) * length > END_CLEARANCE_M)
    leg, share = leg[off_ends], share[off_ends]
    inside = lid.holds((start[leg] + share[:, None] * (end[leg] - start[leg]))[:, :2])
    leg, share = leg[inside], share[inside]
    return Crossings(leg, share, np.full(len(leg), lid.surface), np.broadcast_to([0.0, 0.0, 1.0], (len(leg), 3)))
