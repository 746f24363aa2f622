"""First-order diffraction at the edges of user meshes, in any direction: corners and the rims of open meshes.

The point of diffraction follows from Keller's cone and the gain from the uniform theory of
`sim.propagation.diffraction.wedge`, in the frame of the edge, for both polarisations: the field along the edge
is soft, the field across it hard. Sionna RT is not used: it searches edges with random rays, which miss some
edges, and its gain differs by up to 6 dB from that of a conducting wedge.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scenes.objects.clutter import Clutter
from scenes.objects.material import Material
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import ComplexArray, FloatArray, IntArray, Record, array, concatenate
from sim.propagation.diffraction.edge_paths import EDGE_CLEARANCE_M, MIN_LEG_M
from sim.propagation.diffraction.edges import MIN_TURN_RAD
from sim.propagation.diffraction.wedge import wedge_gain
from sim.propagation.occlusion import Occluders, is_blocked
from sim.propagation.paths import BounceKind, Paths, paths_from_field, single_interaction, with_bounce_slots
from sim.propagation.specular.fresnel import normal_to_plane_of_incidence, slab_reflection, vertical_polarisation

FULL_TURN = 2 * np.pi


@dataclass(frozen=True)
class MeshEdges(Record):
    """Edges of meshes with a free sector of more than half of the space, and rims of open meshes.

    The free sector extends counter-clockwise around `along` over `opening_rad`, from face 0 to face n. `face_0`
    points away from the edge.
    """

    start_m: FloatArray = array("edge", "xyz", unit="m", doc="one end")
    along: FloatArray = array("edge", "xyz", doc="unit vector along the edge")
    length_m: FloatArray = array("edge", unit="m", doc="length of the edge")
    face_0: FloatArray = array("edge", "xyz", doc="unit vector in face 0, away from the edge")
    normal_0: FloatArray = array("edge", "xyz", doc="unit normal of face 0 towards the free sector")
    opening_rad: FloatArray = array("edge", unit="rad", doc="free angle from face 0 to face n")
    mesh: IntArray = array("edge", dtype=int, doc="index of the mesh")


@dataclass(frozen=True)
class _Rays(Record):
    """Rays over edges."""

    edge: IntArray = array("ray", dtype=int, doc="index of the edge")
    point_m: FloatArray = array("ray", "xyz", unit="m", doc="point of diffraction")
    before: FloatArray = array("ray", "xyz", doc="unit direction from the TX")
    after: FloatArray = array("ray", "xyz", doc="unit direction to the receiver")
    s_in_m: FloatArray = array("ray", unit="m", doc="length from the TX")
    s_out_m: FloatArray = array("ray", unit="m", doc="length to the receiver")
    phi_in_rad: FloatArray = array("ray", unit="rad", doc="angle from face 0 to the TX about the edge")
    phi_out_rad: FloatArray = array("ray", unit="rad", doc="angle from face 0 to the receiver about the edge")


def mesh_edges(clutter: Sequence[Clutter]) -> MeshEdges:
    """The diffracting edges of all meshes, without flat edges and without edges of four faces (touching bodies).

    Two faces always count as the outside of a wedge of less than pi, independent of their normals: no ray travels
    inside the material.
    """
    return concatenate([_none(), *(_edges_of(item, index) for index, item in enumerate(clutter))], "edge")


def diffracted_by_meshes(
    edges: MeshEdges,
    ends_m: tuple[FloatArray, FloatArray],
    materials: Sequence[Material],
    faces: Occluders,
    carrier_hz: float,
    names: list[str],
    n_slots: int,
) -> Paths:
    """Paths of one diffraction from TX to RX (xyz,) at edges of meshes, with both legs free.

    `materials` are those of the meshes. The meshes are the last entries of `names`.
    """
    rays = _keller(edges, ends_m)
    for end in ends_m:
        start = rays.point_m + EDGE_CLEARANCE_M * _outward(edges, rays.edge)
        rays = rays.take("ray", ~is_blocked(faces, start, np.broadcast_to(end, start.shape)))
    item = len(names) - len(materials) + edges.mesh[rays.edge]
    paths = paths_from_field(
        _gain(edges, rays, materials, carrier_hz),
        rays.s_in_m + rays.s_out_m,
        rays.before,
        rays.after,
        single_interaction(BounceKind.DIFFRACTION, item, rays.point_m),
        names,
        carrier_hz,
    )
    return with_bounce_slots(paths, n_slots)


def _none() -> MeshEdges:
    none, vector = np.zeros(0), np.zeros((0, 3))
    return MeshEdges(vector, vector, none, vector, vector, none, none.astype(int))


def _edges_of(item: Clutter, mesh: int) -> MeshEdges:
    face = np.tile(np.arange(len(item.faces)), 3)
    ends = np.concatenate([item.faces[:, [0, 1]], item.faces[:, [1, 2]], item.faces[:, [2, 0]]])
    opposite = np.concatenate([item.faces[:, 2], item.faces[:, 0], item.faces[:, 1]])
    order = np.lexsort([face, *np.sort(ends, axis=1).T])
    pair = np.sort(ends[order], axis=1)
    first = np.flatnonzero(np.append(True, (np.diff(pair, axis=0) != 0).any(axis=1)))
    uses = np.diff(np.append(first, len(pair)))
    first, uses = first[uses <= 2], uses[uses <= 2]
    start, end = (item.vertices_m[pair[first, k]] for k in (0, 1))
    length = np.linalg.norm(end - start, axis=1)
    unit = (end - start) / np.where(length > 0, length, np.nan)[:, None]
    face_0, face_n = (
        _away(item.vertices_m[opposite[order[place]]] - start, unit) for place in (first, first + uses - 1)
    )
    normal = np.cross(unit, face_0)
    normal *= np.where((normal * face_n).sum(axis=1) > 0, -1.0, 1.0)[:, None]
    turn = np.arctan2((face_n * normal).sum(axis=1), (face_n * face_0).sum(axis=1)) % FULL_TURN
    opening = np.where((uses == 1) | (turn < MIN_TURN_RAD), FULL_TURN, turn)
    along = np.cross(face_0, normal)
    at = start + np.where((along * unit).sum(axis=1) < 0, length, 0.0)[:, None] * unit
    kept = (opening > np.pi + MIN_TURN_RAD) & np.isfinite(normal).all(axis=1)
    edges = MeshEdges(at, along, length, face_0, normal, opening, np.full(len(at), mesh))
    return edges.take("edge", kept)


def _away(vector: FloatArray, unit: FloatArray) -> FloatArray:
    """Unit vectors (edge, xyz) across an edge towards a corner `vector` away from it; NaN without area."""
    across = vector - (vector * unit).sum(axis=1)[:, None] * unit
    size = np.linalg.norm(across, axis=1)
    return np.asarray(across / np.where(size > 0, size, np.nan)[:, None])


def _outward(edges: MeshEdges, edge: IntArray) -> FloatArray:
    """Unit vectors (edge, xyz) into the middle of the free sectors of edges (edge,)."""
    middle = edges.opening_rad[edge, None] / 2
    return np.asarray(np.cos(middle) * edges.face_0[edge] + np.sin(middle) * edges.normal_0[edge])


def _keller(edges: MeshEdges, ends_m: tuple[FloatArray, FloatArray]) -> _Rays:
    """Rays over edges whose free sector contains both ends and whose point on Keller's cone is on the edge."""
    along, height, across = [], [], []
    for end in ends_m:
        offset = end - edges.start_m
        along.append((offset * edges.along).sum(axis=1))
        height.append((offset * edges.normal_0).sum(axis=1))
        across.append((offset * edges.face_0).sum(axis=1))
    distance = [np.hypot(y, x) for y, x in zip(height, across, strict=True)]
    phi_in, phi_out = (np.arctan2(y, x) % FULL_TURN for y, x in zip(height, across, strict=True))
    place = along[0] + (along[1] - along[0]) * distance[0] / np.maximum(distance[0] + distance[1], 1e-300)
    valid = (phi_in < edges.opening_rad) & (phi_out < edges.opening_rad)
    valid &= (place >= 0) & (place <= edges.length_m) & (distance[0] > MIN_LEG_M) & (distance[1] > MIN_LEG_M)
    edge, place = np.flatnonzero(valid), place[valid]
    point = edges.start_m[edge] + place[:, None] * edges.along[edge]
    legs = point - ends_m[0], ends_m[1] - point
    s_in, s_out = (np.linalg.norm(leg, axis=1) for leg in legs)
    before, after = legs[0] / s_in[:, None], legs[1] / s_out[:, None]
    return _Rays(edge, point, before, after, s_in, s_out, phi_in[valid], phi_out[valid])


