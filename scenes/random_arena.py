"""Random arenas: walled rooms with pillars, partitions and boxes, from empty to cluttered."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial

import numpy as np
import shapely

from scenes.arguments import need
from scenes.contours import Circle, ClosedSpline, Contour, Ellipse, Polygon, Polyline, RoundedPolygon, rectangle
from scenes.objects.material import Material, itu_material
from scenes.pose import Pose, direction
from scenes.record import FloatArray
from scenes.scene import HorizontalPlane, ObjectKind, Scene, SceneObject
from scenes.walks.random_walk import random_walk
from scenes.walks.trajectory import Walk

FREQUENCY_HZ = 60e9
WALL_M = 0.15
DEVICE_HEIGHT_M = 1.5
CLEARANCE_M = 0.4  # between any two objects inside the room, and between them and a device
N_TRIES = 60  # random places tried for an object, after which it is omitted, and starts of the walk
STEP_M = 0.6  # from stop to stop

Shape = tuple[ObjectKind, Contour, float, Material]  # the third entry is the height in m


def random_arena(rng: np.random.Generator, difficulty: float = 0.5, n_stops: int = 10) -> Scene:
    """A walled room with pillars of mixed shapes, partition walls and boxes, and a random walk among them.

    Parameters
    ----------
    difficulty : 0 is one pillar in an empty room of 8 m, 1 is about thirty objects in a hall of up to 26 m
    n_stops : RX stops of the walk

    Objects keep at least 0.4 m from each other, from the walls and from every device. An object without such a
    place is omitted. Raises `ValueError` if the difficulty lies outside [0, 1].
    """
    need("rng", rng, np.random.Generator)
    need("difficulty", difficulty, float, int)
    need("n_stops", n_stops, int)
    if not 0 <= difficulty <= 1:
        raise ValueError(f"difficulty = {difficulty}: must lie in [0, 1]")
    size = rng.uniform(8.0, 10.0 + 16.0 * difficulty, 2)
    height = float(rng.uniform(2.6, 3.2 + 2.0 * difficulty))
    materials = _materials()
    room = _room(size, height, rng.choice(["concrete", "plasterboard", "glass"], 4), materials)
    standing: list[SceneObject] = []
    for name, make in _wishes(rng, difficulty):
        shape = _placed(rng, make, size, height, materials, standing)
        if shape is not None:
            kind, contour, top, material = shape
            standing.append(SceneObject(name, kind, contour, 0.0, top, material))
    contours = [item.contour for item in standing]
    tx = _free_place(rng, size, contours)
    walk = _walk(rng, [*contours, Circle(tx, CLEARANCE_M)], size, n_stops)
    return _scene(rng, size, height, [*room, *standing], tx, walk, materials)


def _walk(rng: np.random.Generator, obstacles: list[Contour], size: FloatArray, n_stops: int) -> Walk:
    """A walk over the room; from another start where one ends between objects."""
    room = (0.0, 0.0, float(size[0]), float(size[1]))
    walk = partial(
        random_walk, rng, obstacles, area_m=room, n_stops=n_stops, step_m=STEP_M, height_m=DEVICE_HEIGHT_M,
        clearance_m=CLEARANCE_M,
    )  # fmt: skip
    for _ in range(N_TRIES):
        with suppress(ValueError):
            return walk()
    return walk()


def _scene(
    rng: np.random.Generator,
    size: FloatArray,
    height: float,
    objects: list[SceneObject],
    tx: FloatArray,
    walk: Walk,
    materials: dict[str, Material],
) -> Scene:
    to_middle = size / 2 - tx
    heading = float(np.arctan2(to_middle[1], to_middle[0]))
    tx_height = rng.uniform(DEVICE_HEIGHT_M, height - 0.4)
    return Scene(
        name="random_arena",
        objects=tuple(objects),
        tx=Pose(np.array([*tx, tx_height]), heading),
        walk=walk,
        bounds_m=(0.0, 0.0, float(size[0]), float(size[1])),
        floor=HorizontalPlane(0.0, materials["concrete"]),
        ceiling=HorizontalPlane(height, materials["ceiling_board"]),
    )


def _materials() -> dict[str, Material]:
    thickness_and_scattering = {
        "concrete": (0.2, 0.2),
        "plasterboard": (0.026, 0.15),
        "glass": (0.01, 0.05),
        "wood": (0.03, 0.2),
        "metal": (0.002, 0.05),
        "marble": (0.03, 0.1),
        "ceiling_board": (0.02, 0.1),
    }
    return {
        name: itu_material(name, FREQUENCY_HZ, thickness_m=thickness, scattering_coefficient=scattering)
        for name, (thickness, scattering) in thickness_and_scattering.items()
    }


def _room(
    size: FloatArray, height: float, material_names: FloatArray, materials: dict[str, Material]
) -> list[SceneObject]:
    """Four walls around the rectangle from 0 to size; they touch at the corners."""
    x, y = map(float, size)
    sides = {
        "wall_south": ((-WALL_M, x + WALL_M), (-WALL_M, 0.0)),
        "wall_east": ((x, x + WALL_M), (0.0, y)),
        "wall_north": ((-WALL_M, x + WALL_M), (y, y + WALL_M)),
        "wall_west": ((-WALL_M, 0.0), (0.0, y)),
    }
    return [
        SceneObject(side, "wall", rectangle(*extent), 0.0, height, materials[str(material)])
        for (side, extent), material in zip(sides.items(), material_names, strict=True)
    ]


Make = Callable[[np.random.Generator, FloatArray, float, dict[str, Material]], Shape]


def _wishes(rng: np.random.Generator, difficulty: float) -> Iterator[tuple[str, Make]]:
    """Names of the objects to place and the functions that make them, large objects first."""
    for kind, make, most in (("partition", _partition, 6), ("pillar", _pillar, 14), ("box", _box, 8)):
        least = 1 if kind == "pillar" else 0
        count = least + rng.binomial(most, 0.1 * least + 0.75 * difficulty) if difficulty > 0 else least
        for index in range(count):
            yield f"{kind}_{index + 1}", make


def _placed(
    rng: np.random.Generator,
    make: Make,
    size: FloatArray,
    height: float,
    materials: dict[str, Material],
    standing: list[SceneObject],
) -> Shape | None:
    """The first random shape that keeps its distance to walls and objects; None if no try succeeds."""
    free = shapely.box(0, 0, *size).buffer(-CLEARANCE_M)
    taken = [item.contour.body() for item in standing]
    for _ in range(N_TRIES):
        shape = make(rng, rng.uniform(CLEARANCE_M, size - CLEARANCE_M), height, materials)
        body = shape[1].body()
        if free.contains(body) and np.all(shapely.distance(taken, body) >= CLEARANCE_M):
            return shape
    return None


def _pillar(rng: np.random.Generator, center: FloatArray, height: float, materials: dict[str, Material]) -> Shape:
    half = float(rng.uniform(0.15, 0.45))
    turn = float(rng.uniform(0, np.pi))
    square = center + half * np.sqrt(2) * direction(turn + np.arange(4) * np.pi / 2)[:, :2]
    contour: Contour
    match int(rng.integers(5)):
        case 0:
            contour = Circle(center, half)
        case 1:
            contour = Ellipse(center, np.array([half, half * rng.uniform(0.4, 0.9)]), turn)
        case 2:
            contour = Polygon(square)
        case 3:
            contour = RoundedPolygon(square, np.full(4, half * rng.uniform(0.2, 0.8)))
        case _:
            lobes = half * (1 + 0.15 * np.cos(3 * np.arange(12) * np.pi / 6))
            contour = ClosedSpline(center + lobes[:, None] * direction(turn + np.arange(12) * np.pi / 6)[:, :2])
    return "pillar", contour, height, materials[str(rng.choice(["metal", "concrete", "marble"]))]


def _partition(
    rng: np.random.Generator, center: FloatArray, height: float, materials: dict[str, Material]
) -> Shape:
    """A straight wall, thick or thin, along x, along y or at a random angle."""
    along, across = float(rng.uniform(1.0, 4.0)) / 2, float(rng.uniform(0.05, 0.15)) / 2
    turn = float(rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)]))
    c, s = np.cos(turn), np.sin(turn)
    frame = np.array([(c, s), (-s, c)])
    if rng.random() < 0.3:
        thin = Polyline(center + np.array([(-along, 0), (along, 0)]) @ frame)
        return "wall", thin, height, materials["glass"]
    corners = np.array([(-along, -across), (along, -across), (along, across), (-along, across)]) @ frame
    material = materials[str(rng.choice(["plasterboard", "wood", "concrete"]))]
    return "wall", Polygon(center + corners), height, material


def _box(rng: np.random.Generator, center: FloatArray, height: float, materials: dict[str, Material]) -> Shape:
    half = rng.uniform(0.2, 0.7, 2)
    turn = float(rng.choice([0.0, rng.uniform(0, np.pi / 2)]))
    c, s = np.cos(turn), np.sin(turn)
    corners = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) @ np.array([(c, s), (-s, c)])
    top = float(min(rng.uniform(0.6, 2.2), height - 0.3))
    return "box", Polygon(center + corners), top, materials[str(rng.choice(["wood", "metal"]))]


def _free_place(rng: np.random.Generator, size: FloatArray, contours: list[Contour]) -> FloatArray:
    """A point (xy,) at least the clearance away from the walls and all objects."""
    while True:
        point = rng.uniform(CLEARANCE_M, size - CLEARANCE_M)
        if all(contour.signed_distance(point) >= CLEARANCE_M for contour in contours):
            return point
