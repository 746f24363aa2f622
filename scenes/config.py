"""Scene files: from TOML, angles in degrees, to a checked `Scene`."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from scenes.arguments import need
from scenes.contours import Circle, Contour, rectangle
from scenes.inputs import read_input
from scenes.motion.config import RecordedMotionConfig
from scenes.names import Name
from scenes.objects.clutter import Clutter
from scenes.objects.config import FloorplanConfig, MaterialConfig, MeshConfig, ObjectConfig, PlaneConfig, TxConfig
from scenes.objects.material import Material
from scenes.pose import Pose
from scenes.record import FloatArray
from scenes.references import copy_name, find_file
from scenes.scene import Scene, SceneObject
from scenes.targets.config import TargetConfig
from scenes.toml_config import ConfigError, ConfigModel, load_config, naming_field, read_text
from scenes.walks.config import (
    PosesWalkConfig,
    Quadruple,
    RandomWalkConfig,
    RecordedWalkConfig,
    WalkConfig,
    WaypointWalkConfig,
)
from scenes.walks.trajectory import AnyWalk

LIBRARY = Path(__file__).parent / "library"
MIN_DISTANCE_M = 0.05  # between TX and RX: nearer points are not in the far field
DEFAULT_MARGIN_M = 1.0  # default bounds: this margin around all objects and stops
FAR_OUT = 10.0  # times the longer side of the bounds: what reaches farther out of them is in another unit

GIVEN_WALKS = (WaypointWalkConfig, RecordedWalkConfig, PosesWalkConfig)

Bounds = tuple[float, float, float, float]


class SceneConfig(ConfigModel):
    """A scene file: one `tx` or several `txs`, one `walk` or several `walks`. The first of each is active."""

    name: Name = Field(description="name of the scene")
    base: str | None = Field(
        None, description="scene of the library that this one adds to: its tables are taken, lists are appended"
    )
    description: str = Field("", description="one sentence for people")
    bounds_m: Quadruple | None = Field(
        None, description="x_min, y_min, x_max, y_max of floor and ceiling; by default 1 m round everything"
    )
    tx: TxConfig | None = None
    txs: Annotated[tuple[TxConfig, ...], Field(strict=False)] = ()
    walk: WalkConfig | None = None
    walks: Annotated[tuple[WalkConfig, ...], Field(strict=False)] = ()
    materials: dict[str, MaterialConfig]
    floor: PlaneConfig | None = None
    ceiling: PlaneConfig | None = None
    objects: Annotated[tuple[ObjectConfig, ...], Field(strict=False)] = ()
    floorplans: Annotated[tuple[FloorplanConfig, ...], Field(strict=False)] = ()
    meshes: Annotated[tuple[MeshConfig, ...], Field(strict=False)] = ()
    targets: Annotated[tuple[TargetConfig, ...], Field(strict=False)] = ()

    @model_validator(mode="before")
    @classmethod
    def _on_base(cls, tables: Any) -> Any:
        return with_base(tables) if isinstance(tables, dict) else tables

    @model_validator(mode="after")
    def _one_or_several(self) -> SceneConfig:
        for one, several in (("tx", "txs"), ("walk", "walks")):
            if (getattr(self, one) is None) == (not getattr(self, several)):
                raise ValueError(f"{one}: give either one [{one}] or one or more [[{several}]]")
            names = Counter(item.name for item in getattr(self, several))
            repeated = [name for name, count in names.items() if count > 1]
            if repeated:
                raise ValueError(f"{several}: the name '{repeated[0]}' is given twice; each needs its own")
        return self

    def build(self, frequency_hz: float, folder: Path = Path()) -> Scene:
        """The checked scene, with its materials at the carrier. A `ValueError` names the field.

        `folder` holds the floor plans and meshes.
        """
        materials: dict[str, Material] = {}
        for name, material in self.materials.items():
            with naming_field(f"materials.{name}"):
                materials[name] = material.build(name, frequency_hz)
        objects = [item.build(materials, folder) for item in self.objects]
        fields = [f"objects[{item.name}]" for item in self.objects]
        notices: list[str] = []
        for plan in self.floorplans:
            walls, notice = plan.build(materials, folder)
            notices += [notice] if notice else []
            fields += [f"floorplans[{plan.given_name}].{plan.file}: wall {item.name}" for item in walls]
            objects += walls
        clutter = [item.build(materials, folder) for item in self.meshes]
        fields += [f"meshes[{item.name}]" for item in clutter]
        if self.bounds_m is not None:
            _check_near(self.bounds_m, dict(zip(fields, [*objects, *clutter], strict=True)))
        objects += [item.build(folder) for item in self.targets]
        given = dict(self._given_walks(folder))
        bounds = self.bounds_m or self._bounds_round(objects, clutter, given.values())
        walks = given | dict(self._random_walks(objects, clutter, bounds))
        walks = {item.name: walks[item.name] for item in self._walk_configs}
        txs = {item.name: item.build() for item in self._tx_configs}
        _check_places(bounds, txs, walks)
        moving = {item.name: item.build_motion(folder) for item in self._tx_configs}
        tx_name, walk_name = next(iter(txs)), next(iter(walks))
        planes = {}
        for name in ("floor", "ceiling"):
            plane = getattr(self, name)
            with naming_field(name):
                planes[name] = None if plane is None else plane.build(materials)
        return Scene(
            name=self.name,
            objects=tuple(objects),
            tx=txs.pop(tx_name),
            walk=walks.pop(walk_name),
            bounds_m=bounds,
            clutter=tuple(clutter),
            tx_name=tx_name,
            walk_name=walk_name,
            other_txs=txs,
            other_walks=walks,
            tx_motions={name: motion for name, motion in moving.items() if motion is not None},
            notices=tuple(notices),
            **planes,
        )

    @property
    def _tx_configs(self) -> Sequence[TxConfig]:
        return self.txs if self.tx is None else (self.tx,)

    @property
    def _walk_configs(self) -> Sequence[WalkConfig]:
        return self.walks if self.walk is None else (self.walk,)

    def _given_walks(self, folder: Path) -> Iterator[tuple[str, AnyWalk]]:
        """Names and walks that are given in the scene file or in a trajectory file."""
        for item in self._walk_configs:
            if isinstance(item, GIVEN_WALKS):
                with naming_field(self.walk_field(item.name)):
                    yield item.name, _timed(item, item.build(folder))

    def _random_walks(
        self, objects: Sequence[SceneObject], clutter: Sequence[Clutter], bounds_m: Bounds
    ) -> Iterator[tuple[str, AnyWalk]]:
        """Names and walks, grids and drops. They avoid objects and meshes that reach down to the height of the RX.

        Grids and drops also avoid every TX.
        """
        for item in self._walk_configs:
            if not isinstance(item, GIVEN_WALKS):
                obstacles = [one.contour for one in objects if one.z_min_m <= item.height_m]
                obstacles += [_footprint(one) for one in clutter if one.bounds_m[0][2] <= item.height_m]
                if not isinstance(item, RandomWalkConfig):
                    obstacles += [Circle(np.array(tx.position_m[:2]), MIN_DISTANCE_M) for tx in self._tx_configs]
                with naming_field(self.walk_field(item.name)):
                    yield item.name, _timed(item, item.build(obstacles, bounds_m))

    def walk_field(self, name: str) -> str:
        """The field of the walk of that name."""
        return f"walks[{name}]" if self.walks else "walk"

    def _bounds_round(
        self, objects: Sequence[SceneObject], clutter: Sequence[Clutter], walks: Iterable[AnyWalk]
    ) -> Bounds:
        """Bounds that hold all objects, TXs and walks, with a margin."""
        points: list[FloatArray] = [np.reshape(item.contour.bounds_m, (2, 2)) for item in objects]
        points += [np.array(item.bounds_m)[:, :2] for item in clutter]
        points += [np.array([item.position_m[:2]]) for item in self._tx_configs]
        points += [walk.line_m() for walk in walks]
        every = np.concatenate(points)
        low, high = every.min(axis=0) - DEFAULT_MARGIN_M, every.max(axis=0) + DEFAULT_MARGIN_M
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _timed(config: WalkConfig, walk: AnyWalk) -> AnyWalk:
    """A walk with the speed and the times of its settings."""
    return replace(walk, speed_m_s=config.speed_m_s, stop_interval_s=config.stop_interval_s)


def _check_near(bounds_m: Bounds, solids: Mapping[str, SceneObject | Clutter]) -> None:
    """`ValueError` if one of the solids, by its field, reaches so far out of the bounds that its unit is wrong."""
    low, high = np.array(bounds_m[:2]), np.array(bounds_m[2:])
    for field, item in solids.items():
        item_low, item_high = (corner[:2] for corner in item.bounds_m)
        if max(*(low - item_low), *(item_high - high)) > FAR_OUT * (high - low).max() > 0:
            reach = " to ".join("({:.6g}, {:.6g})".format(*corner) for corner in (item_low, item_high))
            hint = f"; {item.unit_hint}" if isinstance(item, Clutter) else ""
            near = f"must lie in or near bounds_m = {list(bounds_m)}, all in metres"
            raise ValueError(f"{field} reaches from {reach}: {near}{hint}")


def _check_places(bounds_m: Bounds, txs: Mapping[str, Pose], walks: Mapping[str, AnyWalk]) -> None:
    """`ValueError` if the bounds are reversed, a device stands outside them, or an RX stop is too near a TX."""
    low, high = np.array(bounds_m[:2]), np.array(bounds_m[2:])
    if not (low < high).all():
        raise ValueError(f"bounds_m = {list(bounds_m)}: must be [x_min, y_min, x_max, y_max], each min below max")
    places = {f"TX '{name}'": tx.position_m[None] for name, tx in txs.items()}
    places |= {f"walk '{name}'": walk.positions_m() for name, walk in walks.items()}
    for name, points_m in places.items():
        outside = ((points_m[:, :2] < low) | (points_m[:, :2] > high)).any(axis=1)
        if outside.any():
            at = points_m[np.argmax(outside), :2].tolist()
            raise ValueError(f"{name} at {at} m: must lie within bounds_m = {list(bounds_m)}")
    for name, walk in walks.items():
        for tx in txs.values():
            distance = np.linalg.norm(walk.positions_m() - tx.position_m, axis=1)
            if (distance < MIN_DISTANCE_M).any():
                stop = int(np.argmin(distance))
                raise ValueError(f"walk '{name}', stop {stop}: must be {MIN_DISTANCE_M} m or more from the TX")


def with_base(tables: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of a scene file together with those of its base, without naming it.

    Raises `ConfigError` where the library has no such scene.
    """
    whole = dict(tables)
    base = whole.pop("base", None)
    if base is None:
        return whole
    if base not in library_scenes():
        raise ConfigError(f"base = '{base}': must be one of {', '.join(library_scenes())}")
    below = with_base(tomllib.loads(read_text(LIBRARY / f"{base}.toml")))
    for name, value in below.items():
        match value, whole.get(name):
            case _, None:
                whole[name] = value
            case list(), list() as given:
                whole[name] = [*value, *given]
            case dict(), dict() as given:
                whole[name] = value | given
    return whole


