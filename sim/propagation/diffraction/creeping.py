"""Creeping paths around smooth convex solids: the field in their shadow near its boundary.

A ray from the TX reaches the contour at a tangent, follows it, and departs along a tangent to the receiver. At the
shadow boundary its field is continuous with that of the line of sight and of the reflection at grazing incidence.
The attenuation is that of a perfect conductor; lossy surfaces have almost the same in vertical polarisation. It
depends on the local radius of curvature. Rays that touch a corner, or follow the contour over one, are omitted.
"""

from dataclasses import dataclass

import numpy as np

from scenes.contours import Circle
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import BoolArray, FloatArray, IntArray, Record, array, concatenate
from scenes.scene import Scene, SceneObject
from sim.propagation.diffraction.convex import ConvexContour, convex_contour
from sim.propagation.diffraction.fock import convex_creeping_gain
from sim.propagation.occlusion import OCCLUDER_SAGITTA_M, Occluders, is_blocked, occluders, surface_names
from sim.propagation.paths import BounceKind, Paths, empty_paths, paths_from_field, single_interaction

MIN_GAIN = 1e-3  # over a free wave of the same length; weaker creeping waves are omitted


@dataclass(frozen=True)
class CreepingRays(Record):
    """Rays around one contour: a tangent from the TX, an arc, a tangent to the receiver."""

    receiver: IntArray = array("ray", dtype=int, doc="index of the receiver")
    attach_m: FloatArray = array("ray", "xyz", unit="m", doc="where the ray meets the contour")
    middle_m: FloatArray = array("ray", "xyz", unit="m", doc="middle of the arc")
    shed_m: FloatArray = array("ray", "xyz", unit="m", doc="where the ray leaves the contour")
    normal: FloatArray = array("ray", "place", "xy", doc="outward normal at these three")
    s1_m: FloatArray = array("ray", unit="m", doc="horizontal length of the tangent from the TX")
    s2_m: FloatArray = array("ray", unit="m", doc="horizontal length of the tangent to the receiver")
    arc_m: FloatArray = array("ray", unit="m", doc="horizontal length of the arc")
    bend: FloatArray = array("ray", unit="m^(1/3)", doc="integral of curvature^(2/3) along the arc")
    radius_1_m: FloatArray = array("ray", unit="m", doc="radius of curvature where the ray meets the contour")
    radius_2_m: FloatArray = array("ray", unit="m", doc="radius of curvature where it leaves it")


def convex_contours(scene: Scene) -> dict[int, ConvexContour | Circle]:
    """The contours with creeping waves, by the index of their object."""
    rings: dict[int, ConvexContour | Circle] = {}
    for index, item in enumerate(scene.objects):
        ring = item.contour if isinstance(item.contour, Circle) else convex_contour(item.contour)
        if ring is not None and item.target is None:
            rings[index] = ring
    return rings


def creeping_paths(
    scene: Scene,
    rx_positions_m: FloatArray,
    carrier_hz: float,
    faces: Occluders | None = None,
    rings: dict[int, ConvexContour | Circle] | None = None,
) -> list[Paths]:
    """Paths around one convex contour, in both directions, one record per receiver position (receiver, xyz).

    Each path has one interaction: a diffraction whose vertex is the middle of the arc. `faces` are the occluders
    of the scene and `rings` its convex contours; both are computed if not given. Gain convention of
    `sim.propagation.paths.Paths`.
    """
    rx_positions_m = np.atleast_2d(np.asarray(rx_positions_m, float))
    faces = occluders(scene) if faces is None else faces
    rings = convex_contours(scene) if rings is None else rings
    parts = [empty_paths(surface_names(scene))]
    receiver = [np.zeros(0, int)]
    for index, ring in rings.items():
        for sense in (1, -1):
            rays = creeping_rays(ring, scene.tx.position_m, rx_positions_m, sense)
            rays = rays.take("ray", _is_within_height(rays, scene.objects[index]))
            one = _paths(rays, index, scene, rx_positions_m, carrier_hz)
            kept = np.flatnonzero(_is_strong(one, carrier_hz))
            kept = kept[_is_clear(rays.take("ray", kept), scene, rx_positions_m, faces)]
            parts.append(one.take("path", kept))
            receiver.append(rays.receiver[kept])
    paths, of_receiver = concatenate(parts, "path"), np.concatenate(receiver)
    return [paths.take("path", of_receiver == index) for index in range(len(rx_positions_m))]


def creeping_rays(
    ring: ConvexContour | Circle, tx_m: FloatArray, rx_positions_m: FloatArray, sense: int
) -> CreepingRays:
    """Rays around a contour to receivers (receiver, xyz); counter-clockwise for the sense 1, clockwise for -1.

    The height is linear in the unfolded horizontal length. Every receiver in the shadow has one ray in each sense;
    a lit receiver has none in the sense in which it is lit.
    """
    ends = np.concatenate([tx_m[None], rx_positions_m])
    if isinstance(ring, Circle):
        ways = _round_circle(ring, ends[:, :2], sense)
    else:
        ways = _round_ring(ring, ends[:, :2], sense)
    (point, normal), (s1, s2, arc, bend), radii, valid = ways
    length = s1 + arc + s2
    gone = np.stack([s1, s1 + arc / 2, s1 + arc], axis=1) / np.where(length > 0, length, 1.0)[:, None]
    height = tx_m[2] + (rx_positions_m[:, 2] - tx_m[2])[:, None] * gone
    spot = np.concatenate([point, height[..., None]], axis=2)
    rays = CreepingRays(np.arange(len(arc)), spot[:, 0], spot[:, 1], spot[:, 2], normal, s1, s2, arc, bend, *radii)
    return rays.take("ray", valid)


