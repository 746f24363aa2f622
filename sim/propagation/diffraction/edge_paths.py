"""First-order diffraction at the vertical edges of a scene: corners, door jambs and the ends of thin walls.

The edges are vertical, so the height along a diffracted ray is linear in its unfolded horizontal length (Keller's
cone), and the gain is that of `sim.propagation.diffraction.wedge`.
"""

from dataclasses import dataclass

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray, Record, array
from scenes.scene import Scene
from sim.propagation.diffraction.edges import Edges, find_edges
from sim.propagation.diffraction.wedge import wedge_gain
from sim.propagation.occlusion import OCCLUDER_SAGITTA_M, Occluders, is_blocked, occluders, surface_names
from sim.propagation.paths import BounceKind, Paths, paths_from_field, single_interaction
from sim.propagation.specular.fresnel import slab_reflection, vertical_reflection

EDGE_CLEARANCE_M = 2 * OCCLUDER_SAGITTA_M  # between a leg and the edge, along the middle of the free sector
MIN_LEG_M = 1e-6  # shorter legs have no ray: the end lies on the edge


@dataclass(frozen=True)
class Diffractions(Record):
    """Points of diffraction between one TX and several receivers."""

    receiver: IntArray = array("point", dtype=int, doc="index of the receiver")
    edge: IntArray = array("point", dtype=int, doc="index of the edge")
    point_m: FloatArray = array("point", "xyz", unit="m", doc="point of diffraction")
    phi_in_rad: FloatArray = array("point", unit="rad", doc="horizontal angle from face 0 to the TX")
    phi_out_rad: FloatArray = array("point", unit="rad", doc="horizontal angle from face 0 to the receiver")


def diffracted_paths(
    scene: Scene,
    rx_positions_m: FloatArray,
    carrier_hz: float,
    faces: Occluders | None = None,
    edges: Edges | None = None,
) -> list[Paths]:
    """Paths of one diffraction at a vertical edge, one record per receiver position (receiver, xyz).

    `faces` are the occluders of the scene and `edges` its edges; both are computed if not given. Both legs are
    free. Gain convention of `sim.propagation.paths.Paths`: the sum with line of sight and reflections is
    continuous at their shadow boundaries.
    """
    rx_positions_m = np.atleast_2d(np.asarray(rx_positions_m, float))
    faces = occluders(scene) if faces is None else faces
    edges = find_edges(scene) if edges is None else edges
    found = diffraction_points(edges, scene.tx.position_m, rx_positions_m)
    found = found.take("point", _is_clear(found, edges, scene.tx.position_m, rx_positions_m, faces))
    paths = _paths(found, edges, scene, rx_positions_m, carrier_hz)
    return [paths.take("path", found.receiver == index) for index in range(len(rx_positions_m))]


def diffraction_points(edges: Edges, tx_m: FloatArray, rx_positions_m: FloatArray) -> Diffractions:
    """Points on all edges whose own wedge blocks neither end, without test for occlusion by other objects."""
    tx_azimuth, tx_distance = _polar(tx_m[:2] - edges.position_m)
    rx_azimuth, rx_distance = _polar(rx_positions_m[:, None, :2] - edges.position_m)
    phi_in = np.broadcast_to((tx_azimuth - edges.face_0_rad) % (2 * np.pi), rx_azimuth.shape)
    phi_out = (rx_azimuth - edges.face_0_rad) % (2 * np.pi)
    near = np.maximum(tx_distance, MIN_LEG_M)
    share = near / (near + np.maximum(rx_distance, MIN_LEG_M))
    height = tx_m[2] + share * (rx_positions_m[:, 2:] - tx_m[2])
    valid = (phi_in < edges.opening_rad) & (phi_out < edges.opening_rad)
    valid &= (height >= edges.z_min_m) & (height <= edges.z_max_m)
    valid &= (tx_distance > MIN_LEG_M) & (rx_distance > MIN_LEG_M)
    receiver, edge = np.nonzero(valid)
    point = np.column_stack([edges.position_m[edge], height[valid]])
    return Diffractions(receiver, edge, point, phi_in[valid], phi_out[valid])


