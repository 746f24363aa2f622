"""One score: a key that never changes, a value, its unit, and the direction that is better."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

Direction = Literal["lower", "higher", "info"]
SHARES = ("share", "rate", "coverage95", "iou", "accuracy", "purity")  # how keys of scores from 0 to 1 end


@dataclass(frozen=True)
class Metric:
    """A named score. A score that could not be measured keeps its key and has the value NaN.

    `direction` says which values are better; "info" marks counts and values with a target, such as coverage.

    Raises `ValueError` for an empty key or an unknown direction.
    """

    key: str
    value: float
    unit: str
    direction: Direction

    def __post_init__(self) -> None:
        if not self.key:
            raise ValueError("Metric.key = '': must not be empty")
        if self.direction not in get_args(Direction):
            raise ValueError(
                f"Metric.direction = '{self.direction}' of '{self.key}': "
                f"must be one of {', '.join(get_args(Direction))}"
            )
        object.__setattr__(self, "value", float(self.value))


def is_share(key: str) -> bool:
    """Whether the score of a key, or its mean over objects, lies between 0 and 1 by its definition."""
    return key.removesuffix(".mean").endswith(SHARES)


def to_json(metrics: Iterable[Metric]) -> list[dict[str, Any]]:
    """Rows {key, value, unit, direction} for JSON; a value that is not finite becomes None."""
    return [
        {
            "key": metric.key,
            "value": metric.value if math.isfinite(metric.value) else None,
            "unit": metric.unit,
            "direction": metric.direction,
        }
        for metric in metrics
    ]


def from_json(rows: Iterable[Mapping[str, Any]]) -> tuple[Metric, ...]:
    """The inverse of `to_json`; `ValueError` names the row where a field is missing."""
    metrics = []
    for index, row in enumerate(rows):
        missing = [name for name in ("key", "value", "unit", "direction") if name not in row]
        if missing:
            raise ValueError(f"metrics[{index}]: '{missing[0]}' is missing")
        value = math.nan if row["value"] is None else float(row["value"])
        metrics.append(Metric(row["key"], value, row["unit"], row["direction"]))
    return tuple(metrics)
