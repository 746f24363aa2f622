"""Where two nested settings or two texts differ."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any


@dataclass(frozen=True)
class SettingDifference:
    """A field by its path, as a sweep names it, and its value in both runs; None where it is not set."""

    field: str
    first: Any
    second: Any


def setting_differences(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[SettingDifference]:
    """The fields of two nested mappings that are not the same, in the order of the first.

    A field that is not there counts as None. Tables in a list go by their `name` where all have one, else by
    their number.
    """
    known = dict(_leaves("", first)), dict(_leaves("", second))
    return [
        SettingDifference(field, known[0].get(field), known[1].get(field))
        for field in dict.fromkeys([*known[0], *known[1]])
        if known[0].get(field) != known[1].get(field)
    ]


def first_difference(there: Mapping[str, Any], here: Mapping[str, Any]) -> str | None:
    """The first field in which two nested mappings differ, with both values, for a message; None for the same."""
    for one in setting_differences(there, here):
        return f"{one.field} = {json.dumps(one.first)} there, {json.dumps(one.second)} here"
    return None


def line_difference(one: str, other: str) -> str:
    """The first line in which two texts differ, as the end of a sentence; line ends do not count as lines."""
    lines = zip_longest(one.splitlines(), other.splitlines(), fillvalue="no line")
    for number, (there, here) in enumerate(lines, 1):
        if there != here:
            return f", line {number}: '{there.strip()}' there, '{here.strip()}' here"
    return " differs"


def _leaves(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Paths and values of everything that is no table and not None."""
    if isinstance(value, Mapping):
        for name, part in value.items():
            yield from _leaves(f"{path}.{name}" if path else str(name), part)
    elif isinstance(value, list) and value and all(isinstance(part, Mapping) for part in value):
        names = [part.get("name") for part in value]
        unique = len({str(name) for name in names if name is not None}) == len(value)
        for index, part in enumerate(value):
            yield from _leaves(f"{path}.{names[index] if unique else index}", part)
    elif value is not None:
        yield path, value