Ways = tuple[
    tuple[FloatArray, FloatArray],
    tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    tuple[FloatArray, FloatArray],
    BoolArray,
]


def _round_circle(circle: Circle, ends_m: FloatArray, sense: int) -> Ways:
    """Points and normals (ray, 3, xy), lengths and bend, radii and mask of the rays, in closed form."""
    center, radius = circle.center_m, circle.radius_m
    offset = ends_m - center
    distance = np.hypot(offset[:, 0], offset[:, 1])
    azimuth = np.arctan2(offset[:, 1], offset[:, 0])
    to_tangent = np.arccos(np.minimum(radius / np.maximum(distance, radius), 1.0))
    tangent = np.sqrt(np.maximum(distance**2 - radius**2, 0.0))
    apart = (sense * (azimuth[1:] - azimuth[0])) % (2 * np.pi)
    turn = apart - to_tangent[0] - to_tangent[1:]
    attach = azimuth[0] + sense * to_tangent[0]
    angle = attach + sense * turn[:, None] * np.array([0.0, 0.5, 1.0])
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    s1 = np.broadcast_to(tangent[0], turn.shape)
    radii = np.full(turn.shape, radius)
    valid = (turn > 0) & (distance[0] > radius) & (distance[1:] > radius)
    lengths = (s1, tangent[1:], radius * turn, np.cbrt(radius) * turn)
    return (center + radius * normal, normal), lengths, (radii, radii), valid


def _round_ring(ring: ConvexContour, ends_m: FloatArray, sense: int) -> Ways:
    """The same quantities for any convex contour, from its table."""
    meets = ring.tangents(ends_m[:1], ends_light=sense > 0)
    leaves = ring.tangents(ends_m[1:], ends_light=sense < 0)
    low, high = (meets, leaves) if sense > 0 else (leaves, meets)
    start, arc = low.place_m, (high.place_m - low.place_m) % ring.length_m
    bend = (ring.bend_up_to(high.place_m) - ring.bend_up_to(low.place_m)) % ring.bend[-1]
    start = np.broadcast_to(start, arc.shape)
    middle, middle_normal = ring.at(start + arc / 2)
    shape = leaves.point_m.shape
    point = np.stack([np.broadcast_to(meets.point_m, shape), middle, leaves.point_m], axis=1)
    normal = np.stack([np.broadcast_to(meets.normal, shape), middle_normal, leaves.normal], axis=1)
    s1 = np.broadcast_to(np.linalg.norm(ends_m[0] - meets.point_m, axis=1), arc.shape)
    s2 = np.linalg.norm(ends_m[1:] - leaves.point_m, axis=1)
    radii = np.broadcast_to(meets.radius_m, arc.shape), leaves.radius_m
    valid = meets.valid & leaves.valid & (s1 > 0) & (s2 > 0) & ~ring.has_corner(start, arc)
    return (point, normal), (s1, s2, arc, bend), radii, valid


def _is_within_height(rays: CreepingRays, item: SceneObject) -> BoolArray:
    """Mask (ray,) of arcs that stay on the object from end to end."""
    heights = np.stack([rays.attach_m[:, 2], rays.shed_m[:, 2]])
    return np.asarray(((heights >= item.z_min_m) & (heights <= item.z_max_m)).all(axis=0))


def _is_strong(paths: Paths, carrier_hz: float) -> BoolArray:
    free_gain = 1 / (4 * np.pi * carrier_hz * paths.delay_s)
    return np.asarray(np.abs(paths.gain) > MIN_GAIN * free_gain)


def _is_clear(rays: CreepingRays, scene: Scene, rx: FloatArray, faces: Occluders) -> BoolArray:
    """Mask (ray,): both tangents are free and no other object is at the middle of the arc."""
    outward = 2 * OCCLUDER_SAGITTA_M * np.pad(rays.normal, ((0, 0), (0, 0), (0, 1)))
    attach, middle, shed = (
        rays.attach_m + outward[:, 0],
        rays.middle_m + outward[:, 1],
        rays.shed_m + outward[:, 2],
    )
    tx = np.broadcast_to(scene.tx.position_m, attach.shape)
    clear = scene.object_index_at(middle) < 0
    clear[clear] = ~is_blocked(faces, attach[clear], tx[clear])
    clear[clear] = ~is_blocked(faces, shed[clear], rx[rays.receiver[clear]])
    return np.asarray(clear)


def _paths(rays: CreepingRays, index: int, scene: Scene, rx_positions_m: FloatArray, carrier_hz: float) -> Paths:
    """Gains, delays and directions of all rays, as one record."""
    rx, tx = rx_positions_m[rays.receiver], scene.tx.position_m
    level = rays.s1_m + rays.arc_m + rays.s2_m
    length = np.hypot(level, rx[:, 2] - tx[2])
    k_horizontal = 2 * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S * level / length
    radii = rays.radius_1_m, rays.radius_2_m
    return paths_from_field(
        convex_creeping_gain(k_horizontal, radii, rays.s1_m, rays.s2_m, rays.arc_m, rays.bend, "soft"),
        length,
        rays.attach_m - tx,
        rx - rays.shed_m,
        single_interaction(BounceKind.DIFFRACTION, index, rays.middle_m),
        surface_names(scene),
        carrier_hz,
    )