def library_scenes() -> list[str]:
    """Names of the scenes that come with the project."""
    return sorted(path.stem for path in LIBRARY.glob("*.toml"))


def scene_path(name_or_path: str | Path) -> Path:
    """The file of a scene: one of the library by name, or a path that ends in .toml.

    Raises `ConfigError` where there is no scene of that name.
    """
    path = Path(name_or_path)
    if path.suffix == ".toml":
        return path
    if str(name_or_path) not in library_scenes():
        known = ", ".join(library_scenes())
        raise ConfigError(f"scene = '{name_or_path}': must be one of {known}, or the path of a .toml file")
    return LIBRARY / f"{name_or_path}.toml"


def load_scene(name_or_path: str | Path, frequency_hz: float = 60e9) -> Scene:
    """A scene of the library by name, or one from a TOML file (a path that ends in .toml).

    Raises `ConfigError`: one line with file, field, value and the allowed values.
    """
    need("name_or_path", name_or_path, str, Path)
    path = scene_path(name_or_path)
    config = load_config(path, SceneConfig)
    with naming_field(str(path), ": "):
        return config.build(frequency_hz, path.parent)


def referenced_contents(config: SceneConfig, folder: Path) -> dict[str, bytes]:
    """Contents of all files that a scene file in `folder` refers to, by the name of their copies.

    These are floor plans, meshes, walks and motions. A copied scene file needs these copies in its folder: see
    `scenes.references.find_file`. Raises `ConfigError` with the field of a file that cannot be read.
    """
    named = [(f"floorplans[{item.given_name}]", item.file) for item in config.floorplans]
    named += [(f"meshes[{item.given_name}]", item.file) for item in config.meshes]
    walks = [item for item in config._walk_configs if isinstance(item, RecordedWalkConfig | PosesWalkConfig)]
    named += [(config.walk_field(item.name), item.file) for item in walks if item.file is not None]
    moving = [(f"objects[{item.name}]", item.motion) for item in config.objects]
    moving += [(f"meshes[{item.given_name}]", item.motion) for item in config.meshes]
    moving += [(f"targets[{item.name}]", item.motion) for item in config.targets]
    moving += [(f"tx '{item.name}'", item.motion) for item in config._tx_configs]
    named += [
        (f"{field}.motion", motion.file) for field, motion in moving if isinstance(motion, RecordedMotionConfig)
    ]
    return {copy_name(file): _content(field, folder, file) for field, file in named}


def _content(field: str, folder: Path, file: str) -> bytes:
    """The bytes of the file that a field names; `ConfigError` where it cannot be read."""
    try:
        return read_input(find_file(folder, file))
    except OSError as error:
        raise ConfigError(f"{field}.file = '{file}': cannot be read ({error.strerror})") from error


def _footprint(item: Clutter) -> Contour:
    """Bounding rectangle of a mesh in plan view."""
    low, high = item.bounds_m
    return rectangle((float(low[0]), float(high[0])), (float(low[1]), float(high[1])))
