"""Pictures and tables of records: asked for here, made by the application, which says where."""

from importlib import import_module
from typing import Any

# Verb (plot, html, to_xarray, to_dataframe) to the module that has a function of that name. `isac_arena` fills it.
HOMES: dict[str, str] = {}


def shown(verb: str, thing: object, *arguments: Any, **options: Any) -> Any:
    """What the application makes of a thing; `RuntimeError` where `isac_arena` was not imported."""
    if verb not in HOMES:
        raise RuntimeError(f"{verb}: import isac_arena first, it makes pictures and tables")
    return getattr(import_module(HOMES[verb]), verb)(thing, *arguments, **options)


class Displayed:
    """Something with a picture, and a table for notebooks."""

    def plot(self, *arguments: Any, **options: Any) -> Any:
        """Draw it; returns the matplotlib axes. Options: see `isac_arena.report.records.plot`."""
        return shown("plot", self, *arguments, **options)

    def _repr_html_(self) -> str | None:
        return str(shown("html", self)) if HOMES else None

    def to_xarray(self) -> Any:
        """An xarray Dataset with units and meanings, or a DataTree where records are inside.

        `TypeError` for what holds no arrays of its own, such as a campaign.
        """
        return shown("to_xarray", self)

    def to_dataframe(self) -> Any:
        """A pandas DataFrame, a row per path, stop, point or score; `TypeError` where it is no table."""
        return shown("to_dataframe", self)
