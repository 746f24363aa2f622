"""Creeping paths round round pillars: what reaches the shadow of a smooth solid near its boundary.

A ray from the TX meets the circle at a tangent, follows it, and leaves it at a tangent to the receiver. At the
shadow boundary its field continues that of the line of sight and the reflection at grazing incidence. The
attenuation is that of a perfect conductor, which lossy surfaces share closely in vertical polarisation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.contour import Circle
from scenes.pose import SPEED_OF_LIGHT_M_S, azimuth_elevation
from scenes.record import BoolArray, FloatArray, IntArray, Record, array, concatenate
from scenes.scene import Scene, SceneObject
from sim.fock import creeping_gain
from sim.occlusion import OCCLUDER_SAGITTA_M, Occluders, blocked, occluders, surface_names
from sim.paths import BounceKind, Paths, empty_paths

MIN_GAIN = 1e-3  # over a free wave of the same length; weaker creeping waves are left out


@dataclass(frozen=True)
class CreepingRays(Record):
    """Rays round one circle: a tangent from the TX, an arc, a tangent to the receiver."""

    receiver: IntArray = array("ray", dtype=int, doc="index of the receiver")
    attach_m: FloatArray = array("ray", "xyz", unit="m", doc="where the ray meets the circle")
    middle_m: FloatArray = array("ray", "xyz", unit="m", doc="middle of the arc")
    shed_m: FloatArray = array("ray", "xyz", unit="m", doc="where the ray leaves the circle")
    s1_m: FloatArray = array("ray", unit="m", doc="horizontal length of the tangent from the TX")
    s2_m: FloatArray = array("ray", unit="m", doc="horizontal length of the tangent to the receiver")
    turn_rad: FloatArray = array("ray", unit="rad", doc="angle of the arc")


def creeping_paths(
    scene: Scene, rx_positions_m: FloatArray, carrier_hz: float, faces: Occluders | None = None
) -> list[Paths]:
    """Paths round one circular contour, in both senses, one record per receiver position (receiver, xyz).

    One interaction each, a diffraction whose vertex is the middle of the arc. `faces` are the scene's occluders,
    made anew where not given. Gain convention of `sim.paths.Paths`.
    """
    rx_positions_m = np.atleast_2d(np.asarray(rx_positions_m, float))
    faces = occluders(scene) if faces is None else faces
    parts = [empty_paths(surface_names(scene))]
    receiver = [np.zeros(0, int)]
    for index, item in enumerate(scene.objects):
        if isinstance(item.contour, Circle):
            for sense in (1, -1):
                rays = creeping_rays(item.contour, scene.tx.position_m, rx_positions_m, sense)
                rays = rays.take("ray", _is_within_height(rays, item))
                one = _paths(rays, item.contour, index, scene, rx_positions_m, carrier_hz)
                kept = np.flatnonzero(_is_strong(one, carrier_hz))
                kept = kept[_is_clear(rays.take("ray", kept), item.contour, scene, rx_positions_m, faces)]
                rays, one = rays.take("ray", kept), one.take("path", kept)
                parts.append(one)
                receiver.append(rays.receiver)
    paths, of_receiver = concatenate(parts, "path"), np.concatenate(receiver)
    return [paths.take("path", of_receiver == index) for index in range(len(rx_positions_m))]


def creeping_rays(circle: Circle, tx_m: FloatArray, rx_positions_m: FloatArray, sense: int) -> CreepingRays:
    """Rays round a circle to receivers (receiver, xyz); counter-clockwise for the sense 1, clockwise for -1.

    The height is linear in the unfolded horizontal length. Every receiver has one ray in each sense, but for the
    sense in which it lies in the light.
    """
    center, radius = circle.center_m, circle.radius_m
    ends = np.concatenate([tx_m[None], rx_positions_m])
    offset = ends[:, :2] - center
    distance = np.hypot(offset[:, 0], offset[:, 1])
    azimuth = np.arctan2(offset[:, 1], offset[:, 0])
    to_tangent = np.arccos(np.minimum(radius / np.maximum(distance, radius), 1.0))
    tangent = np.sqrt(np.maximum(distance**2 - radius**2, 0.0))
    apart = (sense * (azimuth[1:] - azimuth[0])) % (2 * np.pi)
    turn = apart - to_tangent[0] - to_tangent[1:]
    s1, s2 = np.broadcast_to(tangent[0], turn.shape), tangent[1:]
    length = s1 + radius * turn + s2
    attach_rad = np.broadcast_to(azimuth[0] + sense * to_tangent[0], turn.shape)

    def point(angle: FloatArray, gone: FloatArray) -> FloatArray:
        height = tx_m[2] + (rx_positions_m[:, 2] - tx_m[2]) * gone / np.where(length > 0, length, 1.0)
        x, y = center[0] + radius * np.cos(angle), center[1] + radius * np.sin(angle)
        return np.column_stack([x, y, height])

    attach = point(attach_rad, s1)
    middle = point(attach_rad + sense * turn / 2, s1 + radius * turn / 2)
    shed = point(attach_rad + sense * turn, length - s2)
    valid = (turn > 0) & (distance[0] > radius) & (distance[1:] > radius)
    return CreepingRays(np.arange(len(turn)), attach, middle, shed, s1, s2, turn).take("ray", valid)


def _is_within_height(rays: CreepingRays, item: SceneObject) -> BoolArray:
    """Mask (ray,) of arcs that stay on the object from end to end."""
    heights = np.stack([rays.attach_m[:, 2], rays.shed_m[:, 2]])
    return np.asarray(((heights >= item.z_min_m) & (heights <= item.z_max_m)).all(axis=0))


def _is_strong(paths: Paths, carrier_hz: float) -> BoolArray:
    free_gain = 1 / (4 * np.pi * carrier_hz * paths.delay_s)
    return np.asarray(np.abs(paths.gain) > MIN_GAIN * free_gain)


def _is_clear(
    rays: CreepingRays, circle: Circle, scene: Scene, rx: FloatArray, faces: Occluders
) -> BoolArray:
    """Mask (ray,) of both tangents free and no other object at the middle of the arc."""

    def lifted(point: FloatArray) -> FloatArray:
        outward = np.pad((point[:, :2] - circle.center_m) / circle.radius_m, ((0, 0), (0, 1)))
        return np.asarray(point + 2 * OCCLUDER_SAGITTA_M * outward)

    tx = np.broadcast_to(scene.tx.position_m, rays.attach_m.shape)
    clear = scene.occupied(lifted(rays.middle_m)) < 0
    clear[clear] = ~blocked(faces, lifted(rays.attach_m)[clear], tx[clear])
    clear[clear] = ~blocked(faces, lifted(rays.shed_m)[clear], rx[rays.receiver[clear]])
    return np.asarray(clear)


def _paths(
    rays: CreepingRays,
    circle: Circle,
    index: int,
    scene: Scene,
    rx_positions_m: FloatArray,
    carrier_hz: float,
) -> Paths:
    """Gains, delays and directions of all rays, as one record."""
    rx, tx = rx_positions_m[rays.receiver], scene.tx.position_m
    level = rays.s1_m + circle.radius_m * rays.turn_rad + rays.s2_m
    length = np.hypot(level, rx[:, 2] - tx[2])
    aod_azimuth, aod_elevation = azimuth_elevation(rays.attach_m - tx)
    aoa_azimuth, aoa_elevation = azimuth_elevation(rays.shed_m - rx)
    wavelength = SPEED_OF_LIGHT_M_S / carrier_hz
    k_horizontal = 2 * np.pi / wavelength * level / length
    gain = creeping_gain(k_horizontal, circle.radius_m, rays.s1_m, rays.s2_m, rays.turn_rad, "soft")
    return Paths(
        gain=gain * wavelength / (4 * np.pi * length) * np.exp(-2j * np.pi * length / wavelength),
        delay_s=length / SPEED_OF_LIGHT_M_S,
        aod_azimuth_rad=aod_azimuth,
        aod_elevation_rad=aod_elevation,
        aoa_azimuth_rad=aoa_azimuth,
        aoa_elevation_rad=aoa_elevation,
        bounce_kind=np.full((len(length), 1), BounceKind.DIFFRACTION),
        bounce_object=np.full((len(length), 1), index),
        vertex_m=rays.middle_m[:, None],
        object_name=np.asarray(surface_names(scene), str),
    )