def _gain(edges: MeshEdges, rays: _Rays, materials: Sequence[Material], carrier_hz: float) -> ComplexArray:
    """Diffracted over free field (ray,) between vertically polarised antennas.

    The reflection of either face is taken at the smaller one of the angles of the two rays, as in
    `sim.propagation.diffraction.edge_paths`.
    """
    along, opening = edges.along[rays.edge], edges.opening_rad[rays.edge]
    tilt = np.arcsin(np.clip((rays.before * along).sum(axis=1), -1, 1))
    grazing_0 = np.minimum(rays.phi_in_rad, rays.phi_out_rad)
    grazing_n = opening - np.maximum(rays.phi_in_rad, rays.phi_out_rad)
    mesh = edges.mesh[rays.edge]
    faces = [_face_reflection(materials, mesh, grazing, tilt, carrier_hz) for grazing in (grazing_0, grazing_n)]
    sent, received = vertical_polarisation(rays.before), vertical_polarisation(rays.after)
    basis_in, basis_out = _edge_basis(rays.before, along), _edge_basis(rays.after, along)
    total = np.zeros(len(mesh), complex)
    for k in range(2):  # soft, hard
        diffracted = wedge_gain(
            FULL_TURN * carrier_hz / SPEED_OF_LIGHT_M_S,
            opening / np.pi,
            rays.phi_in_rad,
            rays.phi_out_rad,
            rays.s_in_m,
            rays.s_out_m,
            np.cos(tilt),
            faces[0][k],
            faces[1][k],
        )
        total += diffracted * (sent * basis_in[k]).sum(axis=1) * (received * basis_out[k]).sum(axis=1)
    return total


