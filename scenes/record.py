"""Records between stages: frozen dataclasses of numpy arrays with named axes and units.

The metadata of each field holds its axes, unit, dtype and meaning. One place therefore checks shapes at
construction, writes files and documents the field:

>>> @dataclass(frozen=True)
... class Echo(Record):
...     delay_s: FloatArray = array("path", unit="s", doc="time of arrival")

An axis name has one length within a record. The axes `xy`, `xy2` and `xyz` have fixed lengths.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from inspect import cleandoc
from typing import Any, ClassVar, Self, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

from scenes.display import Displayed

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complexfloating[Any, Any]]
TextArray = NDArray[np.str_]

R = TypeVar("R", bound="Record")

FIXED_AXES = {"xy": 2, "xy2": 2, "xyz": 3}
LONGEST_TEXT = 40  # of a value in the short form of a record
FIELDS = "Fields, with axes and units:"  # in the docstring of a record, before what its fields say of themselves


def array(*axes: str, unit: str = "1", dtype: Any = np.float64, doc: str = "", default: Any = MISSING) -> Any:
    """Declare an array field of a record with its named `axes`, `unit`, `dtype` and meaning `doc`.

    Without axes the field is a scalar and is stored as a Python number of that dtype; it may have a `default`.
    The axes of one field have different names, even if their lengths agree: a repeated name is a `ValueError`.
    """
    if len(set(axes)) < len(axes):
        raise ValueError(f"axes = {axes}: every axis of a field needs its own name")
    metadata = {"axes": axes, "unit": unit, "dtype": np.dtype(dtype), "doc": doc}
    return field(metadata=metadata, default=default)


def optional_array(*axes: str, **about: Any) -> Any:
    """As `array`, for a field that may be left out: the record fills it in."""
    return field(default=None, metadata=array(*axes, **about).metadata)


@dataclass(frozen=True)
class Record(Displayed):
    """Base of all records: converts to the declared dtypes, checks the shapes, freezes the arrays.

    `derived` declares properties that files and tables hold beside the fields, in the form of `array`.

    Raises `ValueError` if an array does not have the declared axes; the message names record, field, shape and
    axes.
    """

    derived: ClassVar[Mapping[str, Any]] = {}

    def __init_subclass__(cls) -> None:
        if "__repr__" not in vars(cls):  # `dataclass` would make one that prints all numbers
            cls.__repr__ = Record.__repr__  # type: ignore[method-assign]
        if cls.__doc__:
            cls.__doc__ = "\n".join([cleandoc(cls.__doc__), *_field_lines(cls)])

    def __repr__(self) -> str:
        lengths: dict[str, int] = {}
        parts = []
        for name, axes, value, _ in columns(self):
            lengths |= {axis: n for axis, n in zip(axes, value.shape, strict=True) if axis not in FIXED_AXES}
            if (not axes or (len(axes) == 1 and axes[0] in FIXED_AXES)) and value.tolist() != "":
                parts.append(f"{name} {_brief(value.tolist())}")
        doubled = {f"{axis}2" for axis in lengths}  # the other side of a covariance
        parts += [f"{n} x {axis}" for axis, n in lengths.items() if axis not in doubled]
        parts += [repr(inner) for inner in parts_of(self).values()]
        return f"{type(self).__name__}({', '.join(parts)})"

    def _fill(self, **values: Any) -> None:
        """Give optional fields that were left out their values."""
        for name, value in values.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)

    def __post_init__(self) -> None:
        sizes: dict[str, int] = dict(FIXED_AXES)
        owner: Any = type(self)
        for name, axes, kind in _array_fields(owner):
            value = _checked(owner.__name__, name, getattr(self, name), axes, kind, sizes)
            object.__setattr__(self, name, value)

    def take(self, axis: str, index: Any) -> Self:
        """The same record with `index` (mask or integers) applied to one named axis of every field that has it."""
        changed = {}
        for spec in fields(self):
            value = getattr(self, spec.name)
            axes = spec.metadata.get("axes", ())
            if axis in axes:
                value = value[(slice(None),) * axes.index(axis) + (index,)]
            elif is_optional(spec) and isinstance(value, Record):
                value = value.take(axis, index)
            changed[spec.name] = value
        return type(self)(**changed)

    def size(self, axis: str) -> int:
        """Length of a named axis; `KeyError` if no field has it."""
        for spec in fields(self):
            axes = spec.metadata.get("axes", ())
            if axis in axes:
                return int(getattr(self, spec.name).shape[axes.index(axis)])
        raise KeyError(axis)


def _brief(value: Any) -> str:
    """A value in a few words: six digits of a number, the start of a long text."""
    if isinstance(value, list):
        return f"[{', '.join(map(_brief, value))}]"
    if isinstance(value, float):
        return f"{value:.6g}"
    return repr(value if len(str(value)) <= LONGEST_TEXT else f"{str(value)[:LONGEST_TEXT]}...")


def _field_lines(kind: type[Record]) -> list[str]:
    """What the fields of a record say of themselves, for `help`; `dataclass` has not seen them yet."""
    lines = []
    for name, kind_of_field in vars(kind).get("__annotations__", {}).items():
        metadata = getattr(vars(kind).get(name), "metadata", {})
        if "axes" in metadata:
            axes = f" ({', '.join(metadata['axes'])})" if metadata["axes"] else ""
            unit = f" [{metadata['unit']}]" if metadata["unit"] != "1" else ""
            lines.append(f"    {name}{axes}{unit}: {metadata['doc']}")
        elif "ClassVar" not in str(kind_of_field):
            lines.append(f"    {name}: {getattr(kind_of_field, '__name__', kind_of_field)}")
    return ["", FIELDS, "", *lines] if lines else []


def columns(record: Record) -> Iterator[tuple[str, tuple[str, ...], NDArray[Any], Mapping[str, Any]]]:
    """Name, axes, values and metadata of the arrays and numbers of a record, the derived ones last."""
    declared = {spec.name: spec.metadata for spec in fields(record) if "axes" in spec.metadata}
    for name, metadata in (declared | {name: one.metadata for name, one in record.derived.items()}).items():
        yield name, metadata["axes"], np.asarray(getattr(record, name)), metadata


def parts_of(record: Record) -> dict[str, Record]:
    """The records inside a record, by the name of their field."""
    inner = {spec.name: getattr(record, spec.name) for spec in fields(record)}
    return {name: value for name, value in inner.items() if isinstance(value, Record)}


def is_optional(spec: Any) -> bool:
    """Whether a field holds a record that may be absent: its axes are those of the record around it."""
    return "axes" not in spec.metadata and spec.default is None


def empty_record(kind: type[R]) -> R:
    """A record without any rows."""
    types, values = get_type_hints(kind), {}
    for spec in fields(kind):
        if "axes" in spec.metadata:
            shape = [FIXED_AXES.get(axis, 0) for axis in spec.metadata["axes"]]
            values[spec.name] = np.zeros(shape, spec.metadata["dtype"])
        elif not is_optional(spec):
            values[spec.name] = empty_record(types[spec.name])
    return kind(**values)


def concatenate(records: Sequence[R], axis: str) -> R:
    """Join records of one type along a named axis; fields without that axis are taken from the first.

    Raises `ValueError` for an empty sequence, because the type of the result is then unknown.
    """
    if not records:
        raise ValueError("concatenate: no records given, at least one is needed")
    joined = {}
    for spec in fields(records[0]):
        axes = spec.metadata.get("axes", ())
        values = [getattr(record, spec.name) for record in records]
        if is_optional(spec) and isinstance(values[0], Record):
            joined[spec.name] = concatenate(values, axis)
        else:
            joined[spec.name] = np.concatenate(values, axis=axes.index(axis)) if axis in axes else values[0]
    return type(records[0])(**joined)


@cache
def _array_fields(kind: Any) -> tuple[tuple[str, tuple[str, ...], type[Any]], ...]:
    """Name, axes and type of the arrays and numbers of a record."""
    declared = ((spec.name, spec.metadata) for spec in fields(kind) if "axes" in spec.metadata)
    return tuple((name, of["axes"], of["dtype"].type if of["dtype"].kind != "U" else str) for name, of in declared)


def _checked(
    owner: str, name: str, value: Any, axes: tuple[str, ...], kind: type[Any], sizes: dict[str, int]
) -> Any:
    try:
        result = np.asarray(value, dtype=kind)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{owner}.{name} = {repr(value)[:60]}: must be {'text' if kind is str else kind.__name__}, axes {axes}"
        ) from error
    if result.ndim != len(axes):
        raise ValueError(f"{owner}.{name}: shape {result.shape} does not fit the axes {axes}")
    for axis, length in zip(axes, result.shape, strict=True):
        if sizes.setdefault(axis, length) != length:
            raise ValueError(
                f"{owner}.{name}: axis '{axis}' has length {length}, expected {sizes[axis]} (axes {axes})"
            )
    if not axes:
        return result.item()
    result = result.view()
    result.setflags(write=False)
    return result
