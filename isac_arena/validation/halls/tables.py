"""Tables of the rooms and of groups of rooms beside the rows: information, without bars.

Columns: stops; processor time of the estimate; significant, separable and detected paths; share of the separable
ones detected; false and weak estimates; coverage of all, of lines of sight, of single bounces; NEES/3; error over
bound, that of the delay also over the thermal bound; causes of misses of separable paths.
"""

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from isac_arena.scoring.record import PathKind
from isac_arena.validation.halls.run import HallResult
from isac_arena.validation.halls.statistics import PARAMETERS, HallPaths, hall_paths, pooled
from isac_arena.validation.measurement import InfoTable

N_CAUSES = 3  # named per row

COLUMNS = (
    "stops", "s/stop", "sig.", "sep.", "found", "rate", "false", "weak", "cover", "LOS", "1 b.", "NEES/3",
    *(f"{name}/bd" for name in PARAMETERS), "d./th.", "missed",
)  # fmt: skip
GROUPS: dict[str, Callable[[HallResult], bool]] = {
    "all": lambda result: True,
    "equal heights": lambda result: result.hall.has_equal_heights,
    "unequal heights": lambda result: not result.hall.has_equal_heights,
    "ideal hardware": lambda result: not result.hall.has_hardware,
    "real hardware": lambda result: result.hall.has_hardware,
    "1 elevation": lambda result: result.hall.n_elevations == 1,
    "2 elevations": lambda result: result.hall.n_elevations == 2,
    "3 elevations": lambda result: result.hall.n_elevations == 3,
    "4 elevations": lambda result: result.hall.n_elevations == 4,
}


def room_table(results: Sequence[HallResult]) -> InfoTable:
    """A row per room: heights equal (=) or not, elevations, hardware (hw), and its statistics."""
    rows = []
    for result in results:
        hall = result.hall
        kind = f"{'=' if hall.has_equal_heights else '/'} {hall.n_elevations} {'hw' if hall.has_hardware else ''}"
        rows.append((f"{hall.room} {kind}".strip(), *_cells([result])))
    return InfoTable("rooms, per stop", ("room", *COLUMNS), tuple(rows))


def group_table(results: Sequence[HallResult]) -> InfoTable:
    """A row per group of rooms."""
    rows = []
    for name, is_member in GROUPS.items():
        members = [result for result in results if is_member(result)]
        if members:
            rows.append((f"{name} ({len(members)})", *_cells(members)))
    return InfoTable("groups of rooms, per stop", ("group", *COLUMNS), tuple(rows))


def _cells(results: Sequence[HallResult]) -> tuple[str | float, ...]:
    paths = pooled([hall_paths(result) for result in results])
    times = np.concatenate([result.estimate_s for result in results])
    return (
        str(paths.n_stops),
        float(times.mean()) if len(times) else np.nan,
        len(paths.is_detected) / paths.n_stops,
        float(paths.is_separable.sum()) / paths.n_stops,
        float(paths.is_detected.sum()) / paths.n_stops,
        paths.detection,
        paths.false_per_stop,
        paths.n_weak / paths.n_stops,
        paths.coverage(),
        paths.coverage(PathKind.LOS),
        paths.coverage(PathKind.SINGLE_BOUNCE),
        paths.normalised_nees,
        *(paths.error_over_bound(index) for index in range(len(PARAMETERS))),
        paths.error_over_bound(0, thermal=True),
        _causes(paths),
    )


def _causes(paths: HallPaths) -> str:
    """The most frequent causes of missed paths with their shares of the misses."""
    missed = paths.cause[~paths.is_detected & paths.is_separable].tolist()
    named = Counter(missed).most_common(N_CAUSES)
    return ", ".join(f"{cause} {count / len(missed):.0%}" for cause, count in named)
