"""Bounds of poses and contours by TX and together, as tables and as plain numbers for a file."""

from typing import Any

import numpy as np
from rich.table import Table

from isac_arena.insight.bounds.several_tx import SeveralTx, WalkBounds

TOGETHER = "together"


def by_tx(several: SeveralTx) -> dict[str, WalkBounds]:
    """Bounds from every TX alone, by name, and last from all together; of one TX alone its own."""
    alone = {walk.name: several.bounds([row]) for row, walk in enumerate(several.walks)}
    return alone if len(alone) == 1 else alone | {TOGETHER: several.bounds()}


def pose_table(bounds: dict[str, WalkBounds]) -> Table:
    """Position and heading bounds over the stops, a row per TX."""
    table = _right(Table("stops alone, from", "position in m, RMS", "median", "largest", "heading in deg, median"))
    for name, found in bounds.items():
        position = found.position_m
        cells = [cell(value) for value in (found.pose_m, np.median(position), position.max())]
        table.add_row(name, *cells, cell(np.rad2deg(np.median(found.heading_rad))))
    return table


def contour_table(several: SeveralTx, bounds: dict[str, WalkBounds]) -> Table:
    """A row for every pillar and TX: share of the outline that is lit, bounds of centre, radius and outline."""
    heads = ["pillar", "from", "lit", "centre in m", "radius", "outline"]
    if len(bounds) == 1:
        heads.remove("from")
    table = _right(Table(*heads), first=len(heads) - 4)
    for k, each in enumerate(several.objects):
        for name, found in bounds.items():
            errors = found.contours
            cells = [cell(float(value[k])) for value in (errors.center_m, errors.radius_m, errors.outline_m)]
            label = each.name if name == next(iter(bounds)) else ""
            lead = [label, name] if len(bounds) > 1 else [label]
            table.add_row(*lead, f"{found.lit_share[k]:.0%}", *(cells if found.lit[k].any() else 3 * ["-"]))
        if len(bounds) > 1:
            table.add_section()
    return table


def as_numbers(several: SeveralTx, bounds: dict[str, WalkBounds]) -> dict[str, Any]:
    """The same for a JSON file: by TX the bounds of every stop and pillar, None where there is none."""
    return {name: _numbers(several, found) for name, found in bounds.items()}


def _numbers(several: SeveralTx, found: WalkBounds) -> dict[str, Any]:
    pillars = {
        each.name: {
            "kind": each.kind,
            "lit_share": float(found.lit_share[k]),
            "center_m": float(found.contours.center_m[k]),
            "radius_m": float(found.contours.radius_m[k]),
            "outline_m": float(found.contours.outline_m[k]),
        }
        for k, each in enumerate(several.objects)
    }
    position = [float(value) if np.isfinite(value) else None for value in found.position_m]
    heading = [float(np.rad2deg(value)) if np.isfinite(value) else None for value in found.heading_rad]
    return {"position_m": position, "heading_deg": heading, "pillars": pillars}


def _right(table: Table, first: int = 1) -> Table:
    for column in table.columns[first:]:
        column.justify = "right"
    return table


def cell(value: float) -> str:
    """Two digits, a dash for no number."""
    return f"{value:.2g}" if np.isfinite(value) else "-"
