"""DeepMIMO v4 scenario folders: a campaign written as one, and one made into a campaign.

A folder holds matrices of paths (.mat), the facets of the scene, and params.json.
"""

from collections.abc import Iterator, Sequence
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w
from scipy.io import savemat

from isac_arena.campaign.files import write_bytes, write_json, write_text
from scenes.meshes.mesh import mesh_bytes, object_meshes
from scenes.names import name_from, path_in
from scenes.objects.clutter import Clutter
from scenes.objects.material import Material
from scenes.record import FloatArray, IntArray
from scenes.scene import Scene
from scenes.walks.tum import tum_text
from sim.propagation.deepmimo.folder import (
    RX_SET,
    TX_SET,
    VERSION,
    Facets,
    matrix_suffix,
    read_deepmimo,
    read_facets,
)
from sim.propagation.deepmimo.scenario import PathScenario, path_matrices
from sim.propagation.paths import BounceKind, Paths

MAX_PATHS = 10_000  # all of them, which are rarely more than 25
PATHS_FOLDER = "paths"


class Imported(NamedTuple):
    """How much of a scenario is in the campaign."""

    n_stops: int
    n_receivers: int
    n_meshes: int
    n_objects: int


class _Mesh(NamedTuple):
    name: str
    material: str
    vertices_m: FloatArray
    faces: IntArray


def write_deepmimo(folder: Path, scenario: PathScenario, facets: Facets, max_paths: int) -> Path:
    """Write a scenario folder with one TX and one set of receivers; returns its params.json.

    The `max_paths` strongest paths of each receiver are kept. The params file is written last: without it no tool
    reads the folder.
    """
    matrices = path_matrices(scenario.paths, max_paths)
    matrices |= {"rx_pos": scenario.rx_position_m, "tx_pos": scenario.tx_position_m[None]}
    for name, matrix in matrices.items():
        _write_mat(path_in(folder, f"{name}_{matrix_suffix(TX_SET, 0, RX_SET)}.mat"), name, matrix)
    _write_mat(folder / "vertices.mat", "vertices", facets.vertices_m)
    write_json(folder / "objects.json", facets.objects)
    target = folder / "params.json"
    write_json(target, _params(scenario, facets))
    return target


def scene_facets(scene: Scene) -> Facets:
    """The triangles of every mesh part of a scene as an object."""
    blocks, objects, first = [np.zeros((0, 3))], [], 0
    materials = list(dict.fromkeys(scene.materials.values()))
    index_of = {name: materials.index(material) for name, material in scene.materials.items()}
    for number, part in enumerate(object_meshes(scene)):
        blocks.append(np.asarray(part.mesh.vertices, float))
        objects.append(
            {
                "name": f"{part.object_name}{' (curved)' if part.is_curved else ''}",
                "label": "objects",
                "id": number,
                "face_vertex_idxs": (part.mesh.faces + first).tolist(),
                "face_material_idxs": [index_of[part.object_name]] * len(part.mesh.faces),
            }
        )
        first += len(part.mesh.vertices)
    return Facets(np.concatenate(blocks), objects, dict(_entries(materials)))


def _write_mat(path: Path, name: str, matrix: FloatArray) -> None:
    content = BytesIO()
    savemat(content, {name: matrix}, do_compression=True)
    write_bytes(path, content.getvalue())


def _params(scenario: PathScenario, facets: Facets) -> dict[str, Any]:
    paths = scenario.paths
    n_faces = sum(len(item["face_vertex_idxs"]) for item in facets.objects)
    return {
        "version": VERSION,
        "rt_params": {
            "raytracer_name": "ISAC Arena",
            "raytracer_version": VERSION,
            "frequency": scenario.carrier_hz,
            "max_path_depth": _most(paths, *BounceKind),
            "max_reflections": _most(paths, BounceKind.SPECULAR),
            "max_diffractions": _most(paths, BounceKind.DIFFRACTION),
            "max_scattering": _most(paths, BounceKind.DIFFUSE, BounceKind.TARGET),
            "max_transmissions": _most(paths, BounceKind.REFRACTION),
        },
        "scene": {
            "num_scenes": 1,
            "n_objects": len(facets.objects),
            "n_vertices": len(facets.vertices_m),
            "n_faces": n_faces,
            "n_triangular_faces": n_faces,
        },
        "txrx_sets": {
            f"txrx_set_{number}": {
                "name": name,
                "id_orig": number,
                "id": number,
                "is_tx": number == TX_SET,
                "is_rx": number == RX_SET,
                "num_points": n_points,
                "num_active_points": n_active,
                "num_ant": 1,
                "dual_pol": False,
                "ant_rel_positions": [[0, 0, 0]],
                "array_orientation": [0, 0, 0],
            }
            for number, name, n_points, n_active in (
                (TX_SET, "tx", 1, 1),
                (RX_SET, "rx", len(paths), sum(len(each) > 0 for each in paths)),
            )
        },
        "materials": facets.materials,
    }