def _is_clear(found: Diffractions, edges: Edges, tx: FloatArray, rx: FloatArray, faces: Occluders) -> BoolArray:
    """Mask (point,): both legs are free. The leg from the TX is the same for all receivers at one height."""
    middle = (edges.face_0_rad + edges.opening_rad / 2)[found.edge]
    outward = np.column_stack([np.cos(middle), np.sin(middle), np.zeros(len(middle))])
    start = found.point_m + EDGE_CLEARANCE_M * outward
    distinct, which = np.unique(start, axis=0, return_inverse=True)
    clear = ~is_blocked(faces, distinct, np.broadcast_to(tx, distinct.shape))[which.ravel()]
    clear[clear] = ~is_blocked(faces, start[clear], rx[found.receiver[clear]])
    return np.asarray(clear)


def _paths(
    found: Diffractions, edges: Edges, scene: Scene, rx_positions_m: FloatArray, carrier_hz: float
) -> Paths:
    """Gains, delays and directions of all points, as one record."""
    from_tx, to_rx = found.point_m - scene.tx.position_m, rx_positions_m[found.receiver] - found.point_m
    return paths_from_field(
        _wedge_gain(found, edges, scene, rx_positions_m, carrier_hz),
        np.linalg.norm(from_tx, axis=1) + np.linalg.norm(to_rx, axis=1),
        from_tx,
        to_rx,
        single_interaction(BounceKind.DIFFRACTION, edges.object[found.edge], found.point_m),
        surface_names(scene),
        carrier_hz,
    )


def _wedge_gain(
    found: Diffractions, edges: Edges, scene: Scene, rx_positions_m: FloatArray, carrier_hz: float
) -> ComplexArray:
    """Diffracted over free field (point,) between vertically polarised antennas.

    Vertical polarisation is soft at a vertical edge. Luebbers takes the reflection of face 0 at the angle of the
    incident ray and that of face n at the angle of the diffracted one; here it is the smaller of the two angles
    at each face. This is reciprocal, and it agrees with Luebbers at the reflection boundaries.
    """
    from_tx = found.point_m - scene.tx.position_m
    s_in = np.linalg.norm(from_tx, axis=1)
    s_out = np.linalg.norm(rx_positions_m[found.receiver] - found.point_m, axis=1)
    elevation = np.arcsin(from_tx[:, 2] / s_in)
    opening = edges.opening_rad[found.edge]
    grazing_0 = np.minimum(found.phi_in_rad, found.phi_out_rad)
    grazing_n = opening - np.maximum(found.phi_in_rad, found.phi_out_rad)
    return wedge_gain(
        2 * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S,
        opening / np.pi,
        found.phi_in_rad,
        found.phi_out_rad,
        s_in,
        s_out,
        np.cos(elevation),
        _face_reflection(scene, edges.object_0[found.edge], grazing_0, elevation, carrier_hz),
        _face_reflection(scene, edges.object_n[found.edge], grazing_n, elevation, carrier_hz),
    )


def _face_reflection(
    scene: Scene, objects: IntArray, grazing_rad: FloatArray, elevation_rad: FloatArray, carrier_hz: float
) -> ComplexArray:
    """Reflection coefficient (point,) of a vertical face at horizontal grazing angles, as for specular paths."""
    level = np.cos(elevation_rad)
    along, down, up = level * np.cos(grazing_rad), level * np.sin(grazing_rad), np.sin(elevation_rad)
    incident, reflected = np.column_stack([along, -down, up]), np.column_stack([along, down, up])
    normal = np.broadcast_to([0.0, 1.0, 0.0], incident.shape)
    gain = np.zeros(len(objects), complex)
    for index in np.unique(objects):
        here = objects == index
        material = scene.objects[index].material
        permittivity = material.complex_permittivity(carrier_hz)
        r_s, r_p = slab_reflection(np.abs(down[here]), permittivity, material.thickness_m, carrier_hz)
        gain[here] = vertical_reflection(incident[here], reflected[here], normal[here], r_s, r_p)
        gain[here] *= np.sqrt(1 - material.scattering_coefficient**2)
    return gain


def _polar(vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Azimuth and length (...) of horizontal vectors (..., xy)."""
    return np.arctan2(vector[..., 1], vector[..., 0]), np.hypot(vector[..., 0], vector[..., 1])
