"""Records as xarray and pandas objects."""

from collections.abc import Mapping
from dataclasses import fields
from functools import cached_property, singledispatch
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from isac_arena.scoring.metrics.metric import to_json
from isac_arena.scoring.score import Scores
from scenes.inventory import scene_inventory
from scenes.record import FIXED_AXES, Record, columns, is_optional, parts_of
from scenes.scene import Scene

LONGEST_SPREAD = 5  # a second axis of this length becomes columns of a table, a longer one is left out


@singledispatch
def to_xarray(thing: Any) -> Any:
    """A Dataset whose variables have `units` and `long_name`; a DataTree where records are inside.

    Scores are a Dataset of all metrics (metric,), with the tables behind them as its groups. A scene is a Dataset
    of its objects and meshes (object,), their corners (corner,), its TXs (tx,) and stops (stop,).
    """
    raise TypeError(f"{type(thing).__name__} holds no arrays of its own; its parts: {_parts_of_kind(thing)}")


@to_xarray.register
def _(record: Record) -> Any:
    variables = {
        name: (axes, values, {"units": about["unit"], "long_name": about["doc"]})
        for name, axes, values, about in columns(record)
    }
    dataset, inner = xr.Dataset(variables, attrs={"record": type(record).__name__}), parts_of(record)
    return _with_groups(dataset, inner) if inner else dataset


@to_xarray.register
def _(thing: Scores) -> Any:
    meanings = {"value": "the score, NaN where unmeasured", "unit": "of the value", "direction": "that is better"}
    variables = {
        name: ("metric", [getattr(metric, name) for metric in thing.metrics], {"long_name": about})
        for name, about in meanings.items()
    }
    dataset = xr.Dataset(
        variables, {"metric": [metric.key for metric in thing.metrics]}, attrs={"record": "Scores"}
    )
    return _with_groups(dataset, {} if thing.tables is None else parts_of(thing.tables))


@to_xarray.register
def _(thing: Scene) -> Any:
    return to_xarray(scene_inventory(thing))


def _with_groups(dataset: xr.Dataset, inner: Mapping[str, Record]) -> xr.DataTree:
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


@to_dataframe.register
def _(thing: Scene) -> pd.DataFrame:
    return to_dataframe(scene_inventory(thing))


def _no_table(thing: Any) -> TypeError:
    """The error that names the parts, some of which are tables."""
    name = type(thing).__name__
    if isinstance(thing, Record):
        parts = ", ".join(parts_of(thing))
        return TypeError(f"{name} is no table; use to_xarray{f', or one of its parts: {parts}' if parts else ''}")
    parts = _parts_of_kind(thing)
    return TypeError(f"{name} is no table{f'; its parts: {parts}' if parts else ''}")


def _parts_of_kind(thing: Any) -> str:
    """The properties of the class of a thing."""
    kinds = {
        part: each for kind in reversed(type(thing).__mro__) for part, each in vars(kind).items() if part[0] != "_"
    }
    return ", ".join(part for part, each in kinds.items() if isinstance(each, property | cached_property))