def _most(paths: Sequence[Paths], *kinds: BounceKind) -> int:
    """Most interactions of these kinds on any path; NONE does not count."""
    counted = [kind for kind in kinds if kind != BounceKind.NONE]
    counts = (np.isin(each.bounce_kind, counted).sum(axis=1).max(initial=0) for each in paths)
    return int(max(counts, default=0))


def _entries(materials: Sequence[Material]) -> Iterator[tuple[str, dict[str, Any]]]:
    for index, material in enumerate(materials):
        model = "lambertian" if material.scattering_directivity is None else "directive"
        entry = {
            "id": index,
            "name": material.name,
            "permittivity": material.relative_permittivity,
            "conductivity": material.conductivity_s_m,
            "scattering_model": model if material.scattering_coefficient else "none",
            "scattering_coefficient": material.scattering_coefficient,
            "alpha_r": float(material.scattering_directivity or 4),
            "thickness": material.thickness_m,
        }
        yield f"material_{index}", entry


def import_scenario(
    folder: Path, out: Path, *, n_stops: int | None, tx_set: int | None, tx: int, rx_set: int | None
) -> Imported:
    """Write campaign, scene, walk, meshes and paths of a scenario into a new or empty folder.

    Raises `ValueError` as `read_deepmimo` does, and where the folder holds files: they may have been edited.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ValueError(f"--out = {out}: must be a new or an empty directory")
    scenario, facets = read_deepmimo(folder, tx_set=tx_set, tx=tx, rx_set=rx_set), read_facets(folder)
    n_all = len(scenario.paths)
    n_stops = min(n_stops or n_all, n_all)
    scenario = scenario.at(np.linspace(0, n_all - 1, n_stops).round().astype(int))
    write_deepmimo(out / PATHS_FOLDER, scenario, facets, MAX_PATHS)
    time_s = np.arange(n_stops, dtype=float)
    write_text(out / "walk.tum", tum_text(time_s, scenario.rx_position_m, np.zeros(n_stops)))
    name = name_from(folder.resolve().name)
    meshes = _meshes(facets)
    for mesh in meshes:
        write_bytes(path_in(out, f"{mesh.name}.ply"), mesh_bytes(mesh.vertices_m, mesh.faces))
    scene = {
        "name": name,
        "tx": {"position_m": scenario.tx_position_m.tolist(), "heading_deg": 0.0},
        "walk": {"type": "tum", "file": "walk.tum"},
        "materials": _materials(facets),
        "meshes": [{"file": f"{mesh.name}.ply", "material": mesh.material} for mesh in meshes],
    }
    campaign = {
        "name": name,
        "scene": "scene.toml",
        "waveform": {"carrier_ghz": scenario.carrier_hz / 1e9},
        "propagation": {"deepmimo": PATHS_FOLDER},
    }
    no_headings = "A scenario has no headings: the TX looks along +x, as do the stops of walk.tum."
    write_text(out / "scene.toml", _toml(scene, no_headings))
    write_text(out / "campaign.toml", _toml(campaign, "All other settings have their defaults."))
    return Imported(n_stops, n_all, len(meshes), len(facets.objects))


def _materials(facets: Facets) -> dict[str, Any]:
    """Materials of a scene file. As the paths are given, only pictures and exports use them."""
    return {
        f"material_{each['id']}": {
            "relative_permittivity": max(float(each.get("permittivity", 1.0)), 1.0),
            "conductivity_s_m": max(float(each.get("conductivity", 0.0)), 0.0),
            "thickness_m": float(each.get("thickness", 0.0)) or 0.1,
        }
        for each in facets.materials.values()
    }


def _meshes(facets: Facets) -> list[_Mesh]:
    """A mesh per object with the material of its first face; none for an object that is no valid surface."""
    known = {int(each["id"]) for each in facets.materials.values()}
    meshes = []
    for number, item in enumerate(facets.objects):
        corners = item["face_vertex_idxs"]
        triangles = [[one[0], *pair] for one in corners for pair in pairwise(one[1:])]
        used, faces = np.unique(np.array(triangles, int).reshape(-1, 3), return_inverse=True)
        vertices, faces = facets.vertices_m[used], faces.reshape(-1, 3)
        try:
            Clutter("mesh", "clutter", Material("any", 1.0, 0.0), vertices, faces)
        except ValueError:
            continue
        if int(item["face_material_idxs"][0]) in known:
            name, material = f"object_{number:03d}", f"material_{item['face_material_idxs'][0]}"
            meshes.append(_Mesh(name, material, vertices, faces))
    return meshes


def _toml(document: dict[str, Any], remark: str) -> str:
    return f"# {remark}\n{tomli_w.dumps(document)}"
