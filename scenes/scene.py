"""The scene: objects as vertical prisms, floor and ceiling, the TX and the walk of the RX."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from scenes.contour import Contour
from scenes.material import Material
from scenes.pose import Pose
from scenes.record import IntArray
from scenes.trajectory import Walk

ObjectKind = Literal["wall", "pillar", "kiosk", "rail", "box", "polygon", "stairs"]
OBJECT_KINDS: tuple[str, ...] = get_args(ObjectKind)
THIN_WALL_CLEARANCE_M = 0.01  # a device closer to a thin wall than this stands on it


@dataclass(frozen=True)
class SceneObject:
    """A vertical prism: a contour from `z_min_m` to `z_max_m` in one material.

    A closed contour makes a solid, an open one a thin vertical sheet.
    """

    name: str
    kind: ObjectKind
    contour: Contour
    z_min_m: float
    z_max_m: float
    material: Material

    def __post_init__(self) -> None:
        if not self.name or self.name in ("floor", "ceiling"):
            raise ValueError(f"name = '{self.name}': must not be empty, 'floor' or 'ceiling'")
        if self.kind not in OBJECT_KINDS:
            raise ValueError(f"kind = '{self.kind}': must be one of {', '.join(OBJECT_KINDS)}")
        if not self.z_min_m < self.z_max_m:
            raise ValueError(f"z_max_m = {self.z_max_m}: must be greater than z_min_m = {self.z_min_m}")


@dataclass(frozen=True)
class HorizontalPlane:
    """Floor or ceiling: a horizontal rectangle over the bounds of the scene."""

    z_m: float
    material: Material


@dataclass(frozen=True)
class Scene:
    """The world of one campaign.

    `bounds_m` is (x_min, y_min, x_max, y_max), the extent of floor and ceiling.

    Raises
    ------
    ValueError
        Where two objects share a name, the ceiling is not above the floor, or the TX or an RX stop lies inside
        an object, on a thin wall, or not between floor and ceiling.
    """

    name: str
    objects: tuple[SceneObject, ...]
    tx: Pose
    walk: Walk
    bounds_m: tuple[float, float, float, float]
    floor: HorizontalPlane | None = None
    ceiling: HorizontalPlane | None = None

    def __post_init__(self) -> None:
        repeated = [name for name, count in Counter(item.name for item in self.objects).items() if count > 1]
        if repeated:
            raise ValueError(f"objects: the name '{repeated[0]}' is given twice; every object needs its own")
        if self.floor and self.ceiling and not self.floor.z_m < self.ceiling.z_m:
            raise ValueError(f"ceiling.z_m = {self.ceiling.z_m}: must lie above floor.z_m = {self.floor.z_m}")
        self._check_free(["TX"], self.tx.position_m[None, :])
        stops = self.walk.positions_m()
        self._check_free([f"RX stop {index}" for index in range(len(stops))], stops)

    @property
    def object_names(self) -> list[str]:
        """Names of all objects in order, without floor and ceiling."""
        return [item.name for item in self.objects]

    @property
    def stops(self) -> tuple[Pose, ...]:
        """RX pose at each stop of the walk."""
        return self.walk.poses()

    def object(self, name: str) -> SceneObject:
        """The object of that name; `ValueError` lists the names where there is none."""
        for item in self.objects:
            if item.name == name:
                return item
        raise ValueError(f"object = '{name}': must be one of {', '.join(self.object_names)}")

    def occupied(self, points_m: Any) -> IntArray:
        """Index (...) of the first object that holds each point (..., xyz), -1 where none does.

        A solid holds its boundary too; a thin wall holds what is within 1 cm of it.
        """
        points = np.asarray(points_m, float)
        found = np.full(points.shape[:-1], -1)
        for index, item in reversed(list(enumerate(self.objects))):
            reach = 0.0 if item.contour.closed else THIN_WALL_CLEARANCE_M
            inside = item.contour.signed_distance(points[..., :2]) <= reach
            inside &= (points[..., 2] >= item.z_min_m) & (points[..., 2] <= item.z_max_m)
            found[inside] = index
        return found

    def _check_free(self, labels: list[str], points_m: Any) -> None:
        z_low = self.floor.z_m if self.floor else -np.inf
        z_high = self.ceiling.z_m if self.ceiling else np.inf
        for label, point, index in zip(labels, points_m, self.occupied(points_m), strict=True):
            place = f"{label} at ({point[0]:.3f}, {point[1]:.3f}, {point[2]:.3f}) m"
            if index >= 0:
                raise ValueError(f"{place} lies inside object '{self.objects[index].name}': move one of them")
            if not z_low < point[2] < z_high:
                raise ValueError(f"{place} must lie between floor and ceiling, z {z_low:g} to {z_high:g} m")
