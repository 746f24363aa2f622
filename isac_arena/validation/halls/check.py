"""`arena validate halls`: channel estimates in random halls, pooled over the rooms and in the worst room."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from estimation.channel.hall.record import HallClass
from isac_arena.scoring.metrics.statistics import mean
from isac_arena.scoring.record import PathKind
from isac_arena.scoring.stages.channel_metrics import CLASS_KEYS, class_right
from isac_arena.validation.halls.run import HallResult, run_halls
from isac_arena.validation.halls.statistics import PARAMETERS, HallPaths, hall_paths, height_error_m, pooled
from isac_arena.validation.halls.tables import group_table, room_table
from isac_arena.validation.measurement import Measured, Measurement, at_least, at_most
from isac_arena.validation.monte_carlo import band_rows, fewest_by_chance, most_by_chance, quick_bar
from isac_arena.validation.scenarios.random_halls import draw_hall

N_ROOMS = 40
N_QUICK_ROOMS, N_QUICK_STOPS, LONGEST_QUICK_M = 2, 1, 14.0
OUT = Path("out") / "halls"

DETECTION = 0.96
FALSE_PER_STOP = 0.1
COVERAGE, WORST_COVERAGE = (0.93, 0.97), 0.88
NEES, WORST_NEES = (0.85, 1.2), 2.0
ERROR_OVER_BOUND = 1.3
STD_OVER_ERROR = (0.8, 1.3)
CLASS_RIGHT = {
    HallClass.LINE_OF_SIGHT: 0.98, HallClass.LEVEL: 0.95, HallClass.FLOOR_OR_CEILING: 0.9, HallClass.WEAK: 0.9,
}  # fmt: skip
HEIGHTS_M = ("horizontal", (1,), 0.1), ("three_elevations", (3, 4), 0.02)  # elevations of the beams of a room
KINDS = {"los": PathKind.LOS, "single_bounce": PathKind.SINGLE_BOUNCE}


def check_halls(
    seed: int,
    quick: bool,
    trials: int = N_ROOMS,
    estimator: str | None = None,
    method: str = "auto",
    out: Path = OUT,
    workers: int | None = None,
    console: Console | None = None,
) -> Measured:
    """Estimates of `trials` random halls of 8 stops; a quick run takes a stop of two small rooms.

    `out` keeps the rooms: an interrupted run goes on there, and other methods share the traced paths.
    """
    if quick:
        rooms = range(min(trials, N_QUICK_ROOMS))
        halls = [draw_hall(seed, room, N_QUICK_STOPS, LONGEST_QUICK_M) for room in rooms]
    else:
        halls = [draw_hall(seed, room) for room in range(trials)]
    results = run_halls(console or Console(quiet=True), halls, out, method, estimator, workers)
    return Measured(hall_rows(results, quick), (room_table(results), group_table(results)))


def hall_rows(results: Sequence[HallResult], quick: bool) -> list[Measurement]:
    """The rows over all rooms; in a quick run, with few paths, bars are moved by three standard errors."""
    rooms = [hall_paths(result) for result in results]
    every = pooled(rooms)
    false_bar = most_by_chance(FALSE_PER_STOP * every.n_stops) / every.n_stops if quick else FALSE_PER_STOP
    reason = f"{every.n_false} in {every.n_stops} stops of {len(rooms)} rooms"
    return [
        _detection("equal_heights", [one for one in results if one.hall.has_equal_heights], quick),
        _detection("unequal_heights", [one for one in results if not one.hall.has_equal_heights], quick),
        at_most("halls.false_per_stop", every.false_per_stop, false_bar, reason, "per stop"),
        *_coverage_rows(every, rooms, quick),
        *_nees_rows(every, rooms, quick),
        *_bound_rows(every, quick),
        *_calibration_rows(every, quick),
        *([] if quick else [*_class_rows(results), *_height_rows(results)]),
    ]


def _class_rows(results: Sequence[HallResult]) -> list[Measurement]:
    """Share of the paths of each class that were told as such."""
    rows = []
    for name, bar in CLASS_RIGHT.items():
        right = np.concatenate([class_right(one.tables.paths, name) for one in results])
        rows.append(at_least(f"halls.class_right.{CLASS_KEYS[name]}", mean(right), bar, f"of {len(right)} paths"))
    return rows


def _height_rows(results: Sequence[HallResult]) -> list[Measurement]:
    """Median over rooms of the larger error of receiver and ceiling; a ceiling that does not show is unknown."""
    rows = []
    for name, elevations, bar in HEIGHTS_M:
        error_m = [height_error_m(one) for one in results if one.hall.n_elevations in elevations]
        n_shown = int(np.isfinite(error_m).sum())
        value = float(np.sort(error_m)[len(error_m) // 2]) if error_m else np.nan
        reason = f"{n_shown} of {len(error_m)} rooms show their ceiling"
        rows.append(at_most(f"halls.height_error.{name}", value, bar, reason, "m"))
    return rows


def _detection(heights: str, results: Sequence[HallResult], quick: bool) -> Measurement:
    """Share of the significant separable paths of some rooms with an estimate."""
    key = f"halls.detection.{heights}"
    if not results:
        return at_least(key, np.nan, DETECTION, "no room with these heights")
    paths = pooled([hall_paths(result) for result in results])
    n = max(int(paths.is_separable.sum()), 1)
    bar = fewest_by_chance(n, DETECTION) / n if quick else DETECTION
    return at_least(key, paths.detection, bar, f"{n} significant separable paths of {len(results)} rooms")


def _coverage_rows(every: HallPaths, rooms: Sequence[HallPaths], quick: bool) -> list[Measurement]:
    rows = _coverage_band("all", every.coverage(), len(every.nees), quick)
    worst = min(rooms, key=HallPaths.coverage)
    error = -np.sqrt(WORST_COVERAGE * (1 - WORST_COVERAGE) / max(len(worst.nees), 1))
    bar = quick_bar(WORST_COVERAGE, error, quick)
    rows.append(at_least("halls.coverage95.worst_room", worst.coverage(), bar, "the least coverage of a room"))
    for name, kind in KINDS.items():
        rows += _coverage_band(name, every.coverage(kind), every.n_of(kind), quick)
    return rows


def _coverage_band(name: str, value: float, n: int, quick: bool) -> list[Measurement]:
    error = float(np.sqrt(0.95 * 0.05 / max(n, 1)))
    reason = f"share of {n} detected paths inside their 95 % region"
    return band_rows(f"halls.coverage95.{name}", value, COVERAGE, error, quick, reason)


def _nees_rows(every: HallPaths, rooms: Sequence[HallPaths], quick: bool) -> list[Measurement]:
    worst = max(rooms, key=lambda room: room.normalised_nees)
    errors = [float(np.sqrt(2 / 3 / max(len(one.nees), 1))) for one in (every, worst)]
    reason = "mean squared error in units of the reported covariance, over its 3 dimensions"
    bar = quick_bar(WORST_NEES, errors[1], quick)
    return [
        *band_rows("halls.nees", every.normalised_nees, NEES, errors[0], quick, reason),
        at_most("halls.nees.worst_room", worst.normalised_nees, bar, "the largest of a room"),
    ]


def _bound_rows(every: HallPaths, quick: bool) -> list[Measurement]:
    n = int(every.is_efficient.sum())
    bar = quick_bar(ERROR_OVER_BOUND, float(1 / np.sqrt(2 * max(n, 1))), quick)
    reason = f"trimmed RMS over {n} separable paths of ideal hardware; the bound allows 1"
    return [
        at_most(f"halls.error_over_bound.{name}", every.error_over_bound(index), bar, reason)
        for index, name in enumerate(PARAMETERS)
    ]


def _calibration_rows(every: HallPaths, quick: bool) -> list[Measurement]:
    """Median reported standard deviation over median error, of lines of sight and of single bounces."""
    rows = []
    for name, kind in KINDS.items():
        error = float(1.17 / np.sqrt(max(every.n_of(kind), 1)))  # of the median magnitude of a Gaussian
        for index, parameter in enumerate(PARAMETERS):
            key, value = f"halls.std_over_error.{name}.{parameter}", every.std_over_error(kind, index)
            reason = f"medians over {every.n_of(kind)} paths"
            rows += band_rows(key, value, STD_OVER_ERROR, error * STD_OVER_ERROR[0], quick, reason)
    return rows
