"""Bounds of poses and contours, by TX and together, as tables and as plain numbers for a file."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from estimation.slam.bounds import StateBound
from isac_arena.insight.bounds.position import QUANTITIES
from isac_arena.insight.bounds.several_tx import SeveralTx, WalkBounds
from isac_arena.progress import counted, listed
from isac_arena.report.figures.bound import BoundMap
from isac_arena.scoring.metrics.statistics import quantile, rms

TOGETHER = "together"
FEW_WEIGH = 10.0  # RMS over median, from which few places decide the RMS
MOST = 0.9  # of a mean square


def by_tx(several: SeveralTx) -> dict[str, WalkBounds]:
    """Bounds from every TX alone, by name, and last from all together; of one TX alone its own."""
    alone = {walk.name: several.bounds([row]) for row, walk in enumerate(several.walks)}
    return alone if len(alone) == 1 else alone | {TOGETHER: several.bounds()}


def pose_table(bounds: dict[str, WalkBounds]) -> Table:
    """Position and heading bounds over the stops, a row per TX."""
    heads = ("position in m, RMS", "median", "largest", "without bound", "heading in deg, median")
    table = _right(Table("stops alone, from", *heads))
    for name, found in bounds.items():
        position = found.position_m
        cells = [cell(value) for value in (found.pose_m, quantile(position, 0.5), position.max())]
        none = str(int((~np.isfinite(position)).sum()))
        table.add_row(name, *cells, none, cell(np.rad2deg(quantile(found.heading_rad, 0.5))))
    return table


def state_table(stops: StateBound, plan: BoundMap) -> Table:
    """Bounds from the signal: of the stops of the walk, and of the position over the plan."""
    table = _right(Table("bound, from the signal", "RMS", "median", "smallest", "largest", "unit"))
    table.columns[-1].justify = "left"
    rows = [(f"{label}, stops", scale * getattr(stops, name), unit) for label, name, scale, unit in QUANTITIES]
    rows.append((f"{QUANTITIES[0][0]}, plan", plan.peb_m[~np.isnan(plan.peb_m)], QUANTITIES[0][3]))
    for label, values, unit in rows:
        cells = (rms(values), quantile(values, 0.5), values.min(), values.max()) if len(values) else 4 * (np.nan,)
        table.add_row(label, *(f"{value:.3g}" for value in cells), unit)
    return table


def about_unbounded(stop: Sequence[int], stops: StateBound, plan: BoundMap) -> Iterator[str]:
    """What RMS and median of `state_table` count, and where there is no bound."""
    yield "position: in plan; RMS and median: over the stops or places with a bound, as in the scores"
    known = plan.peb_m[np.isfinite(plan.peb_m)]
    if len(known) and rms(known) > FEW_WEIGH * np.median(known):
        worst = np.sort(known**2)[::-1]
        n_most = int(np.searchsorted(np.cumsum(worst), MOST * worst.sum())) + 1
        told = f"{counted(n_most, 'place')} of {len(known)} with large bounds make {MOST:.0%} of the mean square"
        yield f"plan: {told}; the median tells the usual place"
    missing = np.array(stop)[np.isinf(stops.position_m)].tolist()
    n_places, n_missing = int((~np.isnan(plan.peb_m)).sum()), int(np.isinf(plan.peb_m).sum())
    parts = [f"stop {listed(missing)} ({len(missing)} of {len(stop)} stops)"] if missing else []
    parts += [f"{n_missing} of {n_places} places of the plan (pink)"] if n_missing else []
    if parts:
        yield f"inf: no bound at {' and '.join(parts)}: too few paths, or too few that can be told apart"


def state_numbers(stop: Sequence[int], stops: StateBound | None, plan: BoundMap) -> dict[str, Any]:
    """The same for a JSON file, None where there is no bound; places (y, x) inside objects count as such."""
    found: dict[str, Any] = {"plan": {"x_m": plan.x_m.tolist(), "y_m": plan.y_m.tolist()}}
    found["plan"]["position_m"] = [[_number(value) for value in row] for row in plan.peb_m]
    if stops is not None:
        found["stops"] = {"stop": list(stop)}
        for _, name, scale, unit in QUANTITIES:
            values = scale * getattr(stops, name)
            found["stops"][f"{name.partition('_')[0]}_{unit}"] = [_number(value) for value in values]
    return found


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
    position = [_number(value) for value in found.position_m]
    heading = [_number(np.rad2deg(value)) for value in found.heading_rad]
    return {"position_m": position, "heading_deg": heading, "pillars": pillars}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _right(table: Table, first: int = 1) -> Table:
    for column in table.columns[first:]:
        column.justify = "right"
    return table


def cell(value: float) -> str:
    """Two digits, a dash for no number."""
    return f"{value:.2g}" if np.isfinite(value) else "-"
