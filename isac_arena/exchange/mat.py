"""The layout of the public measurement file of the Campus Arena campaign (MATLAB 5): read, checked, written.

The file holds one struct `sim`. Fields of T stops: `tx` and `rx` (3 x T: x, y in m, heading in rad), `y` (cells of
3 x M: range in m, AoD and AoA in rad, array frames), `power` (cells of M, dBm), and, where labelled, `inlier`
(cells of 2 x M: line of sight, single bounce) and `MU` (cells of 2 x M: IP in m, NaN unless a single bounce). The
excerpt of 30 stops and the whole file of 45 stops have this layout.
"""

from collections.abc import Iterable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, savemat

from isac_arena.campaign.measured import (
    PUBLISHED_TX_OFFSET_DEG,
    MeasuredCampaign,
    MeasuredFile,
    MeasuredStop,
    measured_campaign,
)
from scenes.inputs import check_matlab
from scenes.memory import MemoryLimitError
from scenes.pose import Pose
from scenes.record import FloatArray

NEEDED = ("tx", "rx", "y", "power")


def read_measurement(
    path: Path,
    *,
    tx_offset_deg: float = PUBLISHED_TX_OFFSET_DEG,
    clock_bias_m: FloatArray | None = None,
    height_m: float = 0.0,
) -> MeasuredCampaign:
    """All stops of a measurement file.

    `tx_offset_deg` is added to the TX heading of the file, `clock_bias_m` (stop,) to the ranges (zero without it),
    and all devices stand at `height_m`.

    Raises `FileNotFoundError` where the file is missing; `ValueError` where it is no MATLAB 5 file or has
    another layout; the message names file, field, shape and what is needed.
    """
    found = read_layout(path, Pose(np.array([0.0, 0.0, height_m]), 0.0))
    pose, stops = found.tx, found.stops
    pose = Pose(pose.position_m, float(pose.heading_rad + np.deg2rad(tx_offset_deg)))
    n_stops = len(stops)
    bias = np.zeros(n_stops) if clock_bias_m is None else np.asarray(clock_bias_m, float)
    if bias.shape != (n_stops,):
        raise ValueError(f"clock_bias_m: shape {bias.shape}, one value for each of {n_stops} stops is needed")
    try:
        return measured_campaign(pose, stops, bias, height_m)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def read_layout(path: Path, scene_tx: Pose) -> MeasuredFile:
    """TX and stops as the file has them, all devices at the height of `scene_tx`; raises as `read_measurement`."""
    sim = _struct(path)
    rx = _numbers(path, sim, "rx")
    n_stops = len(rx)
    tx = _one_pose(path, _numbers(path, sim, "tx"), n_stops)
    cells = {name: _cells(path, sim, name, n_stops) for name in ("y", "power", "inlier", "MU")}
    stops = [
        _stop(path, index, rx[index], {name: cell[index] for name, cell in cells.items()})
        for index in range(n_stops)
    ]
    return MeasuredFile(Pose(np.array([*tx[:2], scene_tx.position_m[2]]), float(tx[2])), stops)


def is_layout(path: Path) -> bool:
    """Whether a MATLAB file holds the struct `sim`; raises as `read_measurement`."""
    return "sim" in read_variables(path)


ABOUT = {
    "tx": ("m, m, rad", "x, y and heading of the TX at every stop"),
    "rx": ("m, m, rad", "x, y and heading of the receiver at every stop, the truth"),
    "y": ("m, rad, rad", "estimated path lengths without clock bias, azimuths of departure and arrival, per stop"),
    "power": ("dBm", "received power of the paths in their best beam pairs, per stop"),
    "inlier": ("1", "first row: line of sight, second row: single bounce, by the truth"),
    "MU": ("m", "x and y of the incidence points of single bounces, NaN for other paths"),
}


