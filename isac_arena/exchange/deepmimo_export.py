"""A DeepMIMO v4 scenario folder written: matrices of paths (.mat), the facets of the scene, and params.json."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import savemat

from isac_arena.campaign.files import write_bytes, write_text
from scenes.meshes.mesh import object_meshes
from scenes.objects.material import Material
from scenes.record import FloatArray
from scenes.scene import Scene
from sim.propagation.deepmimo.folder import RX_SET, TX_SET, VERSION, Facets, matrix_suffix
from sim.propagation.deepmimo.scenario import PathScenario, path_matrices
from sim.propagation.paths import BounceKind, Paths


def write_deepmimo(folder: Path, scenario: PathScenario, facets: Facets, max_paths: int) -> Path:
    """Write a scenario folder with one TX and one set of receivers; returns its params.json.

    Of each receiver the `max_paths` strongest paths are kept. The params file, without which nobody reads the
    folder, comes last.
    """
    matrices = path_matrices(scenario.paths, max_paths)
    matrices |= {"rx_pos": scenario.rx_position_m, "tx_pos": scenario.tx_position_m[None]}
    for name, matrix in matrices.items():
        _write_mat(folder / f"{name}_{matrix_suffix(TX_SET, 0, RX_SET)}.mat", name, matrix)
    _write_mat(folder / "vertices.mat", "vertices", facets.vertices_m)
    write_text(folder / "objects.json", json.dumps(facets.objects, indent=1))
    target = folder / "params.json"
    write_text(target, json.dumps(_params(scenario, facets), indent=1))
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
            "max_scattering": _most(paths, BounceKind.DIFFUSE),
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
    return max(
        (int(np.isin(each.bounce_kind, counted).sum(axis=1).max(initial=0)) for each in paths), default=0
    )


def _entries(materials: Sequence[Material]) -> Iterator[tuple[str, dict[str, Any]]]:
    for index, material in enumerate(materials):
        model = "lambertian" if material.scattering_directivity is None else "directive"
        yield (
            f"material_{index}",
            {
                "id": index,
                "name": material.name,
                "permittivity": material.relative_permittivity,
                "conductivity": material.conductivity_s_m,
                "scattering_model": model if material.scattering_coefficient else "none",
                "scattering_coefficient": material.scattering_coefficient,
                "alpha_r": float(material.scattering_directivity or 4),
                "thickness": material.thickness_m,
            },
        )
