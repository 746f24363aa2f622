"""Reader of a DeepMIMO v4 scenario folder: path matrices (.mat), facets of the scene, params.json."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenes.inputs import LARGEST_TEXT, check_input, check_matlab, read_input
from scenes.memory import MemoryLimitError
from scenes.record import FloatArray
from sim.propagation.deepmimo.scenario import PATH_MATRICES, PathScenario, paths_of_matrices

VERSION = "4.0.0"
TX_SET, RX_SET = 0, 1
SUFFIXES = (".mat", ".npz", ".npy")  # in the order in which DeepMIMO looks for them


@dataclass(frozen=True)
class Facets:
    """Facets of a scenario as DeepMIMO stores them. The paths do not need them."""

    vertices_m: FloatArray  # (vertex, xyz)
    objects: list[dict[str, Any]]  # name, label, id, vertices and material of each face
    materials: dict[str, dict[str, Any]]


def read_facets(folder: Path) -> Facets:
    """The facets of a scenario folder; empty if it has none or stores them in another form."""
    params = _read_params(folder)
    try:
        objects = json.loads(read_input(folder / "objects.json"))
        vertices = _read_matrix(folder, "vertices")
        known = [item for item in objects if "face_vertex_idxs" in item]
    except (OSError, ValueError):
        return Facets(np.zeros((0, 3)), [], {})
    return Facets(vertices.reshape(-1, 3), known, params.get("materials", {}))


def read_deepmimo(
    folder: Path, *, tx_set: int | None = None, tx: int = 0, rx_set: int | None = None
) -> PathScenario:
    """Paths from one TX to one set of receivers. By default the first matching sets are used.

    Raises `ValueError` if the folder holds no scenario, has no such set or TX, or a file is missing or damaged.
    """
    params = _read_params(folder)
    sets = [each for name, each in params["txrx_sets"].items() if name.startswith("txrx_set_")]
    tx_set = _chosen(folder, sets, "is_tx", tx_set)
    rx_set = _chosen(folder, sets, "is_rx", rx_set)
    matrices = {
        name: _read_matrix(folder, name, matrix_suffix(tx_set, tx, rx_set))
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
    """Checksum of the contents of a scenario folder, independent of its name. Raises `OSError` if unreadable."""
    state = hashlib.sha256()
    for file in sorted(Path(folder).iterdir()):
        state.update(file.name.encode() + hashlib.sha256(read_input(file)).digest())
    return state.hexdigest()


def matrix_suffix(tx_set: int, tx: int, rx_set: int) -> str:
    """Suffix of the names of files with matrices of one TX and one set of receivers."""
    return f"t{tx_set:03d}_tx{tx:03d}_r{rx_set:03d}"


def _read_params(folder: Path) -> dict[str, Any]:
    path = folder / "params.json"
    try:
        params: dict[str, Any] = json.loads(read_input(path, LARGEST_TEXT))
        if not params["txrx_sets"] or not float(params["rt_params"]["frequency"]) > 0:
            raise ValueError("txrx_sets and rt_params.frequency are needed")
    except FileNotFoundError:
        raise ValueError(f"{folder}: holds no DeepMIMO v4 scenario (no params.json)") from None
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"{path}: no parameters of a DeepMIMO v4 scenario ({error})") from error
    return params


def _chosen(folder: Path, sets: Sequence[Mapping[str, Any]], role: str, wanted: int | None) -> int:
    """The set with this role: the named one or the first. A set that only receives comes before others."""
    known = [int(each["id"]) for each in sorted(sets, key=lambda s: bool(s["is_tx"])) if each[role]]
    if wanted is None and known:
        return known[0]
    if wanted not in known:
        names = ", ".join(map(str, known)) or "none"
        raise ValueError(f"{folder}: {role.removeprefix('is_')}_set = {wanted}: the scenario has {names}")
    return wanted


def _read_matrix(folder: Path, name: str, pair: str = "") -> FloatArray:
    from scipy.io import loadmat  # noqa: PLC0415  (slow to import)

    stem = f"{name}_{pair}" if pair else name
    for suffix in SUFFIXES:
        path = folder / f"{stem}{suffix}"
        if path.is_file():
            break
    else:
        raise ValueError(f"{folder}: {stem}.mat (or .npz, .npy) is missing")
    try:
        (check_matlab if suffix == ".mat" else check_input)(path)
        content = loadmat(path) if suffix == ".mat" else np.load(path, allow_pickle=False)
        return np.asarray(content if suffix == ".npy" else content[name], float)
    except MemoryLimitError:
        raise
    except Exception as error:  # readers raise many types of exceptions for damaged files
        reason = " ".join(str(error).split())[:80] or type(error).__name__
        raise ValueError(f"{path}: holds no matrix '{name}' ({reason})") from error