def measurement_bytes(tx: Pose, stops: Sequence[MeasuredStop]) -> bytes:
    """A MATLAB 5 file of the same layout; `read_measurement` without a heading offset gives the stops back."""

    def cells(values: Iterable[FloatArray]) -> Any:
        row = np.empty((1, len(stops)), object)
        row[0, :] = [np.asarray(value, float) for value in values]
        return row

    pose = np.array([*tx.position_m[:2], tx.heading_rad])
    sim = {
        "tx": np.repeat(pose[:, None], len(stops), axis=1),
        "rx": np.stack([stop.rx for stop in stops], axis=1),
        "y": cells(stop.measured.T for stop in stops),
        "power": cells(stop.power_dbm[None] for stop in stops),
        "inlier": cells(np.stack([stop.is_los, stop.is_single_bounce]) for stop in stops),
        "MU": cells(stop.landmark_m.T for stop in stops),
    }
    content = BytesIO()
    about = {name: {"unit": unit, "description": text} for name, (unit, text) in ABOUT.items()}
    savemat(content, {"sim": sim, "about": about}, do_compression=True)
    return content.getvalue()


def count_stops(path: Path) -> int:
    """Number of stops in a measurement file; raises as `read_measurement`."""
    return len(_numbers(path, _struct(path), "rx"))


def read_variables(path: Path) -> dict[str, Any]:
    """The variables of a MATLAB 5 file; `FileNotFoundError`, or `ValueError` where it is none."""
    if not path.is_file():
        raise FileNotFoundError(2, "no such file", str(path))
    try:
        check_matlab(path)
        content = loadmat(path)
    except MemoryLimitError:
        raise
    except Exception as error:  # the reader raises many types of exceptions for damaged files
        raise ValueError(f"{path}: no MATLAB 5 file ({' '.join(str(error).split())[:80]})") from error
    return {name: value for name, value in content.items() if not name.startswith("__")}


def _struct(path: Path) -> dict[str, Any]:
    content = read_variables(path)
    names, sim = sorted(content), content.get("sim")
    if sim is None or sim.dtype.names is None or sim.size != 1:
        raise ValueError(f"{path}: holds {', '.join(names) or 'nothing'}; one struct 'sim' is needed")
    missing = [name for name in NEEDED if name not in sim.dtype.names]
    if missing:
        raise ValueError(f"{path}: sim.{missing[0]} is missing; needed are {', '.join(NEEDED)}")
    return {name: sim[name].flat[0] for name in sim.dtype.names}


def _numbers(path: Path, sim: dict[str, Any], name: str) -> FloatArray:
    """Poses (stop, 3) of a 3 x T field."""
    value = sim[name]
    if value.dtype.kind not in "fiu" or value.ndim != 2 or value.shape[0] != 3 or value.shape[1] == 0:
        raise ValueError(f"{path}: sim.{name} has shape {value.shape}, 3 x T numbers are needed")
    if not np.isfinite(value).all():
        raise ValueError(f"{path}: sim.{name} holds values that are not finite")
    return np.asarray(value.T, float)


def _one_pose(path: Path, tx: FloatArray, n_stops: int) -> FloatArray:
    """The TX pose (3,), the same at every stop."""
    if len(tx) not in (1, n_stops):
        raise ValueError(f"{path}: sim.tx has {len(tx)} poses, 1 or one for each of {n_stops} stops is needed")
    if np.any(tx != tx[0]):
        raise ValueError(f"{path}: sim.tx moves; only a TX at rest is known")
    return np.asarray(tx[0])


def _cells(path: Path, sim: dict[str, Any], name: str, n_stops: int) -> list[FloatArray | None]:
    """The matrix of every stop; None for every stop where the file lacks the field."""
    if name not in sim:
        return [None] * n_stops
    value = sim[name]
    if value.dtype != object or value.size != n_stops:
        needed = f"one cell for each of {n_stops} stops is needed"
        raise ValueError(f"{path}: sim.{name} has {value.size} entries, {needed}")
    return [np.asarray(cell, float) for cell in value.flat]


def _stop(path: Path, index: int, rx: FloatArray, cell: dict[str, FloatArray | None]) -> MeasuredStop:
    y = cell["y"]
    n = y.shape[1] if y is not None and y.ndim == 2 else 0
    value = {}
    for name, rows, default in (("y", 3, np.nan), ("power", 1, np.nan), ("inlier", 2, 0.0), ("MU", 2, np.nan)):
        given, shape = cell[name], (rows, n)
        value[name] = np.full(shape, default) if given is None else given
        if value[name].shape != shape:
            field = f"sim.{name}{{{index + 1}}}"
            raise ValueError(f"{path}: {field} has shape {value[name].shape}, {shape} is needed for {n} paths")
    label = value["inlier"] > 0
    return MeasuredStop(rx, value["y"].T, value["power"][0], label[0], label[1], value["MU"].T)
