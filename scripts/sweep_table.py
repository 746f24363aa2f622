"""The results of a sweep as one long table, CSV and Parquet, and what they say about each point of the design."""

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
from scipy.stats import t as student

from scripts.sweep_config import SweepConfig
from scripts.sweep_run import Job
from sim.store import complete_file, write_text

CASE_COLUMNS = ("case", "point", "repeat", "seed", "status", "error")
METRIC_COLUMNS = ("key", "value", "unit", "direction")

Row = dict[str, Any]


@dataclass(frozen=True)
class Spread:
    """Mean of a metric over the repeats of a point, and half the width of its confidence interval."""

    mean: float
    half_width: float
    n: int


def result_rows(config: SweepConfig, jobs: Iterable[Job], failures: Mapping[str, str]) -> list[Row]:
    """One row per metric and finished case, one for a case that failed, ordered by point, repeat and metric.

    `failures` holds the error of a failed case by its key. Cases that are neither done nor failed have no row.
    """
    rows: list[Row] = []
    for job in sorted(jobs, key=lambda job: (job.case.point, job.case.repeat)):
        values = {
            axis.label or axis.field: value for axis, value in zip(config.axes, job.case.values, strict=True)
        }
        head = {
            "case": job.key,
            "point": job.case.point,
            "repeat": job.case.repeat,
            "seed": job.case.config.seed,
        }
        if job.is_done:
            metrics = json.loads((job.directory / "scores.json").read_text(encoding="utf-8"))
            rows += [{**head, "status": "done", "error": None, **values, **metric} for metric in metrics]
        elif job.key in failures:
            nothing = dict.fromkeys(METRIC_COLUMNS)
            rows.append({**head, "status": "failed", "error": failures[job.key], **values, **nothing})
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

    A point with one value only has an infinite half width; values that could not be measured are left out.
    """
    values: dict[int, list[float]] = {}
    for row in rows:
        if row["key"] == metric and row["value"] is not None:
            values.setdefault(row["point"], []).append(float(row["value"]))
    return {point: _spread(np.array(found), confidence) for point, found in values.items()}


def _spread(found: Any, confidence: float) -> Spread:
    n = len(found)
    if n < 2:
        return Spread(float(found.mean()), float("inf"), n)
    error = float(found.std(ddof=1)) / np.sqrt(n)
    return Spread(float(found.mean()), float(student.ppf((1 + confidence) / 2, n - 1) * error), n)


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
