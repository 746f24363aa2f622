"""Tables of the campaigns beside the rows: information, without bars.

Stops: their number; processor time of a channel estimate; share of the significant separable paths detected;
stops with a bound below .3 m, and solved ones; RMS position error, and this over the RMS bound of these stops and
of all with a bound; median of error over bound; NEES/4; unflagged stops that are off. A campaign that failed has
its reason.

Objects, of mapping and of SLAM: pillars met from 5 stops or more and their IoU, coverage of bands, right classes,
ghosts, wall RMSE and walls found.
"""

from collections.abc import Sequence

from isac_arena.scoring.metrics.statistics import mean, quantile, rms
from isac_arena.validation.chain.run import ChainFailure, ChainResult
from isac_arena.validation.chain.statistics import ChainObjects, chain_stops, mapped_objects, slam_objects
from isac_arena.validation.measurement import InfoTable

NAMES = ("campaign", "group")
STOP_COLUMNS = (
    "stops",
    "s/stop",
    "found",
    "known",
    "solved",
    "RMSE m",
    "/bound",
    "/any bd",
    "median",
    "NEES/4",
    "off",
)
OBJECT_COLUMNS = ("IoU", "band", "class", "ghosts", "wall m", "walls")

Cells = tuple[str | float, ...]


def stop_table(results: Sequence[ChainResult], failures: Sequence[ChainFailure]) -> InfoTable:
    """A row per campaign, those that failed last."""
    rows: list[Cells] = [(result.name, str(result.group), *_stop_cells(result), "") for result in results]
    blank = ("",) * len(STOP_COLUMNS)
    rows += [(failure.name, str(failure.group), *blank, failure.reason) for failure in failures]
    return InfoTable("stops of the campaigns", (*NAMES, *STOP_COLUMNS, "error"), tuple(rows))


def object_table(results: Sequence[ChainResult]) -> InfoTable:
    """A row per campaign."""
    columns = (*NAMES, "lit", *OBJECT_COLUMNS, *(f"{name}, SLAM" for name in OBJECT_COLUMNS))
    rows = []
    for result in results:
        mapped, found = mapped_objects(result), slam_objects(result)
        lit = str(len(mapped.pillar_iou()))
        rows.append((result.name, str(result.group), lit, *_object_cells(mapped), *_object_cells(found)))
    return InfoTable("objects of the campaigns", columns, tuple(rows))


def _stop_cells(result: ChainResult) -> Cells:
    stops, significant = chain_stops(result.tables.poses), result.tables.significant
    return (
        str(len(stops.error_m)),
        mean(result.estimate_s),
        mean(significant.is_detected[significant.is_separable]),
        str(int(stops.is_known.sum())),
        str(int(stops.is_solved.sum())),
        rms(stops.error_m),
        stops.over_bound,
        stops.over_any_bound,
        quantile((stops.error_m / stops.bound_m)[stops.is_known], 0.5),
        stops.normalised_nees,
        str(int(stops.is_unflagged_gross.sum())),
    )


def _object_cells(objects: ChainObjects) -> Cells:
    return (
        mean(objects.pillar_iou()),
        mean(objects.coverage),
        mean(objects.class_right),
        str(int(objects.is_ghost.sum())),
        objects.wall_rmse_m,
        str(objects.n_walls),
    )
