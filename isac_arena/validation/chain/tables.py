"""The table of the campaigns beside the rows: information, without bars.

Columns: stops; processor time of a channel estimate; share of the significant separable paths detected; stops with
a bound below .3 m, and solved ones; RMS position error, and this over the bound of these stops and of all with a
bound; NEES/4; unflagged stops that are off; pillars met from 5 stops; IoU of these, coverage of bands, right
classes, ghosts and wall RMSE in m: of mapping, then of SLAM. A campaign that failed has its reason.
"""

from collections.abc import Sequence

from isac_arena.scoring.metrics.statistics import mean, rms
from isac_arena.validation.chain.run import ChainFailure, ChainResult
from isac_arena.validation.chain.statistics import (
    ChainObjects,
    ChainStops,
    chain_stops,
    mapped_objects,
    slam_objects,
)
from isac_arena.validation.measurement import InfoTable

STOP_COLUMNS = ("stops", "s/stop", "found", "known", "solved", "RMSE m", "/bound", "/any bd", "NEES/4", "off")
OBJECT_COLUMNS = ("IoU", "band", "class", "ghost", "wall m")
COLUMNS = (*STOP_COLUMNS, "lit", *OBJECT_COLUMNS, *(f"{name} S" for name in OBJECT_COLUMNS))


def campaign_table(results: Sequence[ChainResult], failures: Sequence[ChainFailure]) -> InfoTable:
    """A row per campaign, those that failed last."""
    rows = [(result.name, result.group, *_cells(result), "") for result in results]
    blank = ("",) * len(COLUMNS)
    rows += [(failure.name, failure.group, *blank, failure.reason) for failure in failures]
    return InfoTable("campaigns", ("campaign", "group", *COLUMNS, "error"), tuple(rows))


def _cells(result: ChainResult) -> tuple[str | float, ...]:
    stops, significant = chain_stops(result.tables.poses), result.tables.significant
    mapped, found = mapped_objects(result), slam_objects(result)
    return (
        *_stop_cells(stops, mean(result.estimate_s), mean(significant.is_detected[significant.is_separable])),
        str(len(mapped.pillar_iou())),
        *_object_cells(mapped),
        *_object_cells(found),
    )


def _stop_cells(stops: ChainStops, estimate_s: float, detection: float) -> tuple[str | float, ...]:
    return (
        str(len(stops.error_m)),
        estimate_s,
        detection,
        str(int(stops.is_known.sum())),
        str(int(stops.is_solved.sum())),
        rms(stops.error_m),
        stops.over_bound,
        stops.over_any_bound,
        stops.normalised_nees,
        str(int(stops.is_unflagged_gross.sum())),
    )


def _object_cells(objects: ChainObjects) -> tuple[str | float, ...]:
    return (
        mean(objects.pillar_iou()),
        mean(objects.coverage),
        mean(objects.class_right),
        str(int(objects.is_ghost.sum())),
        objects.wall_rmse_m,
    )
