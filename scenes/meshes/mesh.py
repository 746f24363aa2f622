"""Triangle meshes of a scene: vertical prisms, with separate facets for curved and flat pieces."""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import shapely
import trimesh

from scenes.contours import Contour
from scenes.inputs import check_input
from scenes.memory import MemoryLimitError, address_space
from scenes.names import path_in
from scenes.objects.material import Material
from scenes.objects.scene_object import KIND_COLORS
from scenes.record import FloatArray, IntArray
from scenes.scene import Scene, SceneObject

FORMATS: dict[str, tuple[str, ...]] = {  # and the packages that trimesh needs beside its own for them
    **dict.fromkeys((".obj", ".stl", ".ply", ".off", ".gltf", ".glb", ".zip"), ()),
    ".3mf": ("lxml", "networkx"),
    ".dae": ("collada",),
}
Y_UP = (".gltf", ".glb")  # glTF 2.0, clause 3.4: right-handed, y up
MAX_SAGITTA_M = 0.02
EXPORT_SAGITTA_M = 1e-3
PLANE_COLOR = "#d5d8dc"  # floor and ceiling of exported meshes
MITSUBA_VERSION = "2.1.0"
MITSUBA_PREFIX = "mat-arena-"  # Sionna reads names of ITU materials, and names with itu in front, as its own
MAX_TURN_RAD = 2 * np.pi / 24  # a thin round pillar has at least 24 facets


@dataclass(frozen=True)
class MeshPart:
    """The facets of the flat faces of one object, or the facets of its curved faces."""

    object_name: str
    is_curved: bool
    mesh: trimesh.Trimesh


def object_meshes(
    scene: Scene,
    max_sagitta_m: float = MAX_SAGITTA_M,
    max_turn_rad: float = MAX_TURN_RAD,
    *,
    keep_hidden_caps: bool = True,
) -> list[MeshPart]:
    """Mesh parts of all objects in order, then 'floor' and 'ceiling' as rectangles over the bounds.

    Closed contours give prisms with caps (flat facets) and outward normals; open contours give single vertical
    sheets. Flat and curved parts of an object share the vertices along their seam, so together they are
    watertight. Caps in the plane of the floor or the ceiling are hidden; without `keep_hidden_caps` they are
    omitted. The clutter comes last; its facets are flat faces.
    """
    planes = [("floor", scene.floor, True), ("ceiling", scene.ceiling, False)]
    hiding = [] if keep_hidden_caps else [plane.z_m for _, plane, _ in planes if plane is not None]
    parts = [part for item in scene.objects for part in _object_parts(item, max_sagitta_m, max_turn_rad, hiding)]
    x_min, y_min, x_max, y_max = scene.bounds_m
    corners = np.array([(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)])
    for name, plane, upward in planes:
        if plane is not None:
            parts.append(MeshPart(name, False, _horizontal(corners, plane.z_m, upward=upward)))
    for item in scene.clutter:
        mesh = trimesh.Trimesh(np.array(item.vertices_m), np.array(item.faces), process=False)
        parts.append(MeshPart(item.name, False, mesh))
    return parts


def read_mesh(path: Path) -> tuple[FloatArray, IntArray]:
    """Vertices (vertex, xyz) and faces (face, corner) of a mesh file; equal vertices of a body are merged.

    OBJ, STL, PLY, OFF, glTF and GLB, a zip archive of them, and 3MF and DAE with further packages. z points up in
    files, except in glTF and GLB, where y does by their standard: these are turned upright. Raises `ValueError` if
    the file cannot be read or holds no triangle.
    """
    if not path.exists():
        raise ValueError(f"file = '{path}': there is no such file")
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise ValueError(f"file = '{path}': must be one of {', '.join(FORMATS)}")
    missing = [name for name in FORMATS[kind] if find_spec(name) is None]
    if missing:
        needed = "install them with: pip install 'isac-arena[meshes]'"
        raise ValueError(f"file = '{path}': {kind} files need the packages {', '.join(missing)}; {needed}")
    try:
        check_input(path)
    except OSError as error:
        raise ValueError(f"file = '{path}': cannot be read ({error.strerror})") from error
    try:
        with address_space(f"file = '{path}'"):
            loaded = trimesh.load_scene(path)
            for body in loaded.geometry.values():
                body.merge_vertices(merge_norm=True, merge_tex=True)
            loaded = loaded.to_mesh()
    except MemoryLimitError:
        raise
    except ImportError as error:  # a reader falls back to one for other texts
        raise ValueError(f"file = '{path}': cannot be read as a mesh (damaged, or not a {kind} file)") from error
    except Exception as error:  # readers raise many types of exceptions for damaged files
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"file = '{path}': cannot be read as a mesh ({reason})") from error
    if not len(getattr(loaded, "faces", ())):
        raise ValueError(f"file = '{path}': cannot be read as a mesh (it holds no triangle)")
    vertices = np.asarray(loaded.vertices, float)
    upright = vertices[:, [0, 2, 1]] * [1, -1, 1] if kind in Y_UP else vertices
    return upright, np.asarray(loaded.faces, int)


