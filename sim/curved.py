"""Exact first-order reflection off smooth contours, which faceted ray tracing loses.

All objects are vertical prisms, so the reflection point is a stationary point in plan view of the length
|T - c(t)| + |c(t) - R|, and the height is linear in the unfolded horizontal length. Amplitudes are those of
geometrical optics with the contour's own curvature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.contour_piece import Piece
from scenes.pose import SPEED_OF_LIGHT_M_S, azimuth_elevation
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray, Record, array
from scenes.scene import Scene, SceneObject
from sim.fresnel import slab_reflection, vertical_reflection
from sim.occlusion import OCCLUDER_SAGITTA_M, Occluders, blocked, occluders, surface_names
from sim.paths import BounceKind, Paths

N_GRID = 512  # intervals per piece searched for stationary points; two in one interval are both missed
N_BISECTIONS = 45
PIECE_OVERLAP = 1e-9  # pieces are searched this share beyond their ends, so that no joint falls between two
SAME_POINT_M = 1e-6  # stationary points of one object closer than this are one
MIN_COS_INCIDENCE = 1e-4
# |1 + 2 k s1 s2 / ((s1 + s2) cos t)| is kept above this, a gain of at most 10 dB over a plane. That is about
# the height of the Airy peak at a caustic of contours some metres large at 60 GHz.
CAUSTIC_LIMIT = 0.1


@dataclass(frozen=True)
class Reflections(Record):
    """Reflection points of one TX and several receivers on the contours of the scene, occluded ones left out."""

    receiver: IntArray = array("point", dtype=int, doc="index of the receiver")
    surface: IntArray = array("point", dtype=int, doc="index of the object")
    point_m: FloatArray = array("point", "xyz", unit="m", doc="reflection point")
    normal: FloatArray = array("point", "xyz", doc="unit normal towards the lit side")
    curvature: FloatArray = array("point", unit="1/m", doc="> 0 where convex, seen from the lit side")


def curved_reflections(
    scene: Scene, rx_positions_m: FloatArray, carrier_hz: float, faces: Occluders | None = None
) -> list[Paths]:
    """Paths of one specular bounce off a curved piece, one record per receiver position (receiver, xyz).

    All solutions are found, the several ones of a concave contour too. `faces` are the scene's occluders, made
    anew where not given. Gain convention of `sim.paths.Paths`; the specular share sqrt(1 - S^2) of a material
    that also scatters is in the gain.
    """
    rx_positions_m = np.atleast_2d(np.asarray(rx_positions_m, float))
    faces = occluders(scene) if faces is None else faces
    found = reflection_points(scene, rx_positions_m)
    found = found.take("point", _is_clear(found, scene.tx.position_m, rx_positions_m, faces))
    paths = _paths(found, scene, rx_positions_m, carrier_hz)
    return [paths.take("path", found.receiver == index) for index in range(len(rx_positions_m))]


def reflection_points(scene: Scene, rx_positions_m: FloatArray) -> Reflections:
    """All points of reflection on curved pieces from the scene's TX to receivers (receiver, xyz), occluded or not.

    TX and RX lie on the same side of the surface, the outer one of a closed contour, and the point within the
    object's height.
    """
    tx = scene.tx.position_m
    parts = []
    for index, item in enumerate(scene.objects):
        for piece in item.contour.pieces:
            if piece.is_curved:
                parts.append(_on_piece(item, index, piece, tx, rx_positions_m))
    if not parts:
        none = np.zeros(0, int)
        return Reflections(none, none, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    found = Reflections(*columns)
    return found.take("point", _is_first_of_its_kind(found))


def stationary_parameters(
    piece: Piece, tx_xy_m: FloatArray, rx_xy_m: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Receiver indices and parameters t (solution,) where |T - c(t)| + |c(t) - R| is stationary on a piece.

    Sign changes of c'(t) . (u_T + u_R) on a grid, then bisection; `rx_xy_m` is (receiver, xy).
    """

    def slope(t: FloatArray, rx: FloatArray) -> FloatArray:
        point = piece.point(t)
        from_tx, from_rx = point - tx_xy_m, point - rx
        pull = from_tx / _norm(from_tx)[..., None] + from_rx / _norm(from_rx)[..., None]
        return np.asarray((piece.derivative(t) * pull).sum(axis=-1))

    grid = np.linspace(-PIECE_OVERLAP, 1 + PIECE_OVERLAP, N_GRID + 1)
    is_rising = slope(np.broadcast_to(grid, (len(rx_xy_m), len(grid))), rx_xy_m[:, None]) > 0
    receiver, interval = np.nonzero(is_rising[:, 1:] != is_rising[:, :-1])
    low, high = grid[interval], grid[interval + 1]
    low_rising = is_rising[receiver, interval]
    for _ in range(N_BISECTIONS):
        middle = (low + high) / 2
        same = (slope(middle, rx_xy_m[receiver]) > 0) == low_rising
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return receiver, (low + high) / 2


def spreading(
    curvature: FloatArray, s1_m: FloatArray, s2_m: FloatArray, cos_incidence: FloatArray
) -> ComplexArray:
    """Amplitude (...) of a reflection off a cylinder over that off a plane.

    1 / sqrt(1 + 2 k s1 s2 / ((s1 + s2) cos t)) by geometrical optics; curvature k > 0 is convex, the lengths
    s1, s2 and the incidence t are horizontal. Past a caustic the root is of a negative number: the phase
    advances by 90 deg. The gain is capped at the caustic.
    """
    factor = 1 + 2 * curvature * s1_m * s2_m / ((s1_m + s2_m) * cos_incidence)
    amplitude = 1 / np.sqrt(np.maximum(np.abs(factor), CAUSTIC_LIMIT))
    return np.asarray(amplitude * np.where(factor < 0, 1j, 1))


