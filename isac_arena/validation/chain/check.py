"""`arena validate chain`: the whole chain in random halls and in the library, pooled and in the worst campaign."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from estimation.slam.record import N_STATE
from isac_arena.scoring.metrics.statistics import mean, quantile, rms
from isac_arena.validation.chain.campaigns import (
    MAX_PATHS,
    N_ROOMS,
    QUICK_PATHS,
    THICK_M,
    THIN_M,
    ChainGroup,
    ChainOptions,
    chain_campaigns,
    quick_campaigns,
)
from isac_arena.validation.chain.run import ChainFailure, ChainResult, failure_row, run_chain
from isac_arena.validation.chain.statistics import (
    KNOWN_M,
    LIT_STOPS,
    ChainStops,
    chain_stops,
    mapped_objects,
    pooled_objects,
    pooled_stops,
    slam_objects,
)
from isac_arena.validation.chain.tables import object_table, stop_table
from isac_arena.validation.measurement import Measured, Measurement, at_least, at_most
from isac_arena.validation.monte_carlo import band_rows, fewest_by_chance, most_by_chance, quick_bar

OUT = Path("out") / "chain"
CAMPUS = "campus_arena"

OVER_BOUND_MEDIAN, OVER_BOUND_WORST = 2.0, 5.0
SOLVED, SOLVED_NLOS = 0.99, 0.97
UNFLAGGED = 0.003
NEES, WORST_NEES = (0.85, 1.2), 2.0
MAPS = {"mapping": mapped_objects, "slam": slam_objects}
PILLAR_IOU = {"mapping": 0.80, "slam": 0.75}
THIN_IOU, THICK_IOU = 0.7, 0.85
COVERAGE = (0.92, 0.97)
CLASS_RIGHT, GHOSTS, WALL_RMSE_M = 0.93, 0.3, 0.03
CAMPUS_RMSE_M, CAMPUS_WALLS = 0.02, 5
CAMPUS_IOU = {"mapping": 0.75, "slam": 0.70}


def check_chain(
    seed: int,
    quick: bool,
    trials: int = N_ROOMS,
    estimator: str | None = None,
    method: str = "auto",
    out: Path = OUT,
    workers: int | None = None,
    console: Console | None = None,
) -> Measured:
    """`trials` random halls, four halls of thin or thick columns, and every library campaign.

    A quick run takes one room and one library campaign, with few stops and few paths. `out` keeps the campaigns:
    an interrupted run goes on there.
    """
    options = ChainOptions(method, QUICK_PATHS if quick else MAX_PATHS, estimator)
    campaigns = quick_campaigns(seed, options) if quick else chain_campaigns(seed, trials, options)
    results, failures = run_chain(console or Console(quiet=True), campaigns, out, workers)
    return Measured(chain_rows(results, failures, quick), (stop_table(results, failures), object_table(results)))


def chain_rows(results: Sequence[ChainResult], failures: Sequence[ChainFailure], quick: bool) -> list[Measurement]:
    """The rows over all campaigns. A group without a campaign that ended well has none but the first.

    In a quick run, with few stops, the bars of shares and of NEES are moved by three standard errors.
    """
    rows = [failure_row("chain", failures)]
    for group in (ChainGroup.ROOMS, ChainGroup.LIBRARY):
        members = [result for result in results if result.group == group]
        if members:
            rows += [*_stop_rows(f"chain.{group}", members, quick), *_object_rows(f"chain.{group}", members)]
    if results:
        rows += _width_rows(results)
    for result in results:
        if result.name == CAMPUS:
            rows += _campus_rows(result)
    return rows


def _stop_rows(prefix: str, results: Sequence[ChainResult], quick: bool) -> list[Measurement]:
    parts, every = [chain_stops(result.tables.poses) for result in results], pooled_stops(results)
    ratios = [part.over_bound for part in parts]
    known = f"stops whose bound is below {KNOWN_M} m"
    unflagged = every.is_unflagged_gross
    n_solved = max(int(every.is_solved.sum()), 1)
    gross_bar = most_by_chance(UNFLAGGED * n_solved) / n_solved if quick else UNFLAGGED
    over, gross = f"{prefix}.position_over_bound", f"{unflagged.sum()} of {n_solved} solved stops"
    return [
        at_most(f"{over}.median", quantile(ratios, 0.5), OVER_BOUND_MEDIAN, f"RMS over RMS bound, {known}"),
        at_most(f"{over}.worst", _worst(ratios), OVER_BOUND_WORST, "the largest of a campaign"),
        _solved_row(f"{prefix}.solved.all", every, np.ones(len(every.error_m), bool), SOLVED, quick),
        _solved_row(f"{prefix}.solved.nlos", every, ~every.has_los, SOLVED_NLOS, quick),
        at_most(f"{prefix}.unflagged_gross", unflagged.sum() / n_solved, gross_bar, gross),
        *_nees_rows(prefix, parts, every, quick),
        at_least(
            f"{prefix}.far_flagged", every.far_flagged, 1.0, "beyond 3 stated deviations; 1 for no such stop"
        ),
    ]


def _solved_row(key: str, stops: ChainStops, chosen: np.ndarray, share: float, quick: bool) -> Measurement:
    n = int((stops.is_known & chosen).sum())
    bar = fewest_by_chance(n, share) / n if quick and n else share
    return at_least(key, stops.solved(chosen) if n else 1.0, bar, f"of {n} stops whose bound is below {KNOWN_M} m")


def _nees_rows(prefix: str, parts: Sequence[ChainStops], every: ChainStops, quick: bool) -> list[Measurement]:
    worst = max(parts, key=lambda part: np.nan_to_num(part.normalised_nees, nan=np.inf))
    errors = [float(np.sqrt(2 / N_STATE / max(np.isfinite(one.nees).sum(), 1))) for one in (every, worst)]
    reason = "mean squared error of a state in units of its covariance, over its 4 dimensions"
    bar = quick_bar(WORST_NEES, errors[1], quick)
    return [
        *band_rows(f"{prefix}.nees", every.normalised_nees, NEES, errors[0], quick, reason),
        at_most(f"{prefix}.nees.worst", worst.normalised_nees, bar, "the largest of a campaign"),
    ]


def _object_rows(prefix: str, results: Sequence[ChainResult]) -> list[Measurement]:
    rows = []
    for name, of in MAPS.items():
        objects, key = pooled_objects(results, of), f"{prefix}.{name}"
        iou, ghosts = objects.pillar_iou(), objects.is_ghost.sum() / len(results)
        n_right = f"of {len(objects.class_right)} contours with an object"
        lit = f"{len(iou)} pillars met from {LIT_STOPS} stops or more; one without a contour has 0"
        rows += [
            at_least(f"{key}.pillar_iou", mean(iou), PILLAR_IOU[name], lit),
            *band_rows(f"{key}.coverage95", mean(objects.coverage), COVERAGE, 0.0, False, "of bands, where seen"),
            at_least(f"{key}.class_right", mean(objects.class_right), CLASS_RIGHT, n_right),
            at_most(f"{key}.ghosts", ghosts, GHOSTS, "contours of no object", "per campaign"),
            at_most(f"{key}.wall_rmse_m", objects.wall_rmse_m, WALL_RMSE_M, "mean of walls, where seen", "m"),
        ]
    return rows


def _width_rows(results: Sequence[ChainResult]) -> list[Measurement]:
    """IoU of the thin and of the thick pillars of all campaigns."""
    rows = []
    for width, radii_m, bar in (("thin", THIN_M, THIN_IOU), ("thick", THICK_M, THICK_IOU)):
        for name, of in MAPS.items():
            iou = pooled_objects(results, of).pillar_iou(radii_m)
            reason = f"{len(iou)} pillars of {radii_m[0]} to {radii_m[1]} m radius"
            rows.append(at_least(f"chain.{width}.{name}.pillar_iou", mean(iou), bar, reason))
    return rows


def _campus_rows(result: ChainResult) -> list[Measurement]:
    stops, key = chain_stops(result.tables.poses), f"chain.{CAMPUS}"
    reason = "the scene of the measurement"
    return [
        at_most(f"{key}.position.rmse_m", rms(stops.error_m), CAMPUS_RMSE_M, reason, "m"),
        *band_rows(f"{key}.nees", stops.normalised_nees, NEES, 0.0, False, reason),
        *(
            at_least(f"{key}.{name}.pillar_iou", mean(of(result).pillar_iou()), CAMPUS_IOU[name], reason)
            for name, of in MAPS.items()
        ),
        at_least(f"{key}.slam.walls_found", slam_objects(result).n_walls, CAMPUS_WALLS, reason),
    ]


def _worst(ratios: Sequence[float]) -> float:
    """The largest; NaN where one is NaN: a campaign without a position over its bound is not good."""
    return float(np.max(ratios))
