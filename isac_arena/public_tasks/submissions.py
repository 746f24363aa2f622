"""Submissions: one table (CSV, Parquet, MATLAB, netCDF, NPZ) with a row per path, stop or point of a contour."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from isac_arena.exchange.path_columns import Columns, read_columns
from isac_arena.public_tasks.making import Stage
from scenes.record import FloatArray

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
    return submission_of(read_columns(file), stage, n_scenes, n_stops, str(file))


def submission_of(columns: Columns, stage: Stage, n_scenes: int, n_stops: int, name: str) -> Submission:
    """The rows of columns; raises as `read_submission`."""
    wanted = COLUMNS[stage]
    missing = [one for one in wanted if one not in columns]
    if missing:
        raise ValueError(f"{name}: the column {missing[0]} is missing; {stage} needs {', '.join(wanted)}")
    try:
        table = np.column_stack([np.asarray(columns[one], float) for one in wanted])
    except (ValueError, TypeError) as error:
        raise ValueError(
            f"{name}: {', '.join(wanted)} must be numbers, as many in each column ({error})"
        ) from error
    limits = {"scene": n_scenes, "stop": n_stops, "contour": np.inf}
    for place, one in enumerate(wanted):
        value = table[:, place]
        limit = limits.get(one)
        bad = (
            ~np.isfinite(value)
            if limit is None
            else ~((value == np.round(value)) & (value >= 0) & (value < limit))
        )
        if bad.any():
            row = int(np.argmax(bad))
            allowed = "must be finite" if limit is None else f"must be a whole number from 0 to {limit - 1:g}"
            raise ValueError(f"{name}: row {row + 1}: {one} = {value[row]:g}: {allowed}")
    return Submission(table[:, :2], table[:, 2:])
