"""Scene files: from TOML, angles in degrees, to a checked `Scene`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from scenes.contour import Circle, Contour, OpenSpline, Polygon, Polyline, RoundedPolygon, rectangle
from scenes.material import Material, itu_material
from scenes.pose import Pose
from scenes.scene import HorizontalPlane, ObjectKind, Scene, SceneObject
from scenes.toml_config import ConfigError, ConfigModel, Pair, load_config
from scenes.trajectory import Walk

LIBRARY = Path(__file__).parent / "library"
DEFAULT_MARGIN_M = 1.0  # of the bounds round all objects and stops where the file gives none

Triple = Annotated[tuple[float, float, float], Field(strict=False)]
Quadruple = Annotated[tuple[float, float, float, float], Field(strict=False)]
Points = Annotated[tuple[Pair, ...], Field(strict=False, min_length=1)]
Positive = Annotated[float, Field(gt=0)]


class CircleConfig(ConfigModel):
    """A round contour."""

    type: Literal["circle"]
    center_m: Pair
    radius_m: Positive

    def build(self) -> Contour:
        """The contour."""
        return Circle(np.array(self.center_m), self.radius_m)


class RectangleConfig(ConfigModel):
    """An axis-parallel rectangle between two x and two y coordinates."""

    type: Literal["rectangle"]
    x_m: Pair
    y_m: Pair

    def build(self) -> Contour:
        """The contour."""
        return rectangle(self.x_m, self.y_m)


class PolygonConfig(ConfigModel):
    """A polygon; `corner_radius_m` gives each corner its rounding (all sharp where it is left out)."""

    type: Literal["polygon"]
    vertices_m: Points
    corner_radius_m: Annotated[tuple[float, ...], Field(strict=False)] | None = None

    @model_validator(mode="after")
    def _one_radius_per_vertex(self) -> PolygonConfig:
        n_radii = len(self.vertices_m) if self.corner_radius_m is None else len(self.corner_radius_m)
        if n_radii != len(self.vertices_m):
            raise ValueError(
                f"corner_radius_m has {n_radii} entries: one per vertex is needed, {len(self.vertices_m)}"
            )
        return self

    def build(self) -> Contour:
        """The contour."""
        if self.corner_radius_m is None:
            return Polygon(np.array(self.vertices_m))
        return RoundedPolygon(np.array(self.vertices_m), np.array(self.corner_radius_m))


class PolylineConfig(ConfigModel):
    """An open thin wall of straight pieces."""

    type: Literal["polyline"]
    points_m: Points

    def build(self) -> Contour:
        """The contour."""
        return Polyline(np.array(self.points_m))


class SplineConfig(ConfigModel):
    """An open thin curved wall through points."""

    type: Literal["spline"]
    points_m: Points

    def build(self) -> Contour:
        """The contour."""
        return OpenSpline(np.array(self.points_m))


ContourConfig = Annotated[
    CircleConfig | RectangleConfig | PolygonConfig | PolylineConfig | SplineConfig,
    Field(discriminator="type"),
]


class MaterialConfig(ConfigModel):
    """A material: `itu` names a row of ITU-R P.2040-3, or both electrical constants are given."""

    itu: str | None = None
    relative_permittivity: Annotated[float, Field(ge=1)] | None = None
    conductivity_s_m: Annotated[float, Field(ge=0)] | None = None
    thickness_m: Positive
    scattering_coefficient: Annotated[float, Field(ge=0, le=1)] = 0.0

    @model_validator(mode="after")
    def _itu_or_custom(self) -> MaterialConfig:
        custom = (self.relative_permittivity, self.conductivity_s_m)
        if (self.itu is None) == (None in custom) or (self.itu is not None and custom != (None, None)):
            raise ValueError("itu: give either itu or both relative_permittivity and conductivity_s_m")
        return self

    def build(self, name: str, frequency_hz: float) -> Material:
        """The material with its constants at the carrier."""
        if self.itu is not None:
            return itu_material(
                self.itu,
                frequency_hz,
                name=name,
                thickness_m=self.thickness_m,
                scattering_coefficient=self.scattering_coefficient,
            )
        assert self.relative_permittivity is not None and self.conductivity_s_m is not None
        return Material(
            name,
            self.relative_permittivity,
            self.conductivity_s_m,
            self.thickness_m,
            self.scattering_coefficient,
        )


class ObjectConfig(ConfigModel):
    """One prism of the scene."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
    kind: ObjectKind
    material: str
    z_min_m: float = 0.0
    z_max_m: float
    contour: ContourConfig


