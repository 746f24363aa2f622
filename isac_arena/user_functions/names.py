"""Names of functions: `package.module:function`, or what an installed package offers by an entry point."""

import importlib
import importlib.util
from collections.abc import Callable
from importlib.machinery import ModuleSpec
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator

from isac_arena.campaign.integrity import source_digest

GROUP = "isac_arena.estimators"
OURS = "ours"  # the name of our own method, where a file or a command has to say so
LONGEST_NAME = 300
FORM = "write it as package.module:function, or as a name that an installed package offers"


def _checked_name(name: str) -> str:
    if not name.strip() or not name.isprintable() or len(name) > LONGEST_NAME:
        raise ValueError(FORM)
    return name


FunctionName = Annotated[str, AfterValidator(_checked_name)]


def full_name(name: str) -> str:
    """`package.module:function` of a function; a name without a colon is one of an installed package.

    Raises `ValueError`, the end of a line, where it is in no package, or in several.
    """
    module, colon, function = name.partition(":")
    if colon:
        if not (module and function):
            raise ValueError(FORM)
        return name
    offered = {entry.name: entry.value for entry in entry_points(group=GROUP)}
    values = sorted({entry.value for entry in entry_points(group=GROUP, name=name)})
    if not values:
        known = f"; installed are {', '.join(sorted(offered))}" if offered else ""
        raise ValueError(f"no installed package offers it{known}; else {FORM.partition(',')[0]}")
    if len(values) > 1:
        raise ValueError(f"several packages offer it: name one of {', '.join(values)}")
    return values[0]


def imported_function(name: str) -> Callable[..., object]:
    """The function of a full name; raises what the import raises, and `TypeError` where it is no function."""
    module, _, path = name.partition(":")
    found: object = importlib.import_module(module)
    for part in path.split("."):
        found = getattr(found, part)
    if not callable(found):
        raise TypeError("is no function")
    return found


def _found(name: str) -> ModuleSpec | None:
    """What Python finds of the top-level module or package of a function; None where it finds none."""
    try:
        return importlib.util.find_spec(full_name(name).partition(":")[0].partition(".")[0])
    except (ValueError, ImportError):
        return None


def can_be_found(name: str) -> bool:
    """Whether the module or package of a function is where Python looks for modules."""
    return _found(name) is not None


def function_source(name: str) -> str:
    """Hash of the source of the top-level module or package of a function; empty where unknown."""
    spec = _found(name)
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return ""
    origin = Path(spec.origin)
    source = origin if spec.submodule_search_locations is None else origin.parent
    return source_digest(source.parent, source.name)
