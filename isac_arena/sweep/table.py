"""The results of a sweep as one long table, CSV and Parquet, and the mean at each point of the design."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from isac_arena.campaign.files import complete_file, write_csv
from isac_arena.report.sweep.results import mean_interval
from isac_arena.sweep.config import SweepConfig
from isac_arena.sweep.store import PlannedCase, is_done, read_scores

CASE_COLUMNS = ("case", "point", "repeat", "seed", "status", "error")
METRIC_COLUMNS = ("key", "value", "unit", "direction")

Row = dict[str, Any]


@dataclass(frozen=True)
class Spread:
    """Mean of a metric over the repeats of a point, and half the width of its confidence interval."""

    mean: float
    half_width: float
    n: int


def result_rows(
    directory: Path, config: SweepConfig, cases: Iterable[PlannedCase], failures: Mapping[str, str]
) -> list[Row]:
    """One row per metric and finished case, one row per failed case, in the order of the cases and metrics.

    `failures` holds the errors of failed cases by their key. Cases that are neither done nor failed have no row.

    Raises `ValueError` where the scores of a case are not as they were written.
    """
    rows: list[Row] = []
    for case in cases:
        values = dict(zip(axis_names(config), case.values, strict=True))
        head = {"case": case.key, "point": case.point, "repeat": case.repeat, "seed": case.seed}
        if is_done(directory, case.key):
            metrics = read_scores(directory, case.key)
            rows += [{**head, "status": "done", "error": None, **values, **metric} for metric in metrics]
        elif case.key in failures:
            nothing = dict.fromkeys(METRIC_COLUMNS)
            rows.append({**head, "status": "failed", "error": failures[case.key], **values, **nothing})
    return rows


def axis_names(config: SweepConfig) -> list[str]:
    """What tables and figures call the axes."""
    return [axis.label or axis.field for axis in config.axes]


def write_tables(directory: Path, config: SweepConfig, rows: Sequence[Row]) -> None:
    """Write results.csv and results.parquet; the same rows give the same bytes."""
    columns = (*CASE_COLUMNS, *axis_names(config), *METRIC_COLUMNS)
    write_csv(directory / "results.csv", rows, columns)
    table = pa.table({name: _column([row[name] for row in rows]) for name in columns})
    with complete_file(directory / "results.parquet") as partial:
        pq.write_table(table, partial)


def mean_with_interval(rows: Iterable[Row], metric: str, confidence: float = 0.95) -> dict[int, Spread]:
    """Mean of one metric over the repeats of every point, with Student's t interval; by point.

    A point with one value has an infinite half width; values that could not be measured do not count.
    """
    values: dict[int, list[float]] = {}
    for row in rows:
        if row["key"] == metric and row["value"] is not None:
            values.setdefault(row["point"], []).append(float(row["value"]))
    return {point: Spread(*mean_interval(np.array(found), confidence)) for point, found in values.items()}


def _column(values: list[Any]) -> pa.Array:
    """A column of numbers or truth values as they are, everything else as text."""
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {bool} or kinds <= {str}:
        return pa.array(values)
    if kinds <= {int}:
        return pa.array(values, pa.int64())
    if kinds <= {int, float}:
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    return pa.array([None if value is None else json.dumps(value) for value in values], pa.string())
