"""The scene: objects (vertical prisms), clutter, floor, ceiling, the TX and the walk of the RX."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from scenes.display import Displayed
from scenes.objects.clutter import Clutter
from scenes.objects.material import Material
from scenes.objects.scene_object import OBJECT_KINDS, ObjectKind, SceneObject, check_overlaps
from scenes.pose import Pose
from scenes.record import IntArray
from scenes.walks.trajectory import AnyWalk, RecordedWalk

__all__ = ["OBJECT_KINDS", "HorizontalPlane", "ObjectKind", "Scene", "SceneObject"]

THIN_WALL_CLEARANCE_M = 0.01  # a device closer to a thin wall than this counts as inside it


@dataclass(frozen=True)
class HorizontalPlane:
    """Floor or ceiling: a horizontal rectangle over the bounds of the scene."""

    z_m: float
    material: Material


@dataclass(frozen=True, repr=False)
class Scene(Displayed):
    """The world of one campaign.

    `bounds_m` is (x_min, y_min, x_max, y_max), the extent of floor and ceiling. A scene may have several TXs
    and several walks: `tx` and `walk` are the active ones, `choose` selects others.

    Raises `ValueError` if two objects share a name, the ceiling is not above the floor, solids overlap without
    `may_overlap`, or a TX or an RX stop lies inside an object, on a thin wall, or not between floor and ceiling.
    """

    name: str
    objects: tuple[SceneObject, ...]
    tx: Pose
    walk: AnyWalk
    bounds_m: tuple[float, float, float, float]
    floor: HorizontalPlane | None = None
    ceiling: HorizontalPlane | None = None
    clutter: tuple[Clutter, ...] = ()
    tx_name: str = "tx"
    walk_name: str = "walk"
    other_txs: Mapping[str, Pose] = field(default_factory=dict)
    other_walks: Mapping[str, AnyWalk] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._check_names()
        if self.floor and self.ceiling and not self.floor.z_m < self.ceiling.z_m:
            raise ValueError(f"ceiling.z_m = {self.ceiling.z_m}: must lie above floor.z_m = {self.floor.z_m}")
        check_overlaps(self.objects)
        for name, tx in self.txs.items():
            label = f"TX '{name}'" if self.other_txs else "TX"
            self._check_free([label], tx.position_m[None, :])
        for name, walk in self.walks.items():
            label = f"RX stop {{}} of walk '{name}'" if self.other_walks else "RX stop {}"
            stops = walk.positions_m()
            self._check_free([label.format(index) for index in range(len(stops))], stops)

    def __repr__(self) -> str:
        return f"Scene({self.name!r}: {len(self.objects) + len(self.clutter)} objects, {len(self.stops)} stops)"

    @property
    def object_names(self) -> list[str]:
        """Names of all prisms in order, without floor, ceiling and clutter."""
        return [item.name for item in self.objects]

    @property
    def materials(self) -> dict[str, Material]:
        """Material by name: all objects in order, then 'floor' and 'ceiling' if present, then the clutter."""
        result = {item.name: item.material for item in self.objects}
        for name, plane in (("floor", self.floor), ("ceiling", self.ceiling)):
            if plane is not None:
                result[name] = plane.material
        return result | {item.name: item.material for item in self.clutter}

    @property
    def kinds(self) -> dict[str, str]:
        """Kind by name of all objects and the clutter."""
        return {item.name: item.kind for item in self.objects} | {item.name: item.kind for item in self.clutter}

    @property
    def stops(self) -> tuple[Pose, ...]:
        """RX pose at each stop of the walk."""
        return self.walk.poses()

    @property
    def txs(self) -> dict[str, Pose]:
        """Every TX by name, the active one first."""
        return {self.tx_name: self.tx, **self.other_txs}

    @property
    def walks(self) -> dict[str, AnyWalk]:
        """Every walk by name, the active one first."""
        return {self.walk_name: self.walk, **self.other_walks}

    def choose(self, tx: str | int = 0, walk: str | int | Sequence[str] = 0) -> Scene:
        """The same scene with another active TX and walk, given by name or by index in `txs` and `walks`.

        Several walks become one with the stops of each in turn, named NAME+NAME.

        Raises `ValueError` with a list of the names if there is no such TX or walk.
        """
        txs, walks = self.txs, self.walks
        if not isinstance(walk, str | int):
            parts = [walks[_chosen("walk", name, walks)] for name in walk]
            walk = "+".join(walk)
            walks[walk] = RecordedWalk(
                np.concatenate([part.positions_m() for part in parts]),
                np.concatenate([part.headings_rad() for part in parts]),
            )
        tx_name, walk_name = _chosen("tx", tx, txs), _chosen("walk", walk, walks)
        return replace(
            self,
            tx=txs.pop(tx_name), tx_name=tx_name, other_txs=txs,
            walk=walks.pop(walk_name), walk_name=walk_name, other_walks=walks,
        )  # fmt: skip

    def object(self, name: str) -> SceneObject:
        """The object of that name; a `ValueError` lists the names if there is none."""
        for item in self.objects:
            if item.name == name:
                return item
        raise ValueError(f"object = '{name}': must be one of {', '.join(self.object_names)}")

    def object_index_at(self, points_m: Any) -> IntArray:
        """Index (...) of the first object that contains each point (..., xyz); -1 for none.

        The boundary belongs to a solid. A thin wall contains the points within 1 cm of it.
        """
        points = np.asarray(points_m, float)
        found = np.full(points.shape[:-1], -1)
        for index, item in reversed(list(enumerate(self.objects))):
            reach = 0.0 if item.contour.closed else THIN_WALL_CLEARANCE_M
            inside = item.contour.signed_distance(points[..., :2]) <= reach
            inside &= (points[..., 2] >= item.z_min_m) & (points[..., 2] <= item.z_max_m)
            found[inside] = index
        return found

    def _check_names(self) -> None:
        names = [*self.object_names, *(item.name for item in self.clutter)]
        repeated = [name for name, count in Counter(names).items() if count > 1]
        if repeated:
            raise ValueError(f"objects: the name '{repeated[0]}' is given twice; every object needs its own")
        for field_name, name, others in (
            ("tx", self.tx_name, self.other_txs),
            ("walk", self.walk_name, self.other_walks),
        ):
            if name in others:
                raise ValueError(f"{field_name}s: the name '{name}' is given twice; every one needs its own")

    def _check_free(self, labels: list[str], points_m: Any) -> None:
        z_low = self.floor.z_m if self.floor else -np.inf
        z_high = self.ceiling.z_m if self.ceiling else np.inf
        for label, point, index in zip(labels, points_m, self.object_index_at(points_m), strict=True):
            place = f"{label} at ({point[0]:.3f}, {point[1]:.3f}, {point[2]:.3f}) m"
            if index >= 0:
                raise ValueError(f"{place} lies inside object '{self.objects[index].name}': move one of them")
            if not z_low < point[2] < z_high:
                raise ValueError(f"{place} must lie between floor and ceiling, z {z_low:g} to {z_high:g} m")
        for item in self.clutter:
            for label, point, inside in zip(labels, points_m, item.contains(points_m), strict=True):
                if inside:
                    place = f"{label} at ({point[0]:.3f}, {point[1]:.3f}, {point[2]:.3f}) m"
                    raise ValueError(f"{place} lies inside mesh '{item.name}': move one of them")


def _chosen(kind: str, wanted: str | int, known: Mapping[str, object]) -> str:
    names = list(known)
    if isinstance(wanted, int) and 0 <= wanted < len(names):
        return names[wanted]
    if wanted not in names:
        raise ValueError(f"{kind} = {wanted!r}: must be one of {', '.join(names)}")
    return str(wanted)
