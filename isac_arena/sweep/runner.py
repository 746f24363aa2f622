"""Run a sweep: its missing cases on workers, then the tables of all results."""

import shutil
import time
from collections.abc import Collection, Sequence
from pathlib import Path

from rich.console import Console

from isac_arena.campaign.lock import one_run
from isac_arena.campaign.recording import recorded_run
from isac_arena.progress import counted, progress_bar
from isac_arena.scoring.doubts import MORE_STOPS, case_doubts, in_short
from isac_arena.sweep.cases import base_path
from isac_arena.sweep.config import SweepConfig
from isac_arena.sweep.job import Job, store_scene
from isac_arena.sweep.plan import Plan, make_plan
from isac_arena.sweep.store import (
    damaged_cases,
    forget_failures,
    open_sweep,
    plan_of_jobs,
    read_failures,
    remove_unfinished,
    stale_names,
    takes_stops_alone,
    write_failure,
    write_plan,
)
from isac_arena.sweep.table import Row, axis_names, mean_with_interval, result_rows, write_tables
from isac_arena.workers.workers import Workers
from scenes.names import path_in
from scenes.toml_config import read_text


def run_sweep(
    console: Console,
    file: Path,
    config: SweepConfig,
    out: Path,
    plan: Plan,
    workers: Workers,
    retry_failed: bool = False,
) -> int:
    """Run what is missing of a sweep, write its tables and its manifest, and return how many cases failed."""
    with one_run(out), recorded_run(out) as recording:
        keys = {job.key for job in plan.jobs}
        open_sweep(out, config, read_text(base_path(str(file), config)), keys)
        for scene in plan.scenes.values():
            store_scene(out, scene)
        for key, what in damaged_cases(out).items():
            console.print(f"{what}; this case runs again", markup=False)
            shutil.rmtree(path_in(out / "cases", key))
        if retry_failed:
            forget_failures(out, read_failures(out))
        recording.drop(stale_names(out, recording.names))
        with workers:
            jobs = run_until_known(workers, console, file, config, out, plan.jobs)
        remove_unfinished(out)  # of workers that were lost
        return print_results(console, out, config, jobs)


def run_until_known(
    workers: Workers, console: Console, file: Path, config: SweepConfig, out: Path, jobs: list[Job]
) -> list[Job]:
    """Run the jobs; with `until`, add seeds to a point until its mean metric is known well enough."""
    write_plan(out, plan_of_jobs(jobs))
    run_missing(workers, console, out, jobs)
    repeat = config.repeats
    while config.until is not None and repeat < config.until.max_repeats:
        open_points = unknown_points(out, config, jobs)
        if not open_points:
            break
        made = make_plan(str(file), config, out, [repeat]).jobs
        more = [job for job in made if job.point in open_points]
        jobs, repeat = [*jobs, *more], repeat + 1
        write_plan(out, plan_of_jobs(jobs))
        run_missing(workers, console, out, jobs)
    return jobs


def unknown_points(out: Path, config: SweepConfig, jobs: Sequence[Job]) -> set[int]:
    """Points of the design where the mean of the metric in `until` is not known well enough yet."""
    if config.until is None:
        return set()
    rows = result_rows(out, config, plan_of_jobs(jobs), read_failures(out))
    found = mean_with_interval(rows, config.until.metric, config.until.confidence)
    wanted = config.until.half_width
    return {point for point, value in found.items() if not value.half_width <= wanted}


def run_missing(workers: Workers, console: Console, out: Path, jobs: Sequence[Job]) -> None:
    """Run the jobs that are neither done nor known to fail, with rate, failures and remaining time."""
    from isac_arena.kernels import ensure_kernels  # noqa: PLC0415  (brings numba)
    from isac_arena.sweep.engine import run_jobs  # noqa: PLC0415

    known = read_failures(out)
    pending = [job for job in jobs if not job.is_done and job.key not in known]
    if not pending:
        return
    ensure_kernels(console)
    n_failed, started = 0, time.monotonic()
    with progress_bar(console, "rate", speed_estimate_period=3600) as progress:
        task = progress.add_task("cases", total=len(jobs), completed=len(jobs) - len(pending), rate="")

        def report(job: Job, reason: str | None) -> None:
            nonlocal n_failed
            if reason is not None:
                write_failure(out, job.key, reason)
                n_failed += 1
            done = progress.tasks[task].completed + 1 - (len(jobs) - len(pending))
            per_minute = 60 * done / (time.monotonic() - started)
            progress.update(task, advance=1, rate=f"{per_minute:.3g} a minute, {n_failed} failed")

        run_jobs(workers.client, pending, report, **workers.limits)


def doubtful_cases(rows: Sequence[Row], stops_alone: Collection[str] = ()) -> dict[str, str]:
    """What is doubtful about a case in short, by its key; only of cases where something is.

    `stops_alone` are the cases whose SLAM takes every stop alone.
    """
    values: dict[str, dict[str, float]] = {}
    for row in rows:
        if row["value"] is not None:
            values.setdefault(row["case"], {})[row["key"]] = row["value"]
    found = {
        case: in_short(case_doubts(of_case, stops_alone=case in stops_alone)) for case, of_case in values.items()
    }
    return {case: doubt for case, doubt in found.items() if doubt}


def _case_name(config: SweepConfig, job: Job) -> str:
    """What a case is called in messages: the values of its axes, its seed, and the folder that holds it."""
    values = [f"{name} = {value!s:.60}" for name, value in zip(axis_names(config), job.values, strict=True)]
    return f"{', '.join((*values, f'seed {job.config.seed}'))} (cases/{job.key})"


def print_results(console: Console, out: Path, config: SweepConfig, jobs: Sequence[Job]) -> int:
    """Write the tables, print how many cases are done and which failed, and return how many failed."""
    failures = read_failures(out)
    rows = result_rows(out, config, plan_of_jobs(jobs), failures)
    write_tables(out, config, rows)
    failed = [job for job in jobs if job.key in failures and not job.is_done]
    n_done = sum(job.is_done for job in jobs)
    console.print(f"{n_done} of {counted(len(jobs), 'case')} done, {len(failed)} failed")
    doubts = doubtful_cases(rows, {job.key for job in jobs if takes_stops_alone(job.directory)})
    names = {job.key: _case_name(config, job) for job in jobs}
    for key, doubt in list(doubts.items())[:5]:
        console.print(f"doubtful: {names[key]}: {doubt}", markup=False, soft_wrap=True)
    if doubts:
        n = counted(len(doubts), "doubtful case")
        told = f"{n}, listed by 'arena sweep-report {out}'; to do: see why there; for SLAM, {MORE_STOPS}"
        console.print(told, markup=False, soft_wrap=True)
    for job in failed[:5]:
        console.print(f"  {names[job.key]}: {failures[job.key]}", markup=False)
    console.print(f"results: {out / 'results.parquet'} and .csv")
    return len(failed)
