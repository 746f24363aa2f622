"""Records as netCDF-4 files, sealed.

Named axes become dimensions (HDF5 dimension scales), units and meanings become attributes, a record inside a
record is a group. A complex field `x` is stored as two variables `x_re` and `x_im`, so every netCDF or HDF5 reader
understands it.

Behind the end that HDF5 knows of stands a seal, a hash of all bytes before it. It is checked before anything else
is read: a file that changed on the disk since it was written could otherwise give other values, or none for ever.
"""

from __future__ import annotations

import hashlib
from collections.abc import Container, Iterator, Mapping
from dataclasses import fields
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import h5netcdf
import h5py
import numpy as np

from scenes.record import Record

R = TypeVar("R", bound=Record)

SEAL = b"sha256 "
SEAL_BYTES = len(SEAL) + 64
HASHED_AT_ONCE = 1 << 20


def to_netcdf(record: Record, attributes: Mapping[str, str]) -> bytes:
    """The bytes of a sealed netCDF-4 file of a record and the records inside it, with global `attributes`."""
    buffer = BytesIO()
    with h5py.File(buffer, "w", track_order=True) as file:
        file.attrs["_NCProperties"] = f"version=2,h5netcdf={h5netcdf.__version__}"
        file.attrs.update(attributes)
        _write_group(file, record, count())
    content = buffer.getvalue()
    return content + SEAL + hashlib.sha256(content).hexdigest().encode()


def from_netcdf(path: Path, kind: type[R]) -> R:
    """The record of the given type in a netCDF-4 file made by `to_netcdf`.

    Raises `OSError`, `KeyError` or `ValueError` where the file is damaged or holds something else.
    """
    _check_seal(path)
    with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
        return _read_group(file, kind)


def global_attribute(path: Path, name: str) -> str | None:
    """A global attribute of a netCDF-4 file; None where the file or the attribute is missing or unreadable."""
    try:
        _check_seal(path)
        with h5netcdf.File(path, "r") as file:
            value = file.attrs.get(name)
    except (OSError, KeyError, ValueError, RuntimeError):
        return None
    return None if value is None else str(value)


def has_seal(path: Path) -> bool:
    """Whether a file is, byte by byte, as `to_netcdf` made it."""
    left, body = path.stat().st_size - SEAL_BYTES, hashlib.sha256()
    with path.open("rb") as file:
        while left > 0 and (part := file.read(min(left, HASHED_AT_ONCE))):
            body.update(part)
            left -= len(part)
        return file.read() == SEAL + body.hexdigest().encode()


def _check_seal(path: Path) -> None:
    if not has_seal(path):
        raise ValueError("its content is not what was written")


def _write_group(group: h5py.Group, record: Record, dimension_ids: Iterator[int]) -> None:
    """Write a record as a group, by h5py alone: with many variables several times faster than by h5netcdf."""
    group.attrs["record"] = type(record).__name__
    variables = list(_variables(record))
    lengths = {axis: n for _, axes, array, _ in variables for axis, n in zip(axes, array.shape, strict=True)}
    ids = {axis: np.int32(next(dimension_ids)) for axis in lengths}
    own = {name for name, axes, _, _ in variables if axes == (name,)}  # variables along themselves
    scales = {axis: _write_dimension(group, axis, lengths[axis]) for axis in lengths if axis not in own}
    for name, _, array, _ in variables:
        if name in own:
            scales[name] = _write_array(group, name, array)
            scales[name].make_scale(name)
    for axis, scale in scales.items():
        scale.attrs["_Netcdf4Dimid"] = ids[axis]
    for name, axes, array, about in variables:
        variable = scales[name] if name in own else _write_array(group, _free_name(name, lengths), array)
        if name not in own:
            for place, axis in enumerate(axes):
                variable.dims[place].attach_scale(scales[axis])
        if axes:
            variable.attrs["_Netcdf4Coordinates"] = np.array([ids[axis] for axis in axes])
        if array.dtype.kind == "b":
            variable.attrs["dtype"] = "bool"  # as xarray marks them
        variable.attrs["units"], variable.attrs["long_name"] = about["unit"], about["doc"]
    for spec in fields(record):
        if "axes" not in spec.metadata:
            inner = group.create_group(spec.name, track_order=True)
            _write_group(inner, getattr(record, spec.name), dimension_ids)


def _variables(record: Record) -> Iterator[tuple[str, tuple[str, ...], Any, Mapping[str, Any]]]:
    """Name, axes, values and metadata of the variables of a record; two for a complex field."""
    for spec in fields(record):
        if "axes" not in spec.metadata:
            continue
        array, axes = np.asarray(getattr(record, spec.name)), tuple(spec.metadata["axes"])
        if array.dtype.kind == "c":
            yield f"{spec.name}_re", axes, array.real, spec.metadata
            yield f"{spec.name}_im", axes, array.imag, spec.metadata
        else:
            yield spec.name, axes, array, spec.metadata


def _write_dimension(group: h5py.Group, axis: str, length: int) -> h5py.Dataset:
    """A dimension without a variable of its own; one of length zero is unlimited, as netCDF knows no other."""
    scale = group.create_dataset(
        axis, (length,), ">f4", maxshape=None if length else (None,), track_order=True
    )
    scale.make_scale(f"This is a netCDF dimension but not a netCDF variable.{length:10d}")
    return scale


def _write_array(group: h5py.Group, name: str, array: Any) -> h5py.Dataset:
    kind = {"U": h5py.string_dtype(), "b": np.dtype(np.int8)}.get(array.dtype.kind, array.dtype)
    data = array.astype(object if array.dtype.kind == "U" else kind)
    unlimited = tuple(n or None for n in array.shape) if 0 in array.shape else None
    return group.create_dataset(name, array.shape, kind, data, maxshape=unlimited, track_order=True)


def _free_name(name: str, dimensions: Container[str]) -> str:
    """The HDF5 name of a variable: another one where a dimension that is not its own has its name."""
    return f"_nc4_non_coord_{name}" if name in dimensions else name


def _read_group(group: Any, kind: type[R]) -> R:
    types = get_type_hints(kind)
    values: dict[str, Any] = {}
    for spec in fields(kind):
        if "axes" not in spec.metadata:
            values[spec.name] = _read_group(group.groups[spec.name], types[spec.name])
        elif spec.metadata["dtype"].kind == "c":
            real = _read(group, f"{spec.name}_re")
            values[spec.name] = whole = np.empty(real.shape, np.result_type(real, np.complex64))
            whole.real, whole.imag = real, _read(group, f"{spec.name}_im")
        else:
            values[spec.name] = _read(group, spec.name)
    return kind(**values)


def _read(group: Any, name: str) -> Any:
    return group.variables[name][...]
