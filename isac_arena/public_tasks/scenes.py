"""The rooms of the tiers: from one pillar to halls in which people walk."""

from dataclasses import replace
from typing import Literal

import numpy as np
import shapely

from scenes.contours import Circle
from scenes.motion.motion import Motion
from scenes.objects.material import Material
from scenes.objects.scene_object import SceneObject
from scenes.pose import Pose
from scenes.random_arena import random_arena
from scenes.record import FloatArray
from scenes.scene import Scene
from sim.propagation.occlusion import sees_tx

Tier = Literal["pillar", "halls", "people"]
DIFFICULTY: dict[Tier, tuple[float, float]] = {"pillar": (0.0, 0.0), "halls": (0.3, 0.7), "people": (0.2, 0.5)}
N_PEOPLE, RADIUS_M, HEIGHT_M, SPEED_M_S = 2, 0.2, 1.75, 1.0
CLEAR_M = RADIUS_M + 0.1  # of a person's way from objects and devices
WALK_S = 2.0  # that a person walks; then it stands
N_TRIES = 200  # ways that are tried
# Skin at 60 GHz: Gabriel, Lau and Gabriel, Phys. Med. Biol. 41, 1996
SKIN = Material("skin", relative_permittivity=8.0, conductivity_s_m=36.0, thickness_m=0.1)


def task_scene(tier: Tier, rng: np.random.Generator, n_stops: int) -> Scene:
    """A random room of a tier."""
    scene = random_arena(rng, float(rng.uniform(*DIFFICULTY[tier])), n_stops)
    height_m = scene.walk.height_m  # of all devices: the beams are horizontal
    scene = replace(scene, tx=Pose(np.array([*scene.tx.position_m[:2], height_m]), scene.tx.heading_rad))
    if tier != "people":
        return scene
    taken = [item.contour.body() for item in scene.objects]
    taken += [shapely.Point(pose.position_m[:2]) for pose in (scene.tx, *scene.stops)]
    people = []
    for number in range(N_PEOPLE):
        way = _way(rng, scene, taken)
        if way is not None:
            taken.append(shapely.LineString(way))
            people.append(_person(f"person_{number + 1}", way))
    return replace(scene, objects=(*scene.objects, *people))


def n_seen(scene: Scene, time_s: FloatArray) -> int:
    """Stops that see the TX at their times (stop,), where people may stand between."""
    if not scene.is_moving:
        return int(sees_tx(scene).sum())
    return sum(bool(sees_tx(scene.at(float(now_s)))[stop]) for stop, now_s in enumerate(time_s))


def _way(rng: np.random.Generator, scene: Scene, taken: list[shapely.Geometry]) -> FloatArray | None:
    """Start and end (2, xy) of a straight way that is free; None where no try succeeds."""
    low, high = np.array(scene.bounds_m[:2]) + CLEAR_M, np.array(scene.bounds_m[2:]) - CLEAR_M
    for _ in range(N_TRIES):
        start, angle = rng.uniform(low, high), rng.uniform(0, 2 * np.pi)
        end = start + SPEED_M_S * WALK_S * np.array([np.cos(angle), np.sin(angle)])
        inside = np.all((end > low) & (end < high))
        if inside and np.all(shapely.distance(taken, shapely.LineString([start, end])) > 2 * CLEAR_M):
            return np.array([start, end])
    return None


def _person(name: str, way: FloatArray) -> SceneObject:
    """A person who walks from the start to the end of a way."""
    coefficient = np.zeros((1, 4, 4))
    coefficient[0, 2, :2] = (way[1] - way[0]) / WALK_S
    motion = Motion(np.array([0.0, WALK_S]), coefficient)
    return SceneObject(name, "clutter", Circle(way[0], RADIUS_M), 0.0, HEIGHT_M, SKIN, motion=motion)