def _edge_basis(direction: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors (ray, xyz) normal to a direction: closest to the edge (soft), and across the edge (hard)."""
    soft = along - (along * direction).sum(axis=1)[:, None] * direction
    soft = soft / np.linalg.norm(soft, axis=1, keepdims=True)
    return soft, np.cross(direction, soft)


def _face_reflection(
    materials: Sequence[Material], mesh: IntArray, grazing_rad: FloatArray, tilt_rad: FloatArray, carrier_hz: float
) -> tuple[ComplexArray, ComplexArray]:
    """Reflection coefficients (ray,) of a face for soft and hard fields, equal to those of a specular path.

    In the frame of the edge: z along it, y the normal of the face.
    """
    level = np.cos(tilt_rad)
    along, down, up = level * np.cos(grazing_rad), level * np.sin(grazing_rad), np.sin(tilt_rad)
    before, after = np.column_stack([along, -down, up]), np.column_stack([along, down, up])
    normal, edge = (np.broadcast_to(axis, before.shape) for axis in ([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]))
    r_s, r_p = np.zeros(len(mesh), complex), np.zeros(len(mesh), complex)
    for index in np.unique(mesh):
        here, material = mesh == index, materials[index]
        permittivity = material.complex_permittivity(carrier_hz)
        r = slab_reflection(np.abs(down[here]), permittivity, material.thickness_m, carrier_hz)
        specular = np.sqrt(1 - material.scattering_coefficient**2)
        r_s[here], r_p[here] = specular * r[0], specular * r[1]
    s = normal_to_plane_of_incidence(before, normal)
    p_in, p_out = np.cross(s, before), np.cross(s, after)
    soft, hard = (
        r_s * (a * s).sum(axis=1) * (b * s).sum(axis=1) + r_p * (a * p_in).sum(axis=1) * (b * p_out).sum(axis=1)
        for a, b in zip(_edge_basis(before, edge), _edge_basis(after, edge), strict=True)
    )
    return soft, hard
