"""Tables of measured paths, a row per path: columns with units, made into stops."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from isac_arena.campaign.measured import MeasuredFile, MeasuredStop
from isac_arena.exchange.path_columns import read_columns
from isac_arena.exchange.table import ANGLE, MeasuredTable, table_of
from scenes.pose import LARGEST_LENGTH_M, SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, FloatArray, IntArray
from scenes.walks.tum import MAX_STOPS

C = SPEED_OF_LIGHT_M_S
DELAY = {"delay_s": C, "delay_ns": 1e-9 * C, "range_m": 1.0}  # in m
PARAMETERS = ("delay", "aod_azimuth", "aoa_azimuth", "aod_elevation", "aoa_elevation")
LABELS = {"": 0, "none": 0, "other": 0, "los": 1, "single_bounce": 2}
LARGEST_DBM = 300.0  # either sign
MIN_STD_M, MIN_STD_RAD = 1e-6, 1e-7  # smaller ones are rounding, or another unit

# Every column with its meaning; docs/exchange.md has the same list.
COLUMNS: dict[str, str] = {
    "stop": "whole number of the stop",
    "delay_s, delay_ns or range_m": "time of arrival with the clock bias, or its length",
    "aod_azimuth_rad or _deg": "azimuth of departure, relative to the TX heading",
    "aoa_azimuth_rad or _deg": "azimuth of arrival, relative to the receiver's heading",
    "power_dbm": "received power",
    "rx_x_m, rx_y_m": "optional: surveyed position of the receiver, the same in all rows of a stop",
    "rx_heading_rad or _deg": "optional: its heading in the world frame; without pose there is SLAM alone",
    "rx_z_m": "optional: its height; by default that of the TX",
    "tx_x_m, tx_y_m, tx_heading_rad or _deg": "optional: pose of the TX, the same in all rows; else the scene's",
    "tx_z_m": "optional: its height; else the scene's",
    "clock_bias_s or _ns": "optional: clock bias of the stop, which the delays contain; empty: unknown; default 0",
    "aod_elevation_rad or _deg, aoa_elevation_rad or _deg": "optional, both: elevations",
    "delay_std_s, delay_std_ns or range_std_m": "optional: standard deviation",
    "aod_azimuth_std_rad or _deg, and aoa_azimuth, aod_elevation, aoa_elevation": "optional: the same of angles",
    "correlation_delay_aod_azimuth, and of all other pairs": "optional: correlations of the errors, by default 0",
    "is_los": "optional: 1 where the estimator took the path as line of sight; by default the label",
    "label": "optional: los, single_bounce or none; as numbers 1, 2, 0",
    "ip_x_m, ip_y_m": "optional: true incidence point of a labelled single bounce",
}


def read_table(file: Path) -> MeasuredTable:
    """The table in a CSV, Parquet, MATLAB or netCDF file; `ValueError`, one line, where it holds none."""
    table = table_of(file, read_columns(file), _known_names())
    if not len(next(iter(table.columns.values()), ())):
        raise ValueError(f"{file}: holds no rows; a table of paths is needed")
    return table


def measured_file(table: MeasuredTable, scene_tx: Pose) -> MeasuredFile:
    """The TX and the stops of a table, numbered in the order of their numbers in it; what is missing of the TX is
    that of the scene. Raises `ValueError`: file, row, column, value and what is allowed.
    """
    stop = table.needed({"stop": 1.0})
    odd = np.flatnonzero(stop != np.round(stop))
    if len(odd):
        raise table.wrong(int(odd[0]), "stop", stop[odd[0]], "must be a whole number")
    numbers, first, index = np.unique(stop, return_index=True, return_inverse=True)
    if len(numbers) > MAX_STOPS:
        raise ValueError(f"{table.file}: holds {len(numbers)} stops, at most {MAX_STOPS} are read")
    tx = _tx_pose(table, scene_tx)
    rx = _receivers(table, first, index, float(tx.position_m[2]))
    bias_s = _clock_s(table, rx, first, index)
    range_m = table.needed(DELAY)
    if bias_s is not None:
        range_m = range_m - C * np.nan_to_num(bias_s[index])
    azimuths = [table.angle(name, needed=True) for name in ("aod_azimuth", "aoa_azimuth")]
    measured = np.column_stack([range_m, *(one for one in azimuths if one is not None)])
    power_dbm = table.needed({"power_dbm": 1.0})
    _within(table, LARGEST_LENGTH_M, "m", {"the length": range_m})
    _within(table, LARGEST_DBM, "dBm", {"power_dbm": power_dbm})
    label, flags = _labels(table), _flags(table, "is_los")
    _one_los(table, "label", label == LABELS["los"], index)
    _one_los(table, "is_los", flags, index)
    rows = _PathRows(
        measured=measured,
        power_dbm=power_dbm,
        label=label,
        landmark_m=_landmarks(table, label == LABELS["single_bounce"]),
        elevation_rad=_elevations(table),
        covariance=_covariances(table),
        is_los=flags,
    )
    order = np.argsort(index, kind="stable")
    at_stops = np.split(order, np.cumsum(np.bincount(index, minlength=len(numbers)))[:-1])
    stops = [rows.stop(members, rx[k]) for k, members in enumerate(at_stops)]
    return MeasuredFile(tx, stops, None if bias_s is None else C * bias_s)


@dataclass(frozen=True)
class _PathRows:
    """The columns of all paths, in SI units."""

    measured: FloatArray
    power_dbm: FloatArray
    label: IntArray
    landmark_m: FloatArray
    elevation_rad: FloatArray | None
    covariance: FloatArray | None
    is_los: BoolArray | None

    def stop(self, rows: IntArray, rx: FloatArray) -> MeasuredStop:
        """The stop of some rows, with the receiver's x, y, z and heading."""
        is_single = self.label[rows] == LABELS["single_bounce"]
        return MeasuredStop(
            rx=np.array([rx[0], rx[1], rx[3]]),
            measured=self.measured[rows],
            power_dbm=self.power_dbm[rows],
            is_los=self.label[rows] == LABELS["los"],
            is_single_bounce=is_single,
            landmark_m=self.landmark_m[rows],
            height_m=float(rx[2]),
            covariance=None if self.covariance is None else self.covariance[rows],
            elevation_rad=None if self.elevation_rad is None else self.elevation_rad[rows],
            is_los_estimate=None if self.is_los is None else self.is_los[rows],
        )


