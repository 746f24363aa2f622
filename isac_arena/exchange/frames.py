"""Records as xarray and pandas objects."""

from dataclasses import fields
from functools import cached_property, singledispatch
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from isac_arena.scoring.metrics.metric import to_json
from isac_arena.scoring.score import Scores
from scenes.record import FIXED_AXES, Record, columns, is_optional, parts_of

LONGEST_SPREAD = 5  # a second axis of this length becomes columns of a table, a longer one is left out


def to_xarray(record: Record) -> Any:
    """A Dataset whose variables have `units` and `long_name`; a DataTree where records are inside the record."""
    variables = {
        name: (axes, values, {"units": about["unit"], "long_name": about["doc"]})
        for name, axes, values, about in columns(record)
    }
    dataset, inner = xr.Dataset(variables, attrs={"record": type(record).__name__}), parts_of(record)
    if not inner:
        return dataset
    trees = {name: to_xarray(part) for name, part in inner.items()}
    return xr.DataTree(dataset, {n: t if isinstance(t, xr.DataTree) else xr.DataTree(t) for n, t in trees.items()})


@singledispatch
def to_dataframe(thing: Any) -> pd.DataFrame:
    """A row per element of the first axis; short further axes become columns such as `position_x_m`.

    Texts of the whole record, such as the method, are in `attrs` of the table.
    """
    raise _no_table(thing)


@to_dataframe.register
def _(thing: Record) -> pd.DataFrame:
    first = next((axes for _, axes, _, _ in columns(thing) if axes), ())
    added = {spec.name for spec in fields(thing) if is_optional(spec)}  # records with the rows of this one
    if len(first) != 1 or set(parts_of(thing)) - added:
        raise _no_table(thing)
    table: dict[str, Any] = {}
    texts: dict[str, Any] = {}
    records = thing, *parts_of(thing).values()
    for name, axes, values, _ in (column for record in records for column in columns(record)):
        if not axes and values.dtype.kind == "U":
            texts[name] = values.item()
        elif not axes:
            table[name] = np.full(thing.size(first[0]), values)
        elif axes == first:
            table[name] = values
        elif axes[0] == first[0] and len(axes) == 2 and values.shape[1] <= LONGEST_SPREAD:
            stem, _, unit = name.rpartition("_")
            letters = axes[1] if axes[1] in FIXED_AXES else map(str, range(values.shape[1]))
            for letter, column in zip(letters, values.T, strict=True):
                table[f"{stem}_{letter}_{unit}" if stem else f"{name}_{letter}"] = column
    frame = pd.DataFrame(table)
    frame.attrs.update(texts)
    return frame


@to_dataframe.register
def _(thing: Scores) -> pd.DataFrame:
    return pd.DataFrame(to_json(thing.metrics), columns=["key", "value", "unit", "direction"])


def _no_table(thing: Any) -> TypeError:
    """The error that names the parts, some of which are tables."""
    name = type(thing).__name__
    if isinstance(thing, Record):
        parts = ", ".join(parts_of(thing))
        return TypeError(f"{name} is no table; use to_xarray{f', or one of its parts: {parts}' if parts else ''}")
    kinds = {
        part: each for kind in reversed(type(thing).__mro__) for part, each in vars(kind).items() if part[0] != "_"
    }
    parts = ", ".join(part for part, each in kinds.items() if isinstance(each, property | cached_property))
    return TypeError(f"{name} is no table{f'; its parts: {parts}' if parts else ''}")
