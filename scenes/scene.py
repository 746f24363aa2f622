"""The scene: objects (vertical prisms), clutter, floor, ceiling, the TX and the walk of the RX."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from scenes.display import Displayed
from scenes.motion.motion import AT_REST, BodyMotion, Motion, RigidState
from scenes.motion.placed import carried_points, moved_clutter, moved_object, moved_pose
from scenes.objects.clutter import Clutter
from scenes.objects.material import Material
from scenes.objects.scene_object import OBJECT_KINDS, ObjectKind, SceneObject, check_overlaps
from scenes.pose import Pose
from scenes.record import BoolArray, FloatArray, IntArray
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
    and several walks: `tx` and `walk` are the active ones, `choose` selects others. Objects, meshes and TXs stand
    where they are at time zero of the campaign; those with a motion move from there, see `at`. `notices` say, a
    sentence each, what is otherwise in the scene than in its files.

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
    tx_motions: Mapping[str, Motion] = field(default_factory=dict)
    notices: tuple[str, ...] = ()

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
            self._check_free([label.format(index) for index in range(len(stops))], stops, of_standing=True)

    def __repr__(self) -> str:
        return f"Scene({self.name!r}: {len(self.objects) + len(self.clutter)} objects, {len(self.stops)} stops)"

    @property
    def object_names(self) -> list[str]:
        """Names of all prisms in order, without floor, ceiling and clutter."""
        return [item.name for item in self.objects]

    @property
    def fixtures(self) -> tuple[SceneObject, ...]:
        """The objects that belong on a map: all but targets."""
        return tuple(item for item in self.objects if item.target is None)

    @property
    def has_targets(self) -> bool:
        """Whether there are targets."""
        return len(self.fixtures) < len(self.objects)

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
            if any(part.speed_m_s for part in parts):
                raise ValueError(f"walk = {walk}: walks with speed_m_s are not joined, choose one")
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

    @property
    def movers(self) -> dict[str, Motion]:
        """The motion of every object, mesh and of the active TX that moves, by name."""
        moving = {item.name: item.motion for item in self.objects if item.motion is not None}
        moving |= {item.name: item.motion for item in self.clutter if item.motion is not None}
        if self.tx_name in self.tx_motions:
            moving[f"TX '{self.tx_name}'"] = self.tx_motions[self.tx_name]
        return moving

    @property
    def is_moving(self) -> bool:
        """Whether an object, a mesh or the active TX moves, or the receiver walks while it sweeps."""
        return bool(self.movers) or self.walk.speed_m_s > 0

    @property
    def standing_tx(self) -> Pose:
        """The pose of a TX that stands. `ValueError` where it moves: mapping and SLAM take it at one place."""
        if self.tx_name in self.tx_motions:
            raise ValueError(
                "tx.motion: mapping and SLAM need a TX that stands; 'arena generate' makes its sweeps"
            )
        return self.tx

    def tx_at(self, time_s: float) -> Pose:
        """The nominal pose of the TX at a time of the campaign."""
        return self.at(time_s).tx if self.movers else self.tx

    def at(self, time_s: float) -> Scene:
        """The frozen scene at a time of the campaign: everything where its motion has brought it, at rest.

        Only the places change. `scenes.motion.collisions` looks for what drives through something.
        """
        frozen = copy.copy(self)
        txs = {
            name: moved_pose(tx, self.tx_motions[name].at(time_s)) if name in self.tx_motions else tx
            for name, tx in self.txs.items()
        }
        changes: dict[str, object] = {
            "objects": tuple(moved_object(item, time_s) for item in self.objects),
            "clutter": tuple(moved_clutter(item, time_s) for item in self.clutter),
            "tx": txs.pop(self.tx_name),
            "other_txs": txs,
            "tx_motions": {},
            "walk": replace(self.walk, speed_m_s=0.0),
        }
        for name, value in changes.items():
            object.__setattr__(frozen, name, value)
        return frozen

    def carried_points(self, body: IntArray, point_m: FloatArray, from_s: float, to_s: float) -> FloatArray:
        """Points (point, xyz) of bodies (point,), counted as in `bodies_at`, where they are at another time."""
        carried = np.array(point_m, float)
        n_planes = (self.floor is not None) + (self.ceiling is not None)
        first = len(self.objects) + n_planes
        moving = [(index, item.pivot_m, item.motion) for index, item in enumerate(self.objects) if item.motion]
        moving += [
            (index, item.pivot_m, item.motion) for index, item in enumerate(self.clutter, first) if item.motion
        ]
        for index, pivot_m, motion in moving:
            here = body == index
            carried[here] = carried_points(point_m[here], pivot_m, motion.at(from_s), motion.at(to_s))
        return carried

    def bodies_at(self, time_s: float, rx_position_m: FloatArray, rx_velocity_m_s: FloatArray) -> BodyMotion:
        """How bodies move at a time: objects, floor, ceiling, meshes (as paths count them), TX and receiver."""
        planes = [plane for plane in (self.floor, self.ceiling) if plane is not None]
        rest = (np.zeros(3), AT_REST)
        places = [
            *((item.pivot_m, item.motion.at(time_s)) if item.motion else rest for item in self.objects),
            *(rest for _ in planes),
            *((item.pivot_m, item.motion.at(time_s)) if item.motion else rest for item in self.clutter),
            (self.tx.position_m, _state(self.tx_motions.get(self.tx_name), time_s)),
            (rx_position_m, replace(AT_REST, velocity_m_s=rx_velocity_m_s)),
        ]
        return BodyMotion(
            np.array([pivot_m + state.shift_m for pivot_m, state in places]),
            np.array([state.velocity_m_s for _, state in places]),
            np.array([state.acceleration_m_s2 for _, state in places]),
            np.array([state.turn_rate_rad_s for _, state in places]),
            np.array([state.turn_acceleration_rad_s2 for _, state in places]),
        )

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

    def is_free(self, points_m: Any) -> BoolArray:
        """Whether each point (..., xyz) lies in no object and in no mesh."""
        points = np.asarray(points_m, float)
        free = self.object_index_at(points) < 0
        for mesh in self.clutter:
            free &= ~mesh.contains(points.reshape(-1, 3)).reshape(free.shape)
        return np.asarray(free)

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

    def _check_free(self, labels: list[str], points_m: Any, *, of_standing: bool = False) -> None:
        """Refuse points inside objects and meshes, or only inside those that stand."""
        z_low = self.floor.z_m if self.floor else -np.inf
        z_high = self.ceiling.z_m if self.ceiling else np.inf
        for label, point, index in zip(labels, points_m, self.object_index_at(points_m), strict=True):
            place = f"{label} at ({point[0]:.3f}, {point[1]:.3f}, {point[2]:.3f}) m"
            if index >= 0 and not (of_standing and self.objects[index].motion):
                raise ValueError(f"{place} lies inside object '{self.objects[index].name}': move one of them")
            if not z_low < point[2] < z_high:
                raise ValueError(f"{place} must lie between floor and ceiling, z {z_low:g} to {z_high:g} m")
        for item in self.clutter:
            for label, point, inside in zip(labels, points_m, item.contains(points_m), strict=True):
                if inside and not (of_standing and item.motion):
                    place = f"{label} at ({point[0]:.3f}, {point[1]:.3f}, {point[2]:.3f}) m"
                    size_m = float(np.subtract(*item.bounds_m[::-1]).max())
                    raise ValueError(
                        f"{place} lies inside mesh '{item.name}', which is {size_m:.3g} m large: "
                        "move one of them, or give the mesh a scale"
                    )


def _state(motion: Motion | None, time_s: float) -> RigidState:
    return AT_REST if motion is None else motion.at(time_s)


def _chosen(kind: str, wanted: str | int, known: Mapping[str, object]) -> str:
    names = list(known)
    if isinstance(wanted, int) and 0 <= wanted < len(names):
        return names[wanted]
    if wanted not in names:
        raise ValueError(f"{kind} = {wanted!r}: must be one of {', '.join(names)}")
    return str(wanted)