def _on_piece(
    item: SceneObject, index: int, piece: Piece, tx: FloatArray, rx: FloatArray
) -> tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]:
    """Fields of `Reflections` for one piece."""
    receiver, t = stationary_parameters(piece, tx[:2], rx[:, :2])
    point, normal, curvature = piece.point(t), piece.outward_normal(t), piece.curvature(t)
    to_tx, to_rx = tx[:2] - point, rx[receiver, :2] - point
    s1, s2 = _norm(to_tx), _norm(to_rx)
    cos_tx, cos_rx = (normal * to_tx).sum(axis=1) / s1, (normal * to_rx).sum(axis=1) / s2
    height = tx[2] + (rx[receiver, 2] - tx[2]) * s1 / (s1 + s2)
    side = np.sign(cos_tx)
    valid = (cos_tx * cos_rx > 0) & (np.abs(cos_tx) > MIN_COS_INCIDENCE)
    valid &= (height >= item.z_min_m) & (height <= item.z_max_m)
    if item.contour.closed:
        valid &= side > 0
    point_3d = np.column_stack([point, height])
    normal_3d = np.column_stack([normal * side[:, None], np.zeros(len(t))])
    surface = np.full(len(t), index)
    return receiver[valid], surface[valid], point_3d[valid], normal_3d[valid], (curvature * side)[valid]


def _is_first_of_its_kind(found: Reflections) -> BoolArray:
    """Mask (point,) without the repetitions that overlapping pieces of one object give."""
    order = np.lexsort([found.point_m[:, 0], found.surface, found.receiver])
    before, after = order[:-1], order[1:]
    same = (found.receiver[before] == found.receiver[after]) & (found.surface[before] == found.surface[after])
    same &= _norm(found.point_m[after] - found.point_m[before]) < SAME_POINT_M
    first = np.ones(len(order), bool)
    first[after[same]] = False
    return first


def _is_clear(found: Reflections, tx: FloatArray, rx: FloatArray, faces: Occluders) -> BoolArray:
    """Mask (point,) of both legs free; they start off the surface by more than its polygon deviates from it."""
    start = found.point_m + 2 * OCCLUDER_SAGITTA_M * found.normal
    to_tx = np.broadcast_to(tx, start.shape)
    return ~(blocked(faces, start, to_tx) | blocked(faces, start, rx[found.receiver]))


def _paths(found: Reflections, scene: Scene, rx_positions_m: FloatArray, carrier_hz: float) -> Paths:
    """Gains, delays and directions of all reflection points, as one record."""
    from_tx, to_rx = found.point_m - scene.tx.position_m, rx_positions_m[found.receiver] - found.point_m
    s1, s2 = _norm(from_tx[:, :2]), _norm(to_rx[:, :2])
    leg_1, leg_2 = _norm(from_tx), _norm(to_rx)
    length = leg_1 + leg_2
    incident, reflected = from_tx / leg_1[:, None], to_rx / leg_2[:, None]
    cos_horizontal = -(found.normal * from_tx).sum(axis=1) / s1
    gain = spreading(found.curvature, s1, s2, cos_horizontal)
    gain *= _reflection_gain(found, scene, incident, reflected, carrier_hz)
    wavelength = SPEED_OF_LIGHT_M_S / carrier_hz
    gain *= wavelength / (4 * np.pi * length) * np.exp(-2j * np.pi * length / wavelength)
    aod_azimuth, aod_elevation = azimuth_elevation(incident)
    aoa_azimuth, aoa_elevation = azimuth_elevation(-reflected)
    return Paths(
        gain=gain,
        delay_s=length / SPEED_OF_LIGHT_M_S,
        aod_azimuth_rad=aod_azimuth,
        aod_elevation_rad=aod_elevation,
        aoa_azimuth_rad=aoa_azimuth,
        aoa_elevation_rad=aoa_elevation,
        bounce_kind=np.full((len(length), 1), BounceKind.SPECULAR),
        bounce_object=found.surface[:, None],
        vertex_m=found.point_m[:, None],
        object_name=np.asarray(surface_names(scene), str),
    )


def _reflection_gain(
    found: Reflections, scene: Scene, incident: FloatArray, reflected: FloatArray, carrier_hz: float
) -> ComplexArray:
    """Slab reflection between vertically polarised antennas, times the specular share sqrt(1 - S^2) (point,)."""
    gain = np.ones(len(incident), complex)
    for surface in np.unique(found.surface):
        here = found.surface == surface
        material = scene.objects[surface].material
        cosine = np.abs((found.normal[here] * incident[here]).sum(axis=1))
        permittivity = material.complex_permittivity(carrier_hz)
        r_s, r_p = slab_reflection(cosine, permittivity, material.thickness_m, carrier_hz)
        gain[here] = vertical_reflection(incident[here], reflected[here], found.normal[here], r_s, r_p)
        gain[here] *= np.sqrt(1 - material.scattering_coefficient**2)
    return gain


def _norm(vector: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vector, axis=-1))
