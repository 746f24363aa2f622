"""A DeepMIMO v4 scenario folder: matrices of paths (.mat), the facets of the scene, and params.json."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, savemat

from scenes.material import Material
from scenes.mesh import object_meshes
from scenes.record import FloatArray
from scenes.scene import Scene
from sim.deepmimo import PATH_MATRICES, PathScenario, path_matrices, paths_of_matrices
from sim.paths import BounceKind, Paths
from sim.store import write_bytes, write_text

VERSION = "4.0.0"
TX_SET, RX_SET = 0, 1
SUFFIXES = (".mat", ".npz", ".npy")  # in the order in which DeepMIMO looks for them


@dataclass(frozen=True)
class Facets:
    """The world of a scenario as DeepMIMO keeps it, which no path needs."""

    vertices_m: FloatArray  # (vertex, xyz)
    objects: list[dict[str, Any]]  # name, label, id, vertices and material of each face
    materials: dict[str, dict[str, Any]]


def write_deepmimo(folder: Path, scenario: PathScenario, facets: Facets, max_paths: int) -> Path:
    """Write a scenario folder with one TX and one set of receivers; returns its params.json.

    Of each receiver the `max_paths` strongest paths are kept. The params file, without which nobody reads the
    folder, comes last.
    """
    matrices = path_matrices(scenario.paths, max_paths)
    matrices |= {"rx_pos": scenario.rx_position_m, "tx_pos": scenario.tx_position_m[None]}
    for name, matrix in matrices.items():
        _write_mat(folder / f"{name}_{_pair(TX_SET, 0, RX_SET)}.mat", name, matrix)
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


def read_facets(folder: Path) -> Facets:
    """The world of a scenario folder; nothing where it holds none, or one of another representation."""
    params = _read_params(folder)
    try:
        objects = json.loads((folder / "objects.json").read_text(encoding="utf-8"))
        vertices = _read_matrix(folder, "vertices")
        known = [item for item in objects if "face_vertex_idxs" in item]
    except (OSError, ValueError):
        return Facets(np.zeros((0, 3)), [], {})
    return Facets(vertices.reshape(-1, 3), known, params.get("materials", {}))


def read_deepmimo(
    folder: Path, *, tx_set: int | None = None, tx: int = 0, rx_set: int | None = None
) -> PathScenario:
    """Paths from one TX to one set of receivers; the first sets that fit where none is named.

    Raises
    ------
    ValueError
        Where the folder holds no scenario, has no such set or TX, or a file is missing or damaged.
    """
    params = _read_params(folder)
    sets = [each for name, each in params["txrx_sets"].items() if name.startswith("txrx_set_")]
    tx_set = _chosen(folder, sets, "is_tx", tx_set)
    rx_set = _chosen(folder, sets, "is_rx", rx_set)
    matrices = {
        name: _read_matrix(folder, name, _pair(tx_set, tx, rx_set))
        for name in (*PATH_MATRICES, "inter_pos", "rx_pos", "tx_pos")
    }
    receivers = matrices["rx_pos"]
    shape = matrices["delay"].shape
    for name in PATH_MATRICES:
        if matrices[name].shape != shape or shape[0] != len(receivers):
            raise ValueError(
                f"{folder}: {name} has shape {matrices[name].shape}, {(len(receivers), *shape[1:])} is needed"
            )
    tx_position = matrices["tx_pos"].reshape(-1, 3)
    return PathScenario(
        tx_position_m=tx_position[tx if len(tx_position) > 1 else 0],
        rx_position_m=receivers,
        carrier_hz=float(params["rt_params"]["frequency"]),
        paths=tuple(paths_of_matrices(matrices, row) for row in range(len(receivers))),
    )


def scenario_digest(folder: str | Path) -> str:
    """Checksum of what a scenario folder holds, whatever its name. Raises `OSError` where it is unreadable."""
    state = hashlib.sha256()
    for file in sorted(Path(folder).iterdir()):
        state.update(file.name.encode() + hashlib.sha256(file.read_bytes()).digest())
    return state.hexdigest()


def _pair(tx_set: int, tx: int, rx_set: int) -> str:
    return f"t{tx_set:03d}_tx{tx:03d}_r{rx_set:03d}"


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


def _read_params(folder: Path) -> dict[str, Any]:
    path = folder / "params.json"
    try:
        params: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if not params["txrx_sets"] or not float(params["rt_params"]["frequency"]) > 0:
            raise ValueError("txrx_sets and rt_params.frequency are needed")
    except FileNotFoundError:
        raise ValueError(f"{folder}: holds no DeepMIMO v4 scenario (no params.json)") from None
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path}: no parameters of a DeepMIMO v4 scenario ({error})") from error
    return params


def _chosen(folder: Path, sets: Sequence[Mapping[str, Any]], role: str, wanted: int | None) -> int:
    """The set of this role: the one named, or the first; of receivers rather one that only receives."""
    known = [int(each["id"]) for each in sorted(sets, key=lambda s: bool(s["is_tx"])) if each[role]]
    if wanted is None and known:
        return known[0]
    if wanted not in known:
        names = ", ".join(map(str, known)) or "none"
        raise ValueError(f"{folder}: {role.removeprefix('is_')}_set = {wanted}: the scenario has {names}")
    return wanted


def _read_matrix(folder: Path, name: str, pair: str = "") -> FloatArray:
    stem = f"{name}_{pair}" if pair else name
    for suffix in SUFFIXES:
        path = folder / f"{stem}{suffix}"
        if path.is_file():
            break
    else:
        raise ValueError(f"{folder}: {stem}.mat (or .npz, .npy) is missing")
    try:
        content = loadmat(path) if suffix == ".mat" else np.load(path, allow_pickle=False)
        return np.asarray(content if suffix == ".npy" else content[name], float)
    except Exception as error:  # readers raise whatever they like on broken files
        reason = " ".join(str(error).split())[:80] or type(error).__name__
        raise ValueError(f"{path}: holds no matrix '{name}' ({reason})") from error
