"""`arena sweep`: many campaigns on a laptop or a cluster, resumed where they stopped."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from distributed import Client
    from rich.console import Console

    from scripts.sweep_config import SweepConfig
    from scripts.sweep_run import Job


def sweep(
    file: Annotated[Path, typer.Argument(help="Sweep file (TOML): a base campaign and its axes.")],
    out: Annotated[
        Path, typer.Option(help="Directory of the sweep, seen by all workers; made where missing.")
    ],
    workers: Annotated[
        int | None, typer.Option(min=1, help="Worker processes on this machine, by default one per core.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a running dask scheduler, in place of own workers.")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Check and count the cases, estimate time and disk, run none.")
    ] = False,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Run failed cases once more.")] = False,
) -> None:
    """Run every case of a sweep that is not there yet, and write the table of all results."""
    from rich.console import Console  # noqa: PLC0415

    from scenes.toml_config import load_config, read_text  # noqa: PLC0415
    from scripts.sweep_cases import base_path  # noqa: PLC0415
    from scripts.sweep_config import SweepConfig  # noqa: PLC0415
    from scripts.sweep_engine import connected  # noqa: PLC0415
    from scripts.sweep_store import forget_failures, open_sweep, read_failures  # noqa: PLC0415

    console = Console(highlight=False)
    config = load_config(file, SweepConfig)
    jobs = checked_jobs(file, config, out, range(config.repeats))
    if dry_run:
        tell_plan(console, config, jobs)
        return
    open_sweep(out, config, read_text(base_path(str(file), config)))
    if retry_failed:
        forget_failures(out, read_failures(out))
    if any(not job.is_done for job in jobs) or config.until is not None:
        with connected(workers, scheduler) as client:
            jobs = run_until_known(client, console, file, config, out, jobs)
    tell_results(console, out, config, jobs)


def checked_jobs(file: Path, config: SweepConfig, out: Path, repeats: Iterable[int]) -> list[Job]:
    """Every case of the sweep, with its settings and its scene checked before anything runs or is written.

    Raises `ConfigError`, one line, where a case is no valid campaign, and `ValueError` for an unknown estimator.
    """
    from scripts.sweep_cases import design_points, make_cases  # noqa: PLC0415
    from scripts.sweep_run import Job, check_case  # noqa: PLC0415

    jobs, seen = [], set()
    for case in make_cases(str(file), config, design_points(config), list(repeats)):
        job = Job(case, out)
        checked = (job.scene_hash, case.config.tx, case.config.walk, case.estimator)
        if checked not in seen:
            check_case(job)
            seen.add(checked)
        jobs.append(job)
    return jobs


def run_until_known(
    client: Client, console: Console, file: Path, config: SweepConfig, out: Path, jobs: list[Job]
) -> list[Job]:
    """Run the jobs; with `until`, repeat points with more seeds until the mean of the metric is known there."""
    run_missing(client, console, out, jobs)
    repeat = config.repeats
    while config.until is not None and repeat < config.until.max_repeats:
        open_points = unknown_points(out, config, jobs)
        more = [job for job in checked_jobs(file, config, out, [repeat]) if job.case.point in open_points]
        if not more:
            break
        run_missing(client, console, out, more)
        jobs, repeat = [*jobs, *more], repeat + 1
    return jobs


def unknown_points(out: Path, config: SweepConfig, jobs: Sequence[Job]) -> set[int]:
    """Points of the design whose mean of the metric in `until` is not known well enough yet.

    Raises `ValueError` where no finished case has that metric.
    """
    from scripts.sweep_store import read_failures  # noqa: PLC0415
    from scripts.sweep_table import result_rows, spread  # noqa: PLC0415

    if config.until is None:
        return set()
    rows = result_rows(config, jobs, read_failures(out))
    keys = {row["key"] for row in rows if row["key"] is not None}
    if keys and config.until.metric not in keys:
        raise ValueError(f"until.metric = '{config.until.metric}': no such metric in scores.json")
    found = spread(rows, config.until.metric, config.until.confidence)
    wanted = config.until.half_width
    return {point for point, value in found.items() if not value.half_width <= wanted}


def run_missing(client: Client, console: Console, out: Path, jobs: Sequence[Job]) -> None:
    """Run the jobs that are neither done nor known to fail, with throughput, failures and time left."""
    from rich.progress import (  # noqa: PLC0415
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from scripts.sweep_engine import run_jobs  # noqa: PLC0415
    from scripts.sweep_store import read_failures, write_failure  # noqa: PLC0415

    known = read_failures(out)
    pending = [job for job in jobs if not job.is_done and job.key not in known]
    if not pending:
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    n_failed, started = 0, time.monotonic()
    with Progress(*columns, console=console, speed_estimate_period=3600) as progress:
        task = progress.add_task("cases", total=len(jobs), completed=len(jobs) - len(pending), rate="")

        def report(job: Job, error: BaseException | None) -> None:
            nonlocal n_failed
            if error is not None:
                write_failure(out, job.key, error)
                n_failed += 1
            done = progress.tasks[task].completed + 1 - (len(jobs) - len(pending))
            per_minute = 60 * done / (time.monotonic() - started)
            progress.update(task, advance=1, rate=f"{per_minute:.3g} a minute, {n_failed} failed")

        run_jobs(client, pending, report)


def tell_results(console: Console, out: Path, config: SweepConfig, jobs: Sequence[Job]) -> None:
    """Write the tables, and say how many cases are done and what failed."""
    from scripts.sweep_store import read_failures  # noqa: PLC0415
    from scripts.sweep_table import result_rows, write_tables  # noqa: PLC0415

    failures = read_failures(out)
    write_tables(out, config, result_rows(config, jobs, failures))
    failed = [job for job in jobs if job.key in failures and not job.is_done]
    console.print(f"{sum(job.is_done for job in jobs)} of {len(jobs)} cases done, {len(failed)} failed")
    for job in failed[:5]:
        console.print(f"  case {job.key}: {failures[job.key]}")
    console.print(f"results: {out / 'results.parquet'} and .csv")
    if failed:
        raise typer.Exit(1)


def tell_plan(console: Console, config: SweepConfig, jobs: Sequence[Job]) -> None:
    """Say what a sweep would run, how long one core would take and how much disk it would fill."""
    from scripts.sweep_plan import estimate_cost  # noqa: PLC0415

    scenes = len({job.scene_hash for job in jobs})
    paths = len({job.paths_hash for job in jobs})
    points = len({job.case.point for job in jobs})
    console.print(
        f"{config.name}: {len(jobs)} cases, {points} points of {len(config.axes)} axes, {scenes} scenes, "
        f"{paths} sets of paths; {sum(job.is_done for job in jobs)} done"
    )
    if jobs:
        cost = estimate_cost(jobs)
        console.print(
            f"about {cost.core_hours:.2g} core hours and {cost.disk_gb:.2g} GB, judged from one stop of each of "
            f"{cost.n_tried} cases"
        )
