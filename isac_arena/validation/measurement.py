"""One measured row of a validation or benchmark: a value, its unit, and the bar it has to meet."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, SupportsFloat


@dataclass(frozen=True)
class InfoTable:
    """Values beside the rows that have no bar: a table for a person, and for the JSON file."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str | float, ...], ...]  # one value per column


@dataclass(frozen=True)
class Measurement:
    """A measured value beside its bar. `direction` 'lower' wants value <= bar, 'higher' wants value >= bar."""

    key: str
    value: float
    unit: str
    direction: Literal["lower", "higher"]
    bar: float
    reason: str

    @property
    def met(self) -> bool:
        """Whether the value meets its bar; NaN meets none."""
        if math.isnan(self.value):
            return False
        return bool(self.value <= self.bar if self.direction == "lower" else self.value >= self.bar)


@dataclass(frozen=True)
class Measured:
    """What a check found, where it has more than rows."""

    rows: list[Measurement]
    tables: tuple[InfoTable, ...] = ()


def at_most(key: str, value: SupportsFloat, bar: float, reason: str, unit: str = "1") -> Measurement:
    """A row whose value must not exceed the bar."""
    return Measurement(key, float(value), unit, "lower", bar, reason)


def at_least(key: str, value: SupportsFloat, bar: float, reason: str, unit: str = "1") -> Measurement:
    """A row whose value must reach the bar."""
    return Measurement(key, float(value), unit, "higher", bar, reason)


def to_json(
    measurements: Iterable[Measurement], tables: Iterable[InfoTable] = ()
) -> dict[str, list[dict[str, Any]]]:
    """The rows as {"metrics": [{key, value, unit, direction, bar, met}]}; a value that is not finite is None.

    Tables follow as {"tables": [{title, columns, rows}]}, where there are any.
    """
    metrics = []
    for row in measurements:
        value = row.value if math.isfinite(row.value) else None
        about = {name: getattr(row, name) for name in ("unit", "direction", "bar", "met")}
        metrics.append({"key": row.key, "value": value, **about})
    content: dict[str, list[dict[str, Any]]] = {"metrics": metrics}
    for table in tables:
        rows = [
            [None if isinstance(cell, float) and not math.isfinite(cell) else cell for cell in row]
            for row in table.rows
        ]
        content.setdefault("tables", []).append({"title": table.title, "columns": table.columns, "rows": rows})
    return content
