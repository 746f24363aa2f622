"""Tables: columns of numbers whose errors name file, row, column and value."""

from collections.abc import Collection
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.record import FloatArray

ANGLE = {"rad": 1.0, "deg": float(np.pi / 180)}


@dataclass(frozen=True)
class MeasuredTable:
    """The columns of a file, one value per row, and the names that have a meaning."""

    file: Path
    columns: dict[str, NDArray[Any]]
    known: Collection[str]

    @property
    def unused(self) -> list[str]:
        """Columns whose names have no meaning."""
        return sorted(set(self.columns) - set(self.known))

    def has(self, *names: str) -> bool:
        """Whether one of these columns is there."""
        return any(name in self.columns for name in names)

    def numbers(self, name: str) -> FloatArray:
        """A column as numbers; `ValueError` where it holds something else."""
        value = self.columns[name]
        try:
            return np.asarray(value, float)
        except (ValueError, TypeError):
            row = next(row for row, one in enumerate(value.tolist()) if not _is_number(one))
            raise self.wrong(row, name, value[row], "must be a number") from None

    def scaled(self, units: dict[str, float], *, may_lack: bool = False) -> FloatArray | None:
        """The one column of several units that is there, in the unit of factor 1; None where there is none.

        With `may_lack` a cell may be empty (NaN).
        """
        found = [name for name in units if name in self.columns]
        if len(found) > 1:
            raise ValueError(f"{self.file}: {found[0]}, {found[1]}: two columns for the same; leave one out")
        if not found:
            return None
        value = self.numbers(found[0])
        bad = np.flatnonzero(np.isinf(value) if may_lack else ~np.isfinite(value))
        if len(bad):
            raise self.wrong(int(bad[0]), found[0], value[bad[0]], "must be finite")
        return value if units[found[0]] == 1.0 else value * units[found[0]]

    def needed(self, units: dict[str, float]) -> FloatArray:
        """As `scaled`, for a column that has to be there."""
        value = self.scaled(units)
        if value is None:
            wanted = " or ".join(units)
            close = get_close_matches(next(iter(units)), self.unused, n=1)
            hint = f"; did you mean that by '{close[0]}'?" if close else f"; there are {', '.join(self.columns)}"
            raise ValueError(f"{self.file}: the column {wanted} is missing{hint[:300]}")
        return value

    def angle(self, name: str, *, needed: bool = False, most_deg: float = 360.0) -> FloatArray | None:
        """An angle in rad; `ValueError` where it is beyond `most_deg` on either side."""
        units = {f"{name}_{unit}": factor for unit, factor in ANGLE.items()}
        value = self.needed(units) if needed else self.scaled(units)
        unit = "rad" if f"{name}_rad" in self.columns else "deg"
        most = most_deg * ANGLE["deg"] / ANGLE[unit]
        far = np.flatnonzero(np.abs(value if value is not None else 0.0) > most_deg * ANGLE["deg"])
        if len(far):
            row, column = int(far[0]), f"{name}_{unit}"
            hint = (
                "; it looks like degrees" if unit == "rad" and most < abs(self.numbers(column)[row]) <= 360 else ""
            )
            raise self.wrong(
                row, column, self.columns[column][row], f"must be within -{most:.4g} and {most:.4g} {unit}{hint}"
            )
        return value

    def wrong(self, row: int, name: str, value: object, allowed: str) -> ValueError:
        """An error that names file, row (from 1), column and value."""
        return ValueError(f"{self.file}: row {row + 1}: {name} = {str(value)[:80]}: {allowed}")


def table_of(file: Path, columns: dict[str, NDArray[Any]], known: Collection[str]) -> MeasuredTable:
    """Columns as a table; `ValueError` where one is shorter than another."""
    sizes = {name: len(value) for name, value in columns.items()}
    first = next(iter(sizes), "")
    for name, size in sizes.items():
        if size != sizes[first]:
            raise ValueError(
                f"{file}: {name} has {size} values, {first} has {sizes[first]}: one per row is needed"
            )
    return MeasuredTable(file, columns, known)


def _is_number(value: Any) -> bool:
    try:
        float(value)
    except (ValueError, TypeError):
        return False
    return True
