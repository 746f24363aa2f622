"""Submissions: one table (CSV, Parquet, MATLAB, netCDF, NPZ) with a row per path, stop or point of a contour."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isac_arena.exchange.path_columns import Columns, read_columns
from isac_arena.exchange.table import MeasuredTable, table_of
from isac_arena.public_tasks.making import Stage
from scenes.pose import LARGEST_LENGTH_M
from scenes.record import BoolArray, FloatArray

MOST_CONTOURS = 10_000  # of a scene
LARGEST = {  # of what is submitted, either sign
    "delay_s": 1e-3, "aod_azimuth_rad": 6.2832, "aoa_azimuth_rad": 6.2832, "power_dbm": 300.0,
    "x_m": LARGEST_LENGTH_M, "y_m": LARGEST_LENGTH_M,
}  # fmt: skip

# Columns of a submission by stage; docs/tasks.md has the same list.
COLUMNS: dict[Stage, tuple[str, ...]] = {
    "channel": ("scene", "stop", "delay_s", "aod_azimuth_rad", "aoa_azimuth_rad", "power_dbm"),
    "slam": ("scene", "stop", "x_m", "y_m"),
    "contours": ("scene", "contour", "x_m", "y_m"),
}


@dataclass(frozen=True)
class Submission:
    """The rows of a submission: keys (row, 2) of whole numbers, scene first, and values (row, column)."""

    keys: FloatArray
    values: FloatArray

    def of(self, scene: int, other: int | None = None) -> FloatArray:
        """Values of a scene, or of a stop or contour in it."""
        chosen = self.keys[:, 0] == scene
        return np.asarray(self.values[chosen if other is None else chosen & (self.keys[:, 1] == other)])

    def others(self, scene: int) -> list[int]:
        """Numbers of the stops or contours of a scene."""
        return [int(other) for other in np.unique(self.keys[self.keys[:, 0] == scene, 1])]


def read_submission(file: Path, stage: Stage, n_scenes: int, n_stops: int) -> Submission:
    """The rows of a file; `ValueError`: file, row, column, value and what is allowed."""
    found = submission_of(read_columns(file), stage, n_scenes, n_stops, str(file))
    if not len(found.keys):
        raise ValueError(f"{file}: holds no rows; {stage} needs {', '.join(COLUMNS[stage])}")
    return found


def submission_of(columns: Columns, stage: Stage, n_scenes: int, n_stops: int, name: str) -> Submission:
    """The rows of columns; raises as `read_submission`."""
    table = table_of(Path(name), columns, COLUMNS[stage])
    values = {one: table.needed({one: 1.0}) for one in COLUMNS[stage]}
    counts = {"scene": n_scenes, "stop": n_stops, "contour": MOST_CONTOURS}
    for one, value in values.items():
        if one in counts:
            is_bad = (value != np.round(value)) | (value < 0) | (value >= counts[one])
            _refuse(table, one, value, is_bad, f"must be a whole number from 0 to {counts[one] - 1}")
        else:
            most = LARGEST[one]
            _refuse(table, one, value, np.abs(value) > most, f"must be within -{most:g} and {most:g}")
    rows = np.column_stack(list(values.values()))
    if stage == "slam":
        _, first, index = np.unique(rows[:, :2], axis=0, return_index=True, return_inverse=True)
        again = first[index.ravel()] != np.arange(len(rows))
        _refuse(table, "stop", values["stop"], again, "is in the scene already; one row a stop is allowed")
    return Submission(rows[:, :2], rows[:, 2:])


def _refuse(table: MeasuredTable, name: str, value: FloatArray, is_bad: BoolArray, allowed: str) -> None:
    if is_bad.any():
        row = int(np.argmax(is_bad))
        raise table.wrong(row, name, f"{value[row]:g}", allowed)
