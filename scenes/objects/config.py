"""Materials, objects, floor plans, meshes and devices in scene files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from scenes.contours import Polyline
from scenes.contours.config import ContourConfig, Positive
from scenes.meshes.floorplan import merge_segments, parse_geojson, parse_segments
from scenes.motion.config import MotionConfig, build_motion
from scenes.motion.motion import Motion
from scenes.names import FileName, Name, name_from
from scenes.objects.clutter import Clutter, placed_vertices
from scenes.objects.material import Material, itu_material
from scenes.pose import Pose
from scenes.references import find_file
from scenes.scene import HorizontalPlane, ObjectKind, SceneObject
from scenes.toml_config import ConfigModel, naming_field, read_text

MAX_WALLS = 50_000  # of a floor plan
THICKEST_M = 1.0  # slab: thicker ones are most likely in millimetres or centimetres

Triple = Annotated[tuple[float, float, float], Field(strict=False)]


class MaterialConfig(ConfigModel):
    """A material: either `itu`, a row of ITU-R P.2040-3, or both electrical constants."""

    itu: str | None = Field(
        None, description="row of ITU-R P.2040-3: concrete, glass, metal, plasterboard, wood, ..."
    )
    relative_permittivity: Annotated[float, Field(ge=1)] | None = Field(
        None, description="in place of itu: real part at the carrier"
    )
    conductivity_s_m: Annotated[float, Field(ge=0)] | None = Field(
        None, description="in place of itu: conductivity at the carrier"
    )
    thickness_m: Annotated[Positive, Field(le=THICKEST_M)] = Field(
        description="thickness of the slab behind every face"
    )
    scattering_coefficient: Annotated[float, Field(ge=0, le=1)] = Field(
        0.0, description="share of the reflected field that is scattered"
    )
    scattering_directivity: Annotated[int, Field(ge=1, le=100)] | None = Field(
        None, description="directivity of the scattering lobe; without it scattering is even"
    )

    @model_validator(mode="after")
    def _itu_or_custom(self) -> MaterialConfig:
        custom = (self.relative_permittivity, self.conductivity_s_m)
        if (self.itu is None) == (None in custom) or (self.itu is not None and custom != (None, None)):
            raise ValueError("itu: give either itu or both relative_permittivity and conductivity_s_m")
        return self

    def build(self, name: str, frequency_hz: float) -> Material:
        """The material with its constants at the carrier."""
        if self.itu is not None:
            material = itu_material(
                self.itu,
                frequency_hz,
                name=name,
                thickness_m=self.thickness_m,
                scattering_coefficient=self.scattering_coefficient,
            )
            return replace(material, scattering_directivity=self.scattering_directivity)
        assert self.relative_permittivity is not None and self.conductivity_s_m is not None
        return Material(
            name,
            self.relative_permittivity,
            self.conductivity_s_m,
            self.thickness_m,
            self.scattering_coefficient,
            scattering_directivity=self.scattering_directivity,
        )


class ObjectConfig(ConfigModel):
    """One prism of the scene."""

    name: Name = Field(description="name of the object")
    kind: ObjectKind = Field(description="what the object is called in scores and figures")
    material: str = Field(description="name of one of the materials")
    z_min_m: float = Field(0.0, description="lower end")
    z_max_m: float = Field(description="upper end")
    may_overlap: bool = Field(False, description="whether it may overlap other objects")
    contour: ContourConfig
    motion: MotionConfig | None = Field(None, description="how the object moves; by default it stands")

    def build(self, materials: dict[str, Material], folder: Path = Path()) -> SceneObject:
        """The object. A `ValueError` names the field. `folder` holds the file of its motion."""
        with naming_field(f"objects[{self.name}]"):
            material = find_material(self.material, materials)
            with naming_field("contour"):
                contour = self.contour.build()
            item = SceneObject(
                self.name, self.kind, contour, self.z_min_m, self.z_max_m, material, self.may_overlap
            )
            return replace(item, motion=build_motion(self.motion, folder, item.pivot_m))


class FloorplanConfig(ConfigModel):
    """Thin walls from a file in the folder of the scene file: CSV (x0_m,y0_m,x1_m,y1_m) or GeoJSON."""

    name: Name | None = Field(
        None, description="prefix of the names of the walls; by default the name of the file"
    )
    file: FileName = Field(description="CSV x0_m,y0_m,x1_m,y1_m or GeoJSON, beside the scene file")
    material: str = Field(description="name of one of the materials")
    kind: ObjectKind = Field("wall", description="what the walls are called in scores and figures")
    z_min_m: float = Field(0.0, description="lower end")
    z_max_m: float = Field(description="upper end")

    @property
    def given_name(self) -> str:
        """The name; by default that of the file."""
        return self.name or name_from(Path(self.file).stem)

    def build(self, materials: dict[str, Material], folder: Path) -> tuple[list[SceneObject], str]:
        """One object per straight wall, NAME_1, NAME_2, ..., and a notice where lines were merged, else empty."""
        name = self.given_name
        with naming_field(f"floorplans[{name}]"):
            material = find_material(self.material, materials)
            with naming_field(self.file, ": "):
                parse = parse_geojson if Path(self.file).suffix in (".geojson", ".json") else parse_segments
                segments = parse(read_text(find_file(folder, self.file)))
                walls = merge_segments(segments)
                if len(walls) > MAX_WALLS:
                    raise ValueError(f"{len(walls)} walls: at most {MAX_WALLS} are taken")
            objects = [
                SceneObject(f"{name}_{index}", self.kind, Polyline(wall), self.z_min_m, self.z_max_m, material)
                for index, wall in enumerate(walls, start=1)
            ]
        if len(walls) == len(segments):
            return objects, ""
        notice = f"floor plan {self.file}: {len(segments)} lines make {len(walls)} wall{'s' * (len(walls) > 1)}"
        return objects, f"{notice}, because lines that touch and lie on one straight line are one wall"


class MeshConfig(ConfigModel):
    """Clutter from a mesh file in the folder of the scene file: scaled, rotated about x, y, z, and moved."""

    name: Name | None = Field(None, description="name of the mesh; by default that of the file")
    file: FileName = Field(description="mesh that trimesh reads, z up (glTF: y up), beside the scene file")
    material: str = Field(description="name of one of the materials")
    kind: ObjectKind = Field("clutter", description="what the mesh is called in scores and figures")
    position_m: Triple = Field((0.0, 0.0, 0.0), description="x, y, z that the mesh is moved by")
    scale: Positive = Field(1.0, description="factor from the units of the file to m")
    rotation_deg: Triple = Field((0.0, 0.0, 0.0), description="rotation about x, then y, then z")
    motion: MotionConfig | None = Field(None, description="how the mesh moves; by default it stands")

    @property
    def given_name(self) -> str:
        """The name; by default that of the file."""
        return self.name or name_from(Path(self.file).stem)

    def build(self, materials: dict[str, Material], folder: Path) -> Clutter:
        """The mesh."""
        from scenes.meshes.mesh import read_mesh  # noqa: PLC0415

        name = self.given_name
        with naming_field(f"meshes[{name}]"):
            material = find_material(self.material, materials)
            vertices, faces = read_mesh(find_file(folder, self.file))
        vertices = placed_vertices(vertices, self.position_m, self.scale, np.deg2rad(self.rotation_deg).tolist())
        with naming_field(f"meshes[{name}]", ": "):
            item = Clutter(name, self.kind, material, vertices, faces, scale=self.scale)
        with naming_field(f"meshes[{name}]"):
            return replace(item, motion=build_motion(self.motion, folder, item.pivot_m))


class PlaneConfig(ConfigModel):
    """Floor or ceiling."""

    z_m: float = Field(description="height of the plane")
    material: str = Field(description="name of one of the materials")

    def build(self, materials: dict[str, Material]) -> HorizontalPlane:
        """The plane."""
        return HorizontalPlane(self.z_m, find_material(self.material, materials))


class TxConfig(ConfigModel):
    """Position and heading of a transmitter."""

    name: Name = Field("tx", description="name of the TX")
    position_m: Triple = Field(description="x, y, z of the array")
    heading_deg: float = Field(0.0, description="azimuth of the boresight, counter-clockwise from +x")
    motion: MotionConfig | None = Field(None, description="how the TX moves; by default it stands")

    def build(self) -> Pose:
        """The pose, its heading in radians."""
        return Pose(np.array(self.position_m), float(np.deg2rad(self.heading_deg)))

    def build_motion(self, folder: Path) -> Motion | None:
        """The motion; a `ValueError` names the field."""
        with naming_field(f"tx '{self.name}'"):
            return build_motion(self.motion, folder, np.array(self.position_m))


def find_material(name: str, materials: dict[str, Material]) -> Material:
    """The material of that name; a `ValueError` lists the names if there is none."""
    if name not in materials:
        raise ValueError(f"material = '{name}': must be one of the materials given, {', '.join(materials)}")
    return materials[name]
