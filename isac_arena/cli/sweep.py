"""`arena sweep` and `arena sweep-report`: many campaigns on a laptop or a cluster, and their report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from isac_arena.cli.options import StopLimit, WorkerCount

if TYPE_CHECKING:
    from rich.console import Console

    from isac_arena.report.sweep.results import SweepResults
    from isac_arena.sweep.config import SweepConfig
    from isac_arena.sweep.plan import Plan

REPORT = "sweep_report.html"


def sweep(
    file: Annotated[Path, typer.Argument(help="Sweep file (TOML): a base campaign and its axes.")],
    out: Annotated[Path, typer.Option(help="Directory of the sweep, seen by all workers; made where missing.")],
    workers: WorkerCount = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a running dask scheduler, in place of own workers.")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Check and count the cases, estimate time and disk, run none.")
    ] = False,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Run failed cases again.")] = False,
    stop_limit: StopLimit = None,
) -> None:
    """Run all missing cases of a sweep, and write the table of all results."""
    from rich.console import Console  # noqa: PLC0415

    from isac_arena.progress import working  # noqa: PLC0415
    from isac_arena.sweep.config import SweepConfig  # noqa: PLC0415
    from isac_arena.sweep.plan import make_plan  # noqa: PLC0415
    from isac_arena.sweep.runner import run_sweep  # noqa: PLC0415
    from isac_arena.workers.workers import Workers, n_cores  # noqa: PLC0415
    from scenes.toml_config import load_config  # noqa: PLC0415

    console = Console(highlight=False)
    config = load_config(file, SweepConfig)
    with working(console, "plan"):
        plan = make_plan(str(file), config, out, range(config.repeats))
    if dry_run:
        print_plan(console, config, plan, 0 if scheduler else workers or n_cores())
        return
    if run_sweep(console, file, config, out, plan, Workers(workers, scheduler, stop_limit), retry_failed):
        raise typer.Exit(1)


def sweep_report(
    directory: Annotated[Path, typer.Argument(help="Directory of a sweep.")],
    metric: Annotated[
        list[str] | None, typer.Option(help="Metric to show, as in scores.json; may be given several times.")
    ] = None,
    pareto: Annotated[
        list[str] | None, typer.Option(help="Two metrics of a trade-off, KEY,KEY; may be given several times.")
    ] = None,
) -> None:
    """Write sweep_report.html: every metric over every axis, with intervals and bounds, and trade-offs.

    Cases whose files are damaged are left out, and named.
    """
    from rich.console import Console  # noqa: PLC0415

    from isac_arena.campaign.files import write_text  # noqa: PLC0415
    from isac_arena.campaign.manifest import check_unchanged, read_manifest  # noqa: PLC0415
    from isac_arena.campaign.recording import recorded_additions  # noqa: PLC0415
    from isac_arena.progress import counted, working  # noqa: PLC0415
    from isac_arena.sweep.report import sweep_page, sweep_results  # noqa: PLC0415
    from isac_arena.sweep.store import damaged_cases, read_failures, read_plan, read_sweep  # noqa: PLC0415
    from isac_arena.sweep.table import result_rows  # noqa: PLC0415

    console = Console(highlight=False)
    check_unchanged(directory, ("sweep.json", "plan.json"))
    config, _ = read_sweep(directory)
    cases, failures = read_plan(directory), read_failures(directory)
    if (directory / "results.csv").is_file():  # a sweep that ended has a manifest
        read_manifest(directory)
    with working(console, "results"):
        found = damaged_cases(directory)
        damaged = {case.key: found[case.key] for case in cases if case.key in found}
        whole = [case for case in cases if case.key not in damaged]
        results = sweep_results(directory, config, result_rows(directory, config, whole, {}))
    keys = _chosen(results, metric, directory)
    pairs = _pairs(results, pareto, directory)
    with working(console, "figures"):
        page = sweep_page(directory, config, cases, failures, damaged, results, keys, pairs)
        with recorded_additions(directory):
            write_text(directory / REPORT, page)
    console.print(f"report: {directory / REPORT}")
    if damaged:
        console.print(f"left out: {counted(len(damaged), 'damaged case')}; 'arena sweep' runs these again")
        for what in list(damaged.values())[:5]:
            console.print(f"  {what}", markup=False)
        raise typer.Exit(1)


def print_plan(console: Console, config: SweepConfig, plan: Plan, n_workers: int) -> None:
    """Print the cases of a sweep, and their estimated disk space and time on one core and on workers.

    0 workers are those of a scheduler, whose number is not known.
    """
    from isac_arena.progress import counted, duration, tracked  # noqa: PLC0415
    from isac_arena.sweep.plan import estimate_cost  # noqa: PLC0415

    jobs = plan.jobs
    points, paths = len({job.point for job in jobs}), len({job.paths_hash for job in jobs})
    console.print(
        f"{config.name}: {counted(len(jobs), 'case')}, {counted(points, 'point')} of "
        f"{counted(len(config.axes), 'axis', 'axes')}, {counted(len(plan.scenes), 'scene')}, "
        f"paths traced {counted(paths, 'time')}; {sum(job.is_done for job in jobs)} done",
        soft_wrap=True,
    )
    if config.until is not None:
        console.print(f"  and up to {config.until.max_repeats} repeats of every point")
    console.print("a few stops of up to 3 cases are computed to time them: about a minute")
    cost = estimate_cost(plan, lambda tried: tracked(console, tried, len(tried), "cases tried"))
    console.print(
        f"about {duration(3600 * cost.core_hours)} of one core and {cost.start_up_s:.0f} s for every worker to "
        f"start, {1e3 * cost.disk_gb:.2g} MB; estimated from a few stops of {counted(cost.n_tried, 'case')}",
        soft_wrap=True,
    )
    if n_workers and (n_missing := sum(not job.is_done for job in jobs)):
        at_once = min(n_workers, n_missing)
        wall_s = cost.start_up_s + 3600 * cost.core_hours / at_once
        console.print(f"  on {counted(at_once, 'worker')} of this machine: about {duration(wall_s)} of wall time")
    if cost.samples_gb:
        console.print(
            f"  and {cost.samples_gb:.2g} GB a worker for samples, removed after the cases that share them"
        )


def _chosen(results: SweepResults, asked: Sequence[str] | None, directory: Path) -> list[str]:
    """The metrics to show: those asked for, or the main ones that change over the cases."""
    from isac_arena.report.sweep.results import varying  # noqa: PLC0415
    from isac_arena.sweep.report import MAIN  # noqa: PLC0415

    for key in asked or ():
        _check_key(results, key, "--metric", directory)
    return list(asked or varying(results, MAIN))


def _pairs(results: SweepResults, asked: Sequence[str] | None, directory: Path) -> list[tuple[str, str]]:
    from isac_arena.report.sweep.results import varying  # noqa: PLC0415
    from isac_arena.sweep.report import TRADE_OFFS  # noqa: PLC0415

    if not asked:
        return [pair for pair in TRADE_OFFS if len(varying(results, pair)) == len(pair)]
    pairs = []
    for text in asked:
        first, comma, second = text.partition(",")
        if not comma:
            raise ValueError(f"--pareto = '{text}': write two metrics as KEY,KEY")
        for key in (first, second):
            _check_key(results, key, "--pareto", directory)
        pairs.append((first, second))
    return pairs


def _check_key(results: SweepResults, key: str, option: str, directory: Path) -> None:
    import numpy as np  # noqa: PLC0415

    if key not in results.metrics or not np.isfinite(results.metrics[key].value).any():
        raise ValueError(f"{option} = '{key}': no finished case of {directory} has measured it; see results.csv")
