"""Objects of random halls as tables of a scene file: columns, partitions, boxes and racks in free places."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import shapely

from scenes.objects.config import ObjectConfig
from scenes.pose import direction
from scenes.record import FloatArray

CLEARANCE_M = 0.7  # between objects, and between objects and walls: a receiver can pass
COLUMN_HALF_M = (0.12, 0.5)  # half the width of columns
N_TRIES = 40  # random places tried for an object; after that it is omitted

Table = dict[str, Any]
Make = Callable[[np.random.Generator, FloatArray, float], list[Table]]

MATERIALS: dict[str, Table] = {
    name: {"itu": itu, "thickness_m": thickness_m, "scattering_coefficient": scattering}
    for name, itu, thickness_m, scattering in (
        ("concrete", "concrete", 0.2, 0.2),
        ("plasterboard", "plasterboard", 0.026, 0.15),
        ("glass", "glass", 0.012, 0.05),
        ("wood", "wood", 0.04, 0.2),
        ("chipboard", "chipboard", 0.02, 0.3),
        ("marble", "marble", 0.03, 0.1),
        ("metal", "metal", 0.002, 0.05),
        ("sheet_steel", "metal", 0.001, 0.25),
        ("ceiling_board", "ceiling_board", 0.02, 0.1),
        ("floorboard", "floorboard", 0.03, 0.1),
    )
}


class FreeSpace:
    """The part of a floor where objects and devices may still stand."""

    def __init__(self, floor: shapely.Geometry) -> None:
        self.area = floor.buffer(-CLEARANCE_M)

    def point(self, rng: np.random.Generator) -> FloatArray:
        """A random free point (xy,)."""
        low, high = np.reshape(self.area.bounds, (2, 2))
        while True:
            point = rng.uniform(low, high)
            if self.area.covers(shapely.Point(point)):
                return np.asarray(point)

    def place(self, rng: np.random.Generator, make: Make, height_m: float) -> list[Table]:
        """The tables of an object at a random free place, which it then occupies; none if no try succeeds."""
        for _ in range(N_TRIES):
            tables = make(rng, self.point(rng), height_m)
            body = shapely.union_all([contour_body(table) for table in tables])
            if self.area.covers(body):
                self.area = self.area.difference(body.convex_hull.buffer(CLEARANCE_M))
                return tables
        return []


def furnish(
    rng: np.random.Generator, free: FreeSpace, height_m: float, column_half_m: tuple[float, float] = COLUMN_HALF_M
) -> Iterator[Table]:
    """Tables of the objects of a room, large ones first; their number follows the size of the room.

    Half the width of columns is drawn from `column_half_m`.
    """
    room_m2 = float(free.area.area)
    for name, make, per_m2, most in (
        ("rack", rack, 0.005, 3),
        ("partition", partition, 0.01, 4),
        ("column", partial(column, half_m=column_half_m), 0.02, 9),
        ("box", box, 0.015, 6),
    ):
        for index in range(min(most, int(rng.poisson(per_m2 * room_m2)))):
            if free.area.area < room_m2 / 3:
                return
            for table in free.place(rng, make, height_m):
                yield {**table, "name": f"{name}_{index + 1}{table.get('name', '')}"}


def column(
    rng: np.random.Generator, center: FloatArray, height_m: float, half_m: tuple[float, float] = COLUMN_HALF_M
) -> list[Table]:
    """A column from floor to ceiling: round, elliptic, square, rounded or lobed."""
    half, turn = float(rng.uniform(*half_m)), float(rng.uniform(0, np.pi))
    corners = center + half * np.sqrt(2) * direction(turn + np.pi / 4 + np.arange(4) * np.pi / 2)[:, :2]
    angle = np.arange(16) * np.pi / 8
    lobes = half * (1 + 0.12 * np.cos(rng.integers(2, 5) * angle))
    shapes: list[Table] = [
        {"type": "circle", "center_m": center.tolist(), "radius_m": half},
        {
            "type": "ellipse",
            "center_m": center.tolist(),
            "semi_axes_m": [half, half * float(rng.uniform(0.5, 0.9))],
            "rotation_deg": float(np.rad2deg(turn)),
        },
        {"type": "polygon", "vertices_m": corners.tolist()},
        {
            "type": "polygon",
            "vertices_m": corners.tolist(),
            "corner_radius_m": 4 * [half * float(rng.uniform(0.2, 0.8))],
        },
        {"type": "closed_spline", "points_m": (center + lobes[:, None] * direction(turn + angle)[:, :2]).tolist()},
    ]
    shape = shapes[int(rng.choice(5, p=[0.35, 0.1, 0.35, 0.1, 0.1]))]
    return [_table("pillar", _any(rng, "concrete", "metal", "marble", "plasterboard"), 0.0, height_m, shape)]


def partition(rng: np.random.Generator, center: FloatArray, height_m: float) -> list[Table]:
    """A partition of full or half height: a straight sheet of glass, a curved one, or a thin wall."""
    along, turn = float(rng.uniform(1.0, 5.0)) / 2, _turn(rng)
    top = height_m if rng.random() < 0.6 else min(float(rng.uniform(1.3, 2.2)), height_m)
    kind = rng.random()
    if kind < 0.35:
        ends = _turned(center, turn, [(-along, 0.0), (along, 0.0)])
        return [_table("wall", "glass", 0.0, top, {"type": "polyline", "points_m": ends})]
    if kind < 0.45:
        bend = along * float(rng.uniform(0.1, 0.3))
        points = [(-along, 0.0), (-along / 2, 0.75 * bend), (0.0, bend), (along / 2, 0.75 * bend), (along, 0.0)]
        return [_table("wall", "glass", 0.0, top, {"type": "spline", "points_m": _turned(center, turn, points)})]
    contour = _block(center, turn, along, float(rng.uniform(0.03, 0.08)))
    return [_table("wall", _any(rng, "plasterboard", "wood", "chipboard"), 0.0, top, contour)]


def box(rng: np.random.Generator, center: FloatArray, height_m: float) -> list[Table]:
    """A crate, a cabinet or a machine."""
    contour = _block(center, _turn(rng), *rng.uniform(0.25, 1.0, 2).tolist())
    top = min(float(rng.uniform(0.6, 2.4)), height_m - 0.3)
    return [_table("box", _any(rng, "wood", "chipboard", "metal"), 0.0, top, contour)]


def rack(rng: np.random.Generator, center: FloatArray, height_m: float) -> list[Table]:
    """A rack along x or y: uprights, two decks, and goods on the floor and on the lower deck."""
    n_bays, bay, depth = int(rng.integers(1, 4)), float(rng.uniform(1.8, 3.0)), 1.0
    turn = float(rng.choice([0.0, np.pi / 2]))
    top = min(float(rng.uniform(2.4, 4.2)), height_m - 0.2)
    level, half, post = top / 2, n_bays * bay / 2, 0.05
    tables = []

    def add(
        name: str, material: str, z_m: tuple[float, float], middle: tuple[float, float], *half_m: float
    ) -> None:
        contour = _block(np.array(_turned(center, turn, [middle])[0]), turn, *half_m)
        kind = "box" if name.startswith("_goods") else "rack"
        tables.append({**_table(kind, material, *z_m, contour), "name": name})

    for side, across in (("front", -depth / 2 - post), ("back", depth / 2 + post)):
        for index in range(n_bays + 1):
            add(f"_upright_{side}_{index}", "metal", (0.0, top), (index * bay - half, across), post, post)
    add("_deck_1", "metal", (level, level + 0.1), (0.0, 0.0), half, depth / 2)
    add("_deck_2", "metal", (top - 0.4, top - 0.3), (0.0, 0.0), half, depth / 2)
    for shelf, low, room in (("floor", 0.1, level - 0.1), ("deck", level + 0.1, top - level - 0.5)):
        for index in range(n_bays):
            if rng.random() < 0.7:
                z_m = low, low + room * float(rng.uniform(0.5, 0.95))
                width = bay * float(rng.uniform(0.25, 0.45))
                middle = ((index + 0.5) * bay - half, 0.0)
                add(f"_goods_{shelf}_{index}", _any(rng, "wood", "chipboard"), z_m, middle, width, 0.45 * depth)
    return tables


def contour_body(table: Table) -> Any:
    """The body in plan view, a shapely geometry, of an object's table."""
    return ObjectConfig.model_validate({"name": "made", **table}).contour.build().body()


def _table(kind: str, material: str, z_min_m: float, z_max_m: float, contour: Table) -> Table:
    return {"kind": kind, "material": material, "z_min_m": z_min_m, "z_max_m": z_max_m, "contour": contour}


def _block(center: FloatArray, turn: float, along: float, across: float) -> Table:
    corners = [(-along, -across), (along, -across), (along, across), (-along, across)]
    return {"type": "polygon", "vertices_m": _turned(center, turn, corners)}


def _turned(center: FloatArray, turn: float, points: list[tuple[float, float]]) -> list[list[float]]:
    c, s = np.cos(turn), np.sin(turn)
    return [[float(center[0] + c * x - s * y), float(center[1] + s * x + c * y)] for x, y in points]


def _turn(rng: np.random.Generator) -> float:
    """Along x or along y, or one time in three at any angle."""
    return float(rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)]))


def _any(rng: np.random.Generator, *names: str) -> str:
    return str(rng.choice(names))
