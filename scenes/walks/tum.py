"""Trajectories in the TUM format: lines of `time x y z qx qy qz qw` in s and m, with a unit quaternion."""

import numpy as np

from scenes.pose import wrap_angle
from scenes.record import FloatArray

N_COLUMNS = 8
MAX_STOPS = 100_000
MAX_TILT = 0.02  # largest share of qx and qy: beyond it the device is not upright


def tum_text(time_s: FloatArray, position_m: FloatArray, heading_rad: FloatArray) -> str:
    """TUM text of times (stop,), positions (stop, xyz) and headings (stop,), without rows that are not finite."""
    table = np.column_stack([time_s, position_m, np.zeros((len(time_s), 2))])
    table = np.column_stack([table, np.sin(heading_rad / 2), np.cos(heading_rad / 2)])
    rows = table[np.isfinite(table).all(axis=1)]
    lines = (" ".join(f"{value:.9g}" for value in row) for row in rows)
    return "".join(f"{line}\n" for line in ("# time_s x_m y_m z_m qx qy qz qw", *lines))


def parse_tum(text: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (stop,) in s, positions (stop, xyz) in m and headings (stop,) in rad of a text.

    Empty lines and lines that start with # are ignored. Raises `ValueError` with the line number if a line does
    not have eight finite numbers, its quaternion has no length, or the device is tilted; also if no line exists.
    """
    numbered = [
        (number, line)
        for number, line in enumerate(text.replace(",", " ").splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not numbered:
        raise ValueError("there is no pose: at least one is needed")
    if len(numbered) > MAX_STOPS:
        raise ValueError(f"{len(numbered)} poses: at most {MAX_STOPS} are read")
    table = np.array([_row(line) for _, line in numbered])
    number = np.array([number for number, _ in numbered])
    length = np.linalg.norm(table[:, 4:], axis=1)
    tilted = (length == 0) | (np.hypot(table[:, 4], table[:, 5]) > MAX_TILT * length)
    for wrong, what in (
        (~np.isfinite(table).all(axis=1), "must be eight finite numbers, time x y z qx qy qz qw"),
        (tilted, "the quaternion must turn about the vertical: qx = qy = 0"),
    ):
        if wrong.any():
            raise ValueError(f"line {number[np.argmax(wrong)]}: {what}")
    return table[:, 0], table[:, 1:4], np.asarray(wrap_angle(2 * np.arctan2(table[:, 6], table[:, 7])))


def _row(line: str) -> list[float]:
    """The eight numbers of a line, NaN where it holds something else."""
    try:
        row = [float(cell) for cell in line.split(maxsplit=N_COLUMNS)]
    except ValueError:
        row = []
    return row if len(row) == N_COLUMNS else [np.nan] * N_COLUMNS