def _tx_pose(table: MeasuredTable, scene_tx: Pose) -> Pose:
    x_m, y_m = (table.scaled({f"tx_{axis}_m": 1.0}) for axis in "xy")
    heading_rad = table.angle("tx_heading")
    height_m = table.scaled({"tx_z_m": 1.0})
    given = {"tx_x_m": x_m, "tx_y_m": y_m, "tx_heading": heading_rad}
    missing = [name for name, value in given.items() if value is None]
    if 0 < len(missing) < len(given):
        raise ValueError(
            f"{table.file}: {missing[0]} is missing: give tx_x_m, tx_y_m and tx_heading, or none of them"
        )
    for name, value in {**given, "tx_z_m": height_m}.items():
        if value is not None and np.any(value != value[0]):
            row = int(np.argmax(value != value[0]))
            raise table.wrong(row, name, value[row], "the TX moves; only a TX at rest is known")
    z_m = scene_tx.position_m[2] if height_m is None else height_m[0]
    if x_m is None or y_m is None or heading_rad is None:
        return Pose(np.array([*scene_tx.position_m[:2], z_m]), scene_tx.heading_rad)
    return Pose(np.array([x_m[0], y_m[0], z_m]), float(heading_rad[0]))


def _receivers(table: MeasuredTable, first: IntArray, index: IntArray, tx_height_m: float) -> FloatArray:
    """x, y, z and heading (stop, 4) of the receiver; NaN where the table has no poses."""
    if not table.has("rx_x_m", "rx_y_m", "rx_heading_rad", "rx_heading_deg"):
        return np.full((len(first), 4), np.nan)
    heading_rad = table.angle("rx_heading", needed=True)
    columns = [table.needed({f"rx_{axis}_m": 1.0}) for axis in "xy"]
    height_m = table.scaled({"rx_z_m": 1.0})
    height_m = np.full(len(index), tx_height_m) if height_m is None else height_m
    assert heading_rad is not None
    places = {"rx_x_m": columns[0], "rx_y_m": columns[1], "rx_z_m": height_m}
    _within(table, LARGEST_LENGTH_M, "m", places)
    named = {**places, "rx_heading": heading_rad}
    for name, value in named.items():
        _same_at_stops(table, name, value, first, index)
    return np.column_stack(list(named.values()))[first]


