"""A run of the chain with the TX of a placement: its errors beside those that the bounds predict."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

from isac_arena.campaign.campaign import Campaign
from isac_arena.insight.bounds.tables import cell
from isac_arena.insight.placement.placement import Placement, with_tx
from isac_arena.scoring.metrics.statistics import rms
from isac_arena.scoring.stages.shapes import best_rows
from scenes.record import FloatArray


@dataclass(frozen=True)
class Comparison:
    """One error: what the bounds predict, and what a run achieved."""

    name: str
    predicted_m: float
    achieved_m: float
    count: int  # of stops or pillars


def compared_with_run(campaign: Campaign, placement: Placement) -> list[Comparison]:
    """Positions by SLAM at the solved stops, and the outlines of the pillars that mapping found.

    Predictions are those of the same stops and pillars. The error of an outline is the RMS distance of the contour
    from the true outline over all of it.
    """
    chosen = [placement.candidates[row] for row in placement.chosen]
    scores = with_tx(campaign, chosen, placement.several.stops).scores()
    bounds, poses = placement.bounds(), scores.tables.poses
    solved = np.isfinite(poses.position_error_m) & np.isfinite(bounds.position_m)
    rows = [_row("position", bounds.position_m[solved], poses.position_error_m[solved])]
    table = scores.tables.mapping.contours
    best = best_rows(table)
    found = [(k, best[each.name]) for k, each in enumerate(placement.several.objects) if each.name in best]
    predicted = bounds.contours.outline_m[[k for k, _ in found]]
    return [*rows, _row("outline", predicted, table.full_rmse_m[[row for _, row in found]])]


def comparison_table(rows: list[Comparison]) -> Table:
    """Predicted beside achieved errors."""
    table = Table("RMS error in m", "predicted", "achieved", "achieved over predicted", "of")
    for column in table.columns[1:4]:
        column.justify = "right"
    for row, what in zip(rows, ("stops solved by SLAM", "pillars found by mapping"), strict=True):
        share = row.achieved_m / row.predicted_m if row.predicted_m > 0 else np.nan
        table.add_row(row.name, *map(cell, (row.predicted_m, row.achieved_m, share)), f"{row.count} {what}")
    return table


def as_numbers(rows: list[Comparison]) -> dict[str, Any]:
    """The same for a JSON file."""
    return {
        row.name: {
            "predicted_m": row.predicted_m if row.count else None,
            "achieved_m": row.achieved_m if row.count else None,
            "count": row.count,
        }
        for row in rows
    }


def _row(name: str, predicted: FloatArray, achieved: FloatArray) -> Comparison:
    return Comparison(name, rms(predicted), rms(achieved), len(predicted))
