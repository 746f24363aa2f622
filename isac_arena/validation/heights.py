"""`arena validate heights`: a hall with meshes and a floor plan, TX and receiver at different heights.

The library's `workshop` has horizontal beams, `workshop_elevations` beams at three elevations.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from isac_arena.campaign.load import campaign_path, changed_campaign
from isac_arena.scoring.metrics.statistics import rms
from isac_arena.sweep.cases import Case
from isac_arena.sweep.job import Job
from isac_arena.user_functions.config import with_functions
from isac_arena.validation.case_runs import case_tables, run_cases
from isac_arena.validation.chain.statistics import ChainStops, chain_stops
from isac_arena.validation.measurement import InfoTable, Measured, Measurement, at_least, at_most
from scenes.toml_config import read_toml

OUT = Path("out") / "heights"
LEVEL, ELEVATED = "workshop", "workshop_elevations"
RMSE_M = {LEVEL: 0.05, ELEVATED: 0.02}
METHODS = {LEVEL: ("power", "auto"), ELEVATED: ("auto",)}  # 'power' estimates no elevation
QUICK_METHODS = {LEVEL: ("power",)}
COLUMNS = ("campaign", "method", "stops", "solved", "position RMSE m", "largest m", "over bound", "NEES/4")


@dataclass(frozen=True)
class HeightsRun:
    """A campaign of the library with one method: its stops, or None and the reason where it failed."""

    campaign: str
    method: str
    stops: ChainStops | None
    reason: str = ""


def check_heights(
    seed: int,
    quick: bool,
    method: str | None = None,
    estimator: str | None = None,
    out: Path = OUT,
    workers: int | None = None,
    console: Console | None = None,
) -> Measured:
    """Both campaigns with every method that suits them, or with `method` alone; a quick run takes the fastest.

    Positions are those of SLAM, the stops of the walk together. `out` keeps the cases: an interrupted run goes on.
    """
    wanted = QUICK_METHODS if quick else METHODS
    chosen = [(name, one) for name, of in wanted.items() for one in ((method,) if method else of)]
    cases = [_case(name, one, seed, estimator, quick) for name, one in chosen]
    jobs = run_cases(console or Console(quiet=True), cases, out, workers)
    runs = [_run(name, one, job) for (name, one), job in zip(chosen, jobs, strict=True)]
    return Measured(heights_rows(runs), (InfoTable("halls of unequal heights", COLUMNS, _table(runs)),))


def heights_rows(runs: Sequence[HeightsRun]) -> list[Measurement]:
    """The runs that failed, the share of solved stops and the error of their positions."""
    failed = [f"{run.campaign} with {run.method}: {run.reason}" for run in runs if run.stops is None]
    rows = [at_most("heights.failed_runs", len(failed), 0, "; ".join(failed) or "every run has scores")]
    for run in runs:
        if run.stops is None:
            continue
        key, solved = f"heights.{run.campaign}.{run.method}", run.stops.is_solved
        reason = f"{solved.sum()} of {len(solved)} stops are solved"
        rows += [
            at_least(f"{key}.solved", solved.mean(), 1.0, reason),
            at_most(f"{key}.position.rmse_m", rms(run.stops.error_m[solved]), RMSE_M[run.campaign], reason, "m"),
        ]
    return rows


def _run(name: str, method: str, job: Job | str) -> HeightsRun:
    if isinstance(job, str):
        return HeightsRun(name, method, None, job)
    tables = case_tables(job)
    return HeightsRun(name, method, chain_stops(tables.poses))


def _case(name: str, method: str, seed: int, estimator: str | None, quick: bool) -> Case:
    """A campaign of the library with a seed and a channel method; a quick run makes no contours."""
    file = campaign_path(name)
    changes: list[tuple[str, str | int]] = [("seed", seed), ("channel.method", method)]
    if quick:
        changes.append(("contours.method", "none"))
    config, scene = changed_campaign(read_toml(file), file, changes)
    config = with_functions(config, {"channel": estimator})
    return Case(0, 0, (), config, scene, stop_every=1, stages="all_kept")


def _table(runs: Sequence[HeightsRun]) -> tuple[tuple[str | float, ...], ...]:
    found: list[tuple[str | float, ...]] = []
    for run in runs:
        if run.stops is None:
            found.append((run.campaign, run.method, *["failed"] * (len(COLUMNS) - 2)))
            continue
        stops, error_m = run.stops, run.stops.error_m[run.stops.is_solved]
        values = (rms(error_m), float(error_m.max(initial=0.0)), stops.over_any_bound, stops.normalised_nees)
        found.append((run.campaign, run.method, str(len(stops.error_m)), str(len(error_m)), *values))
    return tuple(found)
