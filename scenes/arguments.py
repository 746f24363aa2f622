"""Arguments of public functions: one of a wrong type is named, with what came and what is allowed."""

from collections.abc import Iterable

import numpy as np

LONGEST = 60  # characters of a value in a message


def need(name: str, value: object, *allowed: type) -> None:
    """Raise `ValueError` where an argument is of no allowed type; True is no number."""
    if not isinstance(value, allowed) or (isinstance(value, bool) and not {bool, object} & {*allowed}):
        plain = value.item() if isinstance(value, np.generic) else value
        shown = repr(plain) if isinstance(plain, str | int | float | list | tuple | dict | None) else "..."
        shown = shown if len(shown) <= LONGEST else f"{shown[:LONGEST]}..."
        kinds = " or ".join("None" if kind is type(None) else kind.__name__ for kind in allowed)
        raise ValueError(f"{name} = {shown} is of type {type(value).__name__}: must be {kinds}")


def need_each(name: str, values: object, *allowed: type) -> None:
    """As `need`, for a list or another sequence of arguments, not of text."""
    kinds = " or ".join(kind.__name__ for kind in allowed)
    if isinstance(values, str | bytes) or not isinstance(values, Iterable):
        shown = repr(values)[:LONGEST]
        raise ValueError(f"{name} = {shown} is of type {type(values).__name__}: must be a list of {kinds}")
    if isinstance(values, list | tuple | np.ndarray):
        for number, value in enumerate(values):
            need(f"{name}[{number}]", value, *allowed)
