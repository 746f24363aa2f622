"""A DeepMIMO v4 scenario made into a campaign file with its scene, walk, meshes and paths."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from isac_arena.campaign.files import write_bytes, write_text
from isac_arena.exchange.deepmimo_export import write_deepmimo
from scenes.meshes.mesh import mesh_bytes
from scenes.objects.clutter import Clutter
from scenes.objects.material import Material
from scenes.record import FloatArray, IntArray
from scenes.walks.tum import tum_text
from sim.propagation.deepmimo.folder import Facets, read_deepmimo, read_facets

MAX_PATHS = 10_000  # all of them, which are rarely more than 25
PATHS_FOLDER = "paths"


@dataclass(frozen=True)
class Imported:
    """How much of a scenario became the campaign."""

    n_stops: int
    n_receivers: int
    n_meshes: int
    n_objects: int


@dataclass(frozen=True)
class _Mesh:
    name: str
    material: str
    vertices_m: FloatArray
    faces: IntArray


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
    name = folder.resolve().name
    materials, meshes = _materials(facets), _meshes(facets)
    for mesh in meshes:
        write_bytes(out / f"{mesh.name}.ply", mesh_bytes(mesh.vertices_m, mesh.faces))
    scene = {
        "name": name,
        "tx": {"position_m": scenario.tx_position_m.tolist(), "heading_deg": 0.0},
        "walk": {"type": "tum", "file": "walk.tum"},
        "materials": materials,
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
    """Materials of a scene file. With the paths given they matter to pictures and exports only."""
    return {
        f"material_{each['id']}": {
            "relative_permittivity": max(float(each.get("permittivity", 1.0)), 1.0),
            "conductivity_s_m": max(float(each.get("conductivity", 0.0)), 0.0),
            "thickness_m": float(each.get("thickness", 0.0)) or 0.1,
        }
        for each in facets.materials.values()
    }


def _meshes(facets: Facets) -> list[_Mesh]:
    """A mesh per object, in the material of its first face; bodies that are no clean surface are left out."""
    known = {int(each["id"]) for each in facets.materials.values()}
    meshes = []
    for number, item in enumerate(facets.objects):
        corners = item["face_vertex_idxs"]
        faces = np.array([[one[0], *pair] for one in corners for pair in pairwise(one[1:])], int).reshape(
            -1, 3
        )
        used, faces = np.unique(faces, return_inverse=True)
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
