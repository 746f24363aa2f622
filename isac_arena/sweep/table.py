"""The results of a sweep as one long table, CSV and Parquet, and the mean at each point of the design."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from isac_arena.campaign.files import complete_file, write_text
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
    """One row per metric and finished case, one for a case that failed, in the order of the cases and metrics.

    `failures` holds the error of a failed case by its key. Cases that are neither done nor failed have no row.

    Raises `ValueError` where the scores of a case are not as they were written.
    """
    rows: list[Row] = []
    for case in cases:
        values = {
            axis.label or axis.field: value for axis, value in zip(config.axes, case.values, strict=True)
        }
        head = {"case": case.key, "point": case.point, "repeat": case.repeat, "seed": case.seed}
        if is_done(directory, case.key):
            metrics = read_scores(directory, case.key)
            rows += [{**head, "status": "done", "error": None, **values, **metric} for metric in metrics]
        elif case.key in failures:
            nothing = dict.fromkeys(METRIC_COLUMNS)
            rows.append({**head, "status": "failed", "error": failures[case.key], **values, **nothing})
    return rows


def write_tables(directory: Path, config: SweepConfig, rows: Sequence[Row]) -> None:
    """Write results.csv and results.parquet; the same rows give the same bytes."""
    columns = (*CASE_COLUMNS, *(axis.label or axis.field for axis in config.axes), *METRIC_COLUMNS)
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(directory / "results.csv", text.getvalue())
    table = pa.table({name: _column([row[name] for row in rows]) for name in columns})
    with complete_file(directory / "results.parquet") as partial:
        pq.write_table(table, partial)


def spread(rows: Iterable[Row], metric: str, confidence: float = 0.95) -> dict[int, Spread]:
    """Mean of one metric over the repeats of every point, with Student's t interval; by point.

    A point with one value only has an infinite half width; values that could not be measured do not count.
    """
    values: dict[int, list[float]] = {}
    for row in rows:
        if row["key"] == metric and row["value"] is not None:
            values.setdefault(row["point"], []).append(float(row["value"]))
    return {point: Spread(*mean_interval(np.array(found), confidence)) for point, found in values.items()}


def _column(values: list[Any]) -> pa.Array:
    """A column of numbers or truth values as they are, everything else as text."""
    known = [value for value in values if value is not None]
    if all(isinstance(value, bool) for value in known) or all(isinstance(value, str) for value in known):
        return pa.array(values)
    if all(isinstance(value, int) and not isinstance(value, bool) for value in known):
        return pa.array(values, pa.int64())
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in known):
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    return pa.array([None if value is None else json.dumps(value) for value in values], pa.string())
