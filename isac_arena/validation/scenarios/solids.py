"""Small scenes that the propagation checks draw at random, and helpers to compare path records."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scenes.contours import Circle, Contour, OpenSpline, Polygon, RoundedPolygon, rectangle
from scenes.objects.material import Material
from scenes.pose import Pose, direction
from scenes.record import FloatArray
from scenes.scene import HorizontalPlane, Scene, SceneObject
from scenes.walks.trajectory import Walk

CARRIER_HZ = 60e9
METAL = Material("metal", 1.0, 1e7, 0.002)
GLASS = Material("glass", 6.31, 0.9, 0.006, 0.2)
STONE = Material("stone", 5.24, 1.1, 0.2, 0.1)
HALL_M = 40.0


def scene_of(
    tx_m: Sequence[float] | FloatArray,
    contours: Sequence[Contour],
    materials: Sequence[Material] = (METAL,),
    *,
    height_m: float = 3.0,
    floor: bool = False,
) -> Scene:
    """A scene of prisms from the floor up, its materials used in turn; floor and ceiling of stone on request."""
    objects = tuple(
        SceneObject(f"object_{index}", "wall", contour, 0.0, height_m, materials[index % len(materials)])
        for index, contour in enumerate(contours)
    )
    far = Walk(np.array([[HALL_M - 1, HALL_M - 1]]), height_m / 2, 0.0)
    bounds = (-HALL_M, -HALL_M, HALL_M, HALL_M)
    levels = [HorizontalPlane(z, STONE) if floor else None for z in (0.0, height_m)]
    return Scene("check", objects, Pose(np.asarray(tx_m, float), 0.0), far, bounds, levels[0], levels[1])


def random_solids(rng: np.random.Generator) -> list[Contour]:
    """Three pillars, a box and a rounded block around the origin: they do not touch, and the middle is free."""
    turn = rng.uniform(0, 2 * np.pi)
    places = 3.5 * direction(turn + np.arange(5) * 2 * np.pi / 5 + rng.uniform(-0.2, 0.2, 5))[:, :2]
    places *= rng.uniform(0.85, 1.3, (5, 1))
    corners = np.array([(-0.6, -0.4), (0.6, -0.4), (0.6, 0.4), (-0.6, 0.4)])
    boxes = []
    for angle in rng.uniform(0, np.pi, 2):
        c, s = np.cos(angle), np.sin(angle)
        boxes.append(corners @ np.array([(c, s), (-s, c)]))
    pillars = [Circle(place, float(rng.uniform(0.15, 0.7))) for place in places[:3]]
    return [*pillars, Polygon(places[3] + boxes[0]), RoundedPolygon(places[4] + boxes[1], np.full(4, 0.3))]


def open_ring(radius_m: float = 2.0, opening_rad: float = 0.5, n_points: int = 40) -> OpenSpline:
    """A thin wall along most of a circle about the origin, open towards +x."""
    angle = np.linspace(opening_rad, 2 * np.pi - opening_rad, n_points)
    return OpenSpline(radius_m * direction(angle)[:, :2])


def wave_wall() -> OpenSpline:
    """A thin wall of three half waves."""
    points = [(-3, 0), (-2, 1.5), (-1, 0), (0, -1.5), (1, 0), (2, 1.5), (3, 0)]
    return OpenSpline(np.array(points, float))


def random_receivers(rng: np.random.Generator, scene: Scene, n: int, reach_m: float, z_m: float) -> FloatArray:
    """Positions (receiver, xyz) in a square about the origin, clear of all objects."""
    found: list[FloatArray] = []
    while len(found) < n:
        point = np.array([*rng.uniform(-reach_m, reach_m, 2), z_m])
        gap = min((float(item.contour.signed_distance(point[:2])) for item in scene.objects), default=1.0)
        if gap > 0.05 and np.linalg.norm(point - scene.tx.position_m) > 0.3:
            found.append(point)
    return np.array(found)


def box_walls(x_m: float, y_m: float) -> list[Contour]:
    """Four walls around the room 0..x, 0..y that do not overlap."""
    d = 0.2
    south, north = (rectangle((0.0, x_m), y) for y in ((-d, 0.0), (y_m, y_m + d)))
    east, west = (rectangle(x, (0.0, y_m)) for x in ((x_m, x_m + d), (-d, 0.0)))
    return [south, east, north, west]


def with_tx(scene: Scene, position_m: FloatArray) -> Scene:
    """The same scene with its TX elsewhere."""
    return replace(scene, tx=Pose(np.asarray(position_m, float), scene.tx.heading_rad))
