"""Records to netCDF-4 files and back: named axes become dimensions, units and meanings become attributes.

A complex field `x` is written as two variables `x_re` and `x_im`, so every netCDF or HDF5 reader understands it;
a record inside a record is a group. Files appear under their name only when they are complete.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np
import xarray as xr

from scenes.record import Record

R = TypeVar("R", bound=Record)


@contextmanager
def complete_file(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its name when the block ends without an error.

    Raises `OSError` where the folder cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files in a folder (not below it) whose writing process is gone."""
    for leftover in folder.glob(".*.part"):
        match = re.fullmatch(r"\..+\.(\d+)\.part", leftover.name)
        if match and not _is_running(int(match[1])):
            leftover.unlink(missing_ok=True)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def write_text(path: Path, text: str) -> None:
    """Write a whole text file, or leave what was there."""
    with complete_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def write_record(path: Path, record: Record, attributes: Mapping[str, str] | None = None) -> None:
    """Write a record and the records inside it, with global `attributes`, as one netCDF-4 file."""
    groups = dict(_groups("/", record))
    groups["/"] = groups["/"].assign_attrs(dict(attributes or {}))
    with complete_file(path) as partial:
        xr.DataTree.from_dict(groups).to_netcdf(partial, engine="h5netcdf")


def read_record(path: Path, kind: type[R]) -> R:
    """Read a record of the given type from a file written by `write_record`.

    Raises
    ------
    FileNotFoundError
        Where the file is missing.
    ValueError
        Where the file is damaged or holds something else.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        with xr.open_datatree(path, engine="h5netcdf", decode_timedelta=False) as tree:
            return _from_tree(tree.load(), kind)
    except (OSError, KeyError, AttributeError) as error:
        raise ValueError(f"{path}: not a readable {kind.__name__} file ({error})") from error


def read_attribute(path: Path, name: str) -> str | None:
    """A global attribute of a netCDF file; None where the file or the attribute is missing or unreadable."""
    try:
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            value = dataset.attrs.get(name)
    except (OSError, KeyError, ValueError):
        return None
    return None if value is None else str(value)


def to_dataset(record: Record) -> xr.Dataset:
    """The record's own arrays as an xarray dataset; records inside it are left out."""
    dataset = xr.Dataset(attrs={"record": type(record).__name__})
    for spec in fields(record):
        if "axes" not in spec.metadata:
            continue
        attributes = {"units": spec.metadata["unit"], "long_name": spec.metadata["doc"]}
        value = np.asarray(getattr(record, spec.name))
        if value.dtype.kind == "U":
            value = value.astype(object)
        axes = spec.metadata["axes"]
        if value.dtype.kind == "c":
            dataset[f"{spec.name}_re"] = (axes, value.real, attributes)
            dataset[f"{spec.name}_im"] = (axes, value.imag, attributes)
        else:
            dataset[spec.name] = (axes, value, attributes)
    return dataset


def _groups(name: str, record: Record) -> Iterator[tuple[str, xr.Dataset]]:
    yield name, to_dataset(record)
    for spec in fields(record):
        value = getattr(record, spec.name)
        if isinstance(value, Record):
            yield from _groups(f"{name.rstrip('/')}/{spec.name}", value)


def _from_tree(tree: xr.DataTree, kind: type[R]) -> R:
    types = get_type_hints(kind)
    values: dict[str, Any] = {}
    for spec in fields(kind):
        if "axes" not in spec.metadata:
            values[spec.name] = _from_tree(tree.children[spec.name], types[spec.name])
        elif spec.metadata["dtype"].kind == "c":
            values[spec.name] = _variable(tree, f"{spec.name}_re") + 1j * _variable(tree, f"{spec.name}_im")
        else:
            values[spec.name] = _variable(tree, spec.name)
    return kind(**values)


def _variable(tree: xr.DataTree, name: str) -> Any:
    return tree.dataset[name].to_numpy()