def write_ply(part: MeshPart, folder: Path) -> Path:
    """Write a part as binary PLY 'NAME-flat.ply' or 'NAME-curved.ply' and return the path."""
    path = path_in(folder, f"{part.object_name}-{'curved' if part.is_curved else 'flat'}.ply")
    part.mesh.export(path)
    return path


def ply_bytes(scene: Scene, max_sagitta_m: float = EXPORT_SAGITTA_M) -> bytes:
    """The whole scene as one binary PLY mesh in m, z up."""
    whole = trimesh.util.concatenate([part.mesh for part in object_meshes(scene, max_sagitta_m)])
    return bytes(whole.export(file_type="ply"))


@dataclass(frozen=True)
class Polyline3d:
    """A line in space that is exported as a named, coloured node."""

    name: str
    color: str  # as #rrggbb
    points_m: FloatArray  # (point, xyz)


def mesh_bytes(vertices_m: FloatArray, faces: IntArray, file_type: str = "ply") -> bytes:
    """A mesh of vertices (vertex, xyz) and faces (face, corner) in m as a file, by default binary PLY."""
    content = trimesh.Trimesh(vertices_m, faces, process=False).export(file_type=file_type)
    return content.encode() if isinstance(content, str) else bytes(content)


def glb_bytes(
    scene: Scene, max_sagitta_m: float = EXPORT_SAGITTA_M, polylines: Sequence[Polyline3d] = ()
) -> bytes:
    """The scene as binary glTF in m, y up as glTF requires: one named, coloured node per mesh part.

    Each of `polylines`, such as the rays of a stop, is also a node and needs a unique name.
    """
    result = trimesh.Scene()
    for part in object_meshes(scene, max_sagitta_m):
        name = f"{part.object_name}-curved" if part.is_curved else part.object_name
        kind = scene.kinds.get(part.object_name)
        color = trimesh.visual.color.hex_to_rgba(KIND_COLORS[kind] if kind else PLANE_COLOR)
        material = trimesh.visual.material.PBRMaterial(
            name=name, baseColorFactor=color, metallicFactor=0.0, roughnessFactor=0.9
        )
        mesh = trimesh.Trimesh(part.mesh.vertices[:, [0, 2, 1]] * [1, 1, -1], part.mesh.faces, process=False)
        mesh.visual = trimesh.visual.TextureVisuals(material=material)
        result.add_geometry(mesh, node_name=name, geom_name=name)
    for line in polylines:
        path = trimesh.path.Path3D(
            entities=[trimesh.path.entities.Line(np.arange(len(line.points_m)))],
            vertices=line.points_m[:, [0, 2, 1]] * [1, 1, -1],
            colors=trimesh.visual.color.hex_to_rgba(line.color)[None],
            process=False,
        )
        result.add_geometry(path, node_name=line.name, geom_name=line.name)
    return bytes(result.export(file_type="glb"))


def write_mitsuba(scene: Scene, folder: Path, max_sagitta_m: float = MAX_SAGITTA_M) -> Path:
    """Write FOLDER/NAME.xml with one PLY file per mesh part in FOLDER/meshes; returns the path of the XML."""
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    shapes = []
    for part in object_meshes(scene, max_sagitta_m, keep_hidden_caps=False):
        file = write_ply(part, folder / "meshes")
        shapes.append((file.stem, f"meshes/{file.name}", scene.materials[part.object_name].name))
    path = path_in(folder, f"{scene.name}.xml")
    materials = {material.name: material for material in scene.materials.values()}
    path.write_text(mitsuba_xml(materials, shapes), encoding="utf-8")
    return path