class PlaneConfig(ConfigModel):
    """Floor or ceiling."""

    z_m: float
    material: str


class TxConfig(ConfigModel):
    """Where the transmitter stands and looks."""

    position_m: Triple
    heading_deg: float = 0.0


class WalkConfig(ConfigModel):
    """The walk of the RX; without `n_stops` the way-points are the stops, without `heading_deg` it looks ahead."""

    waypoints_m: Points
    height_m: float
    n_stops: Annotated[int, Field(ge=1)] | None = None
    heading_deg: float | None = None

    def build(self) -> Walk:
        """The walk, angles in radians."""
        heading = np.nan if self.heading_deg is None else float(np.deg2rad(self.heading_deg))
        return Walk(np.array(self.waypoints_m), self.height_m, heading, self.n_stops)


class SceneConfig(ConfigModel):
    """A scene file."""

    name: str
    description: str = ""
    bounds_m: Quadruple | None = None
    tx: TxConfig
    walk: WalkConfig
    materials: dict[str, MaterialConfig]
    floor: PlaneConfig | None = None
    ceiling: PlaneConfig | None = None
    objects: Annotated[tuple[ObjectConfig, ...], Field(strict=False)] = ()

    def build(self, frequency_hz: float) -> Scene:
        """The checked scene with its materials at the carrier; `ValueError` names the field."""
        materials: dict[str, Material] = {}
        for name, material in self.materials.items():
            with _field(f"materials.{name}"):
                materials[name] = material.build(name, frequency_hz)
        objects = tuple(_build_object(item, materials) for item in self.objects)
        with _field("walk"):
            walk = self.walk.build()
        return Scene(
            name=self.name,
            objects=objects,
            tx=Pose(np.array(self.tx.position_m), float(np.deg2rad(self.tx.heading_deg))),
            walk=walk,
            bounds_m=self.bounds_m or _bounds_round(objects, walk, self.tx),
            floor=_build_plane("floor", self.floor, materials),
            ceiling=_build_plane("ceiling", self.ceiling, materials),
        )


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

    Raises `ConfigError`, one line naming file, field, value and what is allowed.
    """
    path = scene_path(name_or_path)
    config = load_config(path, SceneConfig)
    with _field(str(path), ": "):
        return config.build(frequency_hz)


def _build_object(item: ObjectConfig, materials: dict[str, Material]) -> SceneObject:
    with _field(f"objects[{item.name}]"):
        material = _find_material(item.material, materials)
        with _field("contour"):
            contour = item.contour.build()
        return SceneObject(item.name, item.kind, contour, item.z_min_m, item.z_max_m, material)


def _build_plane(
    name: str, plane: PlaneConfig | None, materials: dict[str, Material]
) -> HorizontalPlane | None:
    if plane is None:
        return None
    with _field(name):
        return HorizontalPlane(plane.z_m, _find_material(plane.material, materials))


def _find_material(name: str, materials: dict[str, Material]) -> Material:
    if name not in materials:
        raise ValueError(f"material = '{name}': must be one of the materials given, {', '.join(materials)}")
    return materials[name]


def _bounds_round(
    objects: tuple[SceneObject, ...], walk: Walk, tx: TxConfig
) -> tuple[float, float, float, float]:
    points = [np.reshape(item.contour.bounds_m, (2, 2)) for item in objects]
    every = np.concatenate([*points, walk.waypoints_m, [tx.position_m[:2]]])
    (x_min, y_min), (x_max, y_max) = (
        every.min(axis=0) - DEFAULT_MARGIN_M,
        every.max(axis=0) + DEFAULT_MARGIN_M,
    )
    return float(x_min), float(y_min), float(x_max), float(y_max)


@contextmanager
def _field(path: str, joint: str = ".") -> Iterator[None]:
    """Put the path of the field in front of what a `ValueError` inside says."""
    try:
        yield
    except ValueError as error:
        raise ConfigError(f"{path}{joint}{error}") from error
