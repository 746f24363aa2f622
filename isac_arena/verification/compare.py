"""How a result computed again compares with the stored one: the same bits, within a tolerance, or neither."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from scenes.record import Record

TOLERANCE = 1e-6  # of the largest value of an array: another order of sums, amplified by iterative solvers


@dataclass(frozen=True)
class Finding:
    """One result computed again against the stored one."""

    name: str
    difference: float  # largest of all arrays, relative to the largest value of the array; 0 for the same bits
    where: str = ""  # field of the largest difference
    reason: str = ""  # why they cannot be compared

    def holds(self, exact: bool) -> bool:
        """Whether the result agrees: bit by bit, or within the tolerance."""
        return not self.reason and self.difference <= (0.0 if exact else TOLERANCE)

    def line(self, exact: bool) -> str:
        """One line for the terminal."""
        if self.reason:
            return f"{self.name}: DIFFERS, {self.reason}"
        if self.difference == 0:
            return f"{self.name}: the same bits"
        verdict = f"within {TOLERANCE:g}" if self.difference <= TOLERANCE and not exact else "DIFFERS"
        return f"{self.name}: {verdict}, by {self.difference:.2g} of the largest value in {self.where}"


def compare_records(name: str, stored: Record, again: Record) -> Finding:
    """Compare all arrays of two records of one type."""
    return _worst(name, _pairs("", stored, again))


def compare_metrics(name: str, stored: Sequence[Mapping[str, Any]], again: Sequence[Mapping[str, Any]]) -> Finding:
    """Compare the rows of scores.json: the same keys in the same order, and their values."""
    keys = [[str(row["key"]) for row in rows] for rows in (stored, again)]
    if keys[0] != keys[1]:
        changed = sorted(set(keys[0]) ^ set(keys[1])) or ["their order"]
        return Finding(name, 0.0, reason=f"other metrics: {changed[0]}")
    values = [
        [np.array(np.nan if row["value"] is None else row["value"], float) for row in rows]
        for rows in (stored, again)
    ]
    return _worst(name, zip(keys[0], *values, strict=True))


def _worst(name: str, pairs: Iterable[tuple[str, Any, Any]]) -> Finding:
    """The first pair of arrays that cannot be compared, else the largest difference of all."""
    largest = Finding(name, 0.0)
    for where, one, other in pairs:
        finding = _compare(name, where, one, other)
        if finding.reason:
            return finding
        largest = max(largest, finding, key=lambda item: item.difference)
    return largest


def _pairs(prefix: str, stored: Record, again: Record) -> Iterator[tuple[str, Any, Any]]:
    for spec in fields(stored):
        one, other = getattr(stored, spec.name), getattr(again, spec.name)
        if isinstance(one, Record):
            yield from _pairs(f"{prefix}{spec.name}.", one, other)
        else:
            yield f"{prefix}{spec.name}", np.asarray(one), np.asarray(other)


def _compare(name: str, where: str, stored: Any, again: Any) -> Finding:
    if stored.shape != again.shape:
        return Finding(name, 0.0, reason=f"{where} has the shape {again.shape}, {stored.shape} is stored")
    if stored.dtype.kind not in "fc":
        same = bool(np.array_equal(stored, again))
        return Finding(name, 0.0, reason="" if same else f"{where} has other values")
    if stored.tobytes() == again.tobytes():
        return Finding(name, 0.0)
    finite = np.isfinite(stored)
    with np.errstate(invalid="ignore"):
        odd = ~finite & ~((stored == again) | (np.isnan(stored) & np.isnan(again)))
    if (finite != np.isfinite(again)).any() or odd.any():
        return Finding(name, 0.0, reason=f"{where} is finite in other places")
    scale = float(np.abs(stored[finite]).max(initial=0.0))
    distance = float(np.abs(stored[finite] - again[finite]).max(initial=0.0))
    return Finding(name, distance / scale if scale else distance, where)