def mitsuba_xml(materials: Mapping[str, Material], shapes: Iterable[tuple[str, str, str]]) -> str:
    """XML text of the materials by name and the shapes (id, PLY file, name of the material).

    Every material is a `radio-material` with the values of its constants at the carrier. Sionna then assumes
    Lambertian scattering.
    """
    root = ET.Element("scene", version=MITSUBA_VERSION)
    for name, material in materials.items():
        node = ET.SubElement(root, "bsdf", type="radio-material", id=MITSUBA_PREFIX + name)
        for constant, value in (
            ("relative_permittivity", material.relative_permittivity),
            ("conductivity", material.conductivity_s_m),
            ("thickness", material.thickness_m),
            ("scattering_coefficient", material.scattering_coefficient),
        ):
            ET.SubElement(node, "float", name=constant, value=repr(float(value)))
    for name, file, material_name in shapes:
        node = ET.SubElement(root, "shape", type="ply", id=f"mesh-{name}")
        ET.SubElement(node, "string", name="filename", value=file)
        ET.SubElement(node, "boolean", name="face_normals", value="true")
        ET.SubElement(node, "ref", id=MITSUBA_PREFIX + material_name, name="bsdf")
    ET.indent(root, space="    ")
    return ET.tostring(root, encoding="unicode") + "\n"


def _object_parts(
    item: SceneObject, max_sagitta_m: float, max_turn_rad: float, hiding_z_m: list[float]
) -> Iterator[MeshPart]:
    outline, is_curved = _chords(item.contour, max_sagitta_m, max_turn_rad)
    following = np.arange(1, len(is_curved) + 1) % len(outline)
    for curved in (False, True):
        chord = np.flatnonzero(is_curved == curved)
        sheets = []
        if len(chord):
            sheets.append(_sheet(outline[chord], outline[following[chord]], item.z_min_m, item.z_max_m))
        if item.contour.closed and not curved:
            caps = [(item.z_min_m, False), (item.z_max_m, True)]
            sheets += [_horizontal(outline, z, upward=up) for z, up in caps if z not in hiding_z_m]
        if sheets:
            yield MeshPart(item.name, curved, trimesh.util.concatenate(sheets))


def _chords(contour: Contour, max_sagitta_m: float, max_turn_rad: float) -> tuple[FloatArray, IntArray]:
    """Polygonised contour (vertex, xy), and a mask (vertex,) of the chords that start there on a curved piece."""
    counts = [piece.n_chords(max_sagitta_m, max_turn_rad) for piece in contour.pieces]
    is_curved = np.repeat([piece.is_curved for piece in contour.pieces], counts)
    return contour.vertices(max_sagitta_m, max_turn_rad), is_curved


def _sheet(start_m: FloatArray, end_m: FloatArray, z_min_m: float, z_max_m: float) -> trimesh.Trimesh:
    """Vertical rectangles, two triangles each, over chords (chord, xy); normals to the right of the chords."""
    corners = [(start_m, z_min_m), (end_m, z_min_m), (end_m, z_max_m), (start_m, z_max_m)]
    quad = np.stack([np.column_stack([xy, np.full(len(xy), z)]) for xy, z in corners], axis=1)
    first = 4 * np.arange(len(start_m))[:, None]
    faces = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])])
    return trimesh.Trimesh(quad.reshape(-1, 3), faces, process=False)


def _horizontal(outline_m: FloatArray, z_m: float, *, upward: bool) -> trimesh.Trimesh:
    """Polygon (vertex, xy) at a height as triangles over its own vertices, facing up or down."""
    triangles = shapely.constrained_delaunay_triangles(shapely.Polygon(outline_m)).geoms
    corners = np.array([shapely.get_coordinates(triangle)[:3] for triangle in triangles])
    edges = np.diff(corners, axis=1)
    faces_up = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0] > 0
    corners[faces_up != upward] = corners[faces_up != upward][:, ::-1]
    vertices = np.column_stack([corners.reshape(-1, 2), np.full(corners.size // 2, z_m)])
    return trimesh.Trimesh(vertices, np.arange(len(vertices)).reshape(-1, 3), process=False)
