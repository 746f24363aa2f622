"""Records as netCDF-4 files, sealed.

Named axes become dimensions, units and meanings become attributes, a record inside a record is a group. A complex
field `x` is stored as two variables `x_re` and `x_im`, so every netCDF or HDF5 reader understands it.

Behind the end that HDF5 knows of stands a seal, a hash of all bytes before it. It is checked before anything else
is read: a file that changed on the disk since it was written could otherwise give other values, or none for ever.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import h5netcdf
import h5py
import numpy as np

from scenes.record import Record

R = TypeVar("R", bound=Record)

SEAL = b"sha256 "
SEAL_BYTES = len(SEAL) + 64


def to_netcdf(record: Record, attributes: Mapping[str, str]) -> bytes:
    """The bytes of a sealed netCDF-4 file of a record and the records inside it, with global `attributes`."""
    buffer = BytesIO()
    with h5netcdf.File(buffer, "w", track_order=True) as file:
        file.attrs.update(attributes)
        _write_group(file, record)
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


def _check_seal(path: Path) -> None:
    """Raise `ValueError` where a file is not, byte by byte, as it was written."""
    content = memoryview(path.read_bytes())
    body, seal = content[:-SEAL_BYTES], bytes(content[-SEAL_BYTES:])
    if seal != SEAL + hashlib.sha256(body).hexdigest().encode():
        raise ValueError("its content is not what was written")


def _write_group(group: Any, record: Record) -> None:
    group.attrs["record"] = type(record).__name__
    axes: set[str] = set()
    for spec in fields(record):
        value = getattr(record, spec.name)
        if "axes" not in spec.metadata:
            _write_group(group.create_group(spec.name), value)
            continue
        array = np.asarray(value)
        for axis, length in zip(spec.metadata["axes"], array.shape, strict=True):
            if axis not in axes:
                group.dimensions[axis] = length
                axes.add(axis)
        if array.dtype.kind == "c":
            _write_variable(group, f"{spec.name}_re", spec.metadata, array.real)
            _write_variable(group, f"{spec.name}_im", spec.metadata, array.imag)
        else:
            _write_variable(group, spec.name, spec.metadata, array)


def _write_variable(group: Any, name: str, metadata: Any, value: Any) -> None:
    kind = {"U": h5py.string_dtype(), "b": np.dtype(np.int8)}.get(value.dtype.kind, value.dtype)
    data = value.astype(object if value.dtype.kind == "U" else kind)
    variable = group.create_variable(name, metadata["axes"], dtype=kind, data=data)
    if value.dtype.kind == "b":
        variable.attrs["dtype"] = "bool"  # as xarray marks them
    variable.attrs["units"], variable.attrs["long_name"] = metadata["unit"], metadata["doc"]


def _read_group(group: Any, kind: type[R]) -> R:
    types = get_type_hints(kind)
    values: dict[str, Any] = {}
    for spec in fields(kind):
        if "axes" not in spec.metadata:
            values[spec.name] = _read_group(group.groups[spec.name], types[spec.name])
        elif spec.metadata["dtype"].kind == "c":
            values[spec.name] = _read(group, f"{spec.name}_re") + 1j * _read(group, f"{spec.name}_im")
        else:
            values[spec.name] = _read(group, spec.name)
    return kind(**values)


def _read(group: Any, name: str) -> Any:
    return group.variables[name][...]