def _clock_s(table: MeasuredTable, rx: FloatArray, first: IntArray, index: IntArray) -> FloatArray | None:
    """Clock bias (stop,), NaN where it is not known: an empty cell, or no pose and no column; else None is 0."""
    bias_s = table.scaled({"clock_bias_s": 1.0, "clock_bias_ns": 1e-9}, may_lack=True)
    if bias_s is None:
        return np.full(len(first), np.nan) if np.isnan(rx).all() else None
    _same_at_stops(table, "clock_bias", bias_s, first, index)
    return bias_s[first]


def _within(table: MeasuredTable, most: float, unit: str, columns: dict[str, FloatArray]) -> None:
    for name, value in columns.items():
        far = np.flatnonzero(np.abs(value) > most)
        if len(far):
            raise table.wrong(int(far[0]), name, f"{value[far[0]]:g}", f"must be within {most:g} {unit}")


def _one_los(table: MeasuredTable, name: str, is_los: BoolArray | None, index: IntArray) -> None:
    rows = np.flatnonzero(is_los) if is_los is not None else np.zeros(0, int)
    _, first, stop = np.unique(index[rows], return_index=True, return_inverse=True)
    again = np.flatnonzero(first[stop] != np.arange(len(rows)))
    if len(again):
        row, other = int(rows[again[0]]), int(rows[first[stop[again[0]]]]) + 1
        value = table.columns[name][row]
        raise table.wrong(
            row, name, value, f"the line of sight of this stop is in row {other}; there is one at most"
        )


def _same_at_stops(table: MeasuredTable, name: str, value: FloatArray, first: IntArray, index: IntArray) -> None:
    wanted = value[first][index]
    other = np.flatnonzero((value != wanted) & ~(np.isnan(value) & np.isnan(wanted)))
    if len(other):
        row = int(other[0])
        start = int(first[index[row]]) + 1
        raise table.wrong(row, name, value[row], f"differs from row {start} of the same stop")


def _elevations(table: MeasuredTable) -> FloatArray | None:
    both = [table.angle(name, most_deg=90.0) for name in ("aod_elevation", "aoa_elevation")]
    found = [one for one in both if one is not None]
    if len(found) == 1:
        raise ValueError(f"{table.file}: aod_elevation, aoa_elevation: give both, or none of them")
    return np.column_stack(found) if found else None


def _covariances(table: MeasuredTable) -> FloatArray | None:
    """Covariances (path, 3, 3), or (path, 5, 5) with elevations, in (s, rad, ...)^2; None where none are given."""
    names = PARAMETERS if table.has("aod_elevation_rad", "aod_elevation_deg") else PARAMETERS[:3]
    std: list[FloatArray] = []
    for name in names:
        if name == "delay":
            value = table.scaled({"delay_std_s": C, "delay_std_ns": 1e-9 * C, "range_std_m": 1.0})
        else:
            value = table.angle(f"{name}_std")
        if value is not None:
            least, most = (MIN_STD_M, LARGEST_LENGTH_M) if name == "delay" else (MIN_STD_RAD, 2 * np.pi)
            bad = np.flatnonzero((value < least) | (value > most))
            if len(bad):
                unit = "m" if name == "delay" else "rad"
                allowed = f"must be within {least:g} and {most:g} {unit}"
                raise table.wrong(int(bad[0]), f"{name}_std", f"{value[bad[0]]:g} {unit}", allowed)
            std.append(value)
    if not std:
        return None
    if len(std) < len(names):
        wanted = ", ".join(f"{name}_std" for name in names)
        raise ValueError(f"{table.file}: give the standard deviations of all parameters, or of none: {wanted}")
    shares = np.tile(np.eye(len(names)), (len(std[0]), 1, 1))
    for row, one in enumerate(names):
        for column, other in enumerate(names[:row]):
            value = table.scaled({f"correlation_{other}_{one}": 1.0})
            if value is not None:
                shares[:, row, column] = shares[:, column, row] = value
    bad = np.flatnonzero(np.linalg.eigvalsh(shares).min(axis=1) <= 0)
    if len(bad):
        raise table.wrong(int(bad[0]), "correlation", "they", "must make a positive definite covariance")
    std[0] = std[0] / C
    scale = np.column_stack(std)
    return np.asarray(shares * scale[:, :, None] * scale[:, None, :])


def _labels(table: MeasuredTable) -> IntArray:
    if "label" not in table.columns:
        n = len(next(iter(table.columns.values())))
        return np.zeros(n, int)
    found = np.zeros(len(table.columns["label"]), int)
    for row, value in enumerate(table.columns["label"].tolist()):
        known = _label(value)
        if known is None:
            raise table.wrong(row, "label", value, "must be los, single_bounce or none; or 1, 2, 0")
        found[row] = known
    return found


def _label(value: Any) -> int | None:
    if isinstance(value, str):
        word = value.strip().lower()
        return LABELS.get(word, int(word) if word in ("0", "1", "2") else None)
    if value is None or str(value) == "nan":  # an empty cell
        return 0
    return int(value) if value in (0, 1, 2) else None


def _flags(table: MeasuredTable, name: str) -> BoolArray | None:
    if name not in table.columns:
        return None
    value = table.numbers(name)
    bad = np.flatnonzero((value != 0) & (value != 1))
    if len(bad):
        raise table.wrong(int(bad[0]), name, value[bad[0]], "must be 0 or 1")
    return np.asarray(value == 1)


def _landmarks(table: MeasuredTable, is_single: BoolArray) -> FloatArray:
    """Incidence points (path, xy), NaN where a single bounce has none."""
    n = len(next(iter(table.columns.values())))
    columns = [table.numbers(f"ip_{axis}_m") for axis in "xy" if table.has(f"ip_{axis}_m")]
    if len(columns) == 1:
        raise ValueError(f"{table.file}: ip_x_m, ip_y_m: give both, or none of them")
    found = np.column_stack(columns) if columns else np.full((n, 2), np.nan)
    found[~is_single] = np.nan
    _within(table, LARGEST_LENGTH_M, "m", {"ip_x_m": found[:, 0], "ip_y_m": found[:, 1]})
    half = np.flatnonzero(np.isnan(found).any(axis=1) & ~np.isnan(found).all(axis=1))
    if len(half):
        column = "xy"[int(np.isnan(found[half[0], 1]))]
        raise table.wrong(int(half[0]), f"ip_{column}_m", "nan", "give both, ip_x_m and ip_y_m, or none of them")
    return found


def _known_names() -> Sequence[str]:
    """All column names that are read."""
    angles = ["aod_azimuth", "aoa_azimuth", "aod_elevation", "aoa_elevation", "rx_heading", "tx_heading"]
    angles += [f"{name}_std" for name in PARAMETERS[1:]]
    plain = ["stop", "power_dbm", "is_los", "label", "clock_bias_s", "clock_bias_ns", "ip_x_m", "ip_y_m"]
    plain += [f"{end}_{axis}_m" for end in ("tx", "rx") for axis in "xyz"]
    plain += [*DELAY, "delay_std_s", "delay_std_ns", "range_std_m"]
    pairs = [f"correlation_{one}_{other}" for k, one in enumerate(PARAMETERS) for other in PARAMETERS[k + 1 :]]
    return [*plain, *pairs, *(f"{name}_{unit}" for name in angles for unit in ANGLE)]
