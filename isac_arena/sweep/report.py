"""The report page of a sweep, finished or not: figures and tables."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from isac_arena.campaign.manifest import MANIFEST, read_manifest
from isac_arena.progress import counted
from isac_arena.report.page.tables import in_words, score_title
from isac_arena.report.sweep.captions import axis_caption, parallel_caption, pareto_caption
from isac_arena.report.sweep.figures import axis_figure, parallel_figure, pareto_figure
from isac_arena.report.sweep.page import SweepFigure, axis_tables, render_sweep, table
from isac_arena.report.sweep.results import SweepAxis, SweepMetric, SweepResults
from isac_arena.scoring.words import legend
from isac_arena.settings import UNITS
from isac_arena.sweep.config import SweepConfig
from isac_arena.sweep.store import PlannedCase, is_done, takes_stops_alone
from isac_arena.sweep.table import axis_names
from scenes.names import path_in

MAIN = (
    "slam.position.rmse_m",
    "slam.heading.rmse_deg",
    "slam.clock.rmse_ns",
    "mapping.ip_to_surface.median_m",
    "channel.delay.rmse_ns",
    "channel.aoa.rmse_deg",
    "channel.detection_rate",
    "channel.false_per_stop",
    "channel.delay.over_bound.median",
    "contours.mapping.pillar.seen_rmse.mean_m",
    "contours.mapping.pillar.iou.mean",
    "contours.mapping.false",
)
TRADE_OFFS = (
    ("channel.false_per_stop", "channel.detection_rate"),
    ("slam.position.rmse_m", "mapping.ip_to_surface.median_m"),
)
MOST_FAILURES = 20


def sweep_results(directory: Path, config: SweepConfig, rows: Sequence[dict[str, Any]]) -> SweepResults:
    """The rows of the results table of finished cases in a directory as arrays, a value per case."""
    cases = list(dict.fromkeys(row["case"] for row in rows))
    place = {case: index for index, case in enumerate(cases)}
    values: dict[str, Any] = {}
    heads: dict[str, tuple[str, str]] = {}
    first: dict[str, dict[str, Any]] = {}
    for row in rows:
        first.setdefault(row["case"], row)
        heads.setdefault(row["key"], (row["unit"], row["direction"]))
        column = values.setdefault(row["key"], np.full(len(cases), np.nan))
        column[place[row["case"]]] = np.nan if row["value"] is None else row["value"]
    axes = [
        SweepAxis(axis.label or axis_title(axis.field), tuple(first[case][name] for case in cases), axis.log)
        for name, axis in zip(axis_names(config), config.axes, strict=True)
    ]
    metrics = {key: SweepMetric(key, *heads[key], column) for key, column in values.items()}
    points = np.array([first[case]["point"] for case in cases], int)
    alone = tuple(takes_stops_alone(path_in(directory / "cases", case)) for case in cases)
    return SweepResults(points, tuple(axes), metrics, tuple(cases), alone)


def axis_title(field: str) -> str:
    """The readable name of an axis, with its unit."""
    unit = next((unit for ending, unit in UNITS.items() if field.endswith(ending)), "")
    return f"{in_words(field)} in {unit}" if unit else in_words(field)


def sweep_page(
    directory: Path,
    config: SweepConfig,
    cases: Sequence[PlannedCase],
    failures: Mapping[str, str],
    damaged: Mapping[str, str],
    results: SweepResults,
    keys: Sequence[str],
    pairs: Sequence[tuple[str, str]],
) -> str:
    """The report page of a sweep; failed and damaged cases with what is wrong, by their key."""
    sections: list[tuple[str, Sequence[SweepFigure | str]]] = []
    if keys:
        sections.append(("Metrics over every axis", _axis_figures(results, keys)))
        sections.append(("Trade-offs", [*_pareto_figures(results, pairs), *_parallel_figures(results, keys)]))
        sections.append(("Tables", axis_tables(results, keys)))
    else:
        nothing = "<p>No finished case yet, or no metric that changes over the cases.</p>"
        sections.append(("Metrics", [nothing]))
    doubts = {key: found for key, found in zip(results.keys, results.doubts, strict=True) if found}
    listed = {"doubtful": (doubts, "what"), "failed": (failures, "error"), "damaged": (damaged, "error")}
    for what, (found, head) in listed.items():
        rows = [[case.key, _case_settings(config, case), found[case.key]] for case in cases if case.key in found]
        if rows:
            shown = table(["case", "axes", head], rows[:MOST_FAILURES], "failed")
            sections.insert(0 if found is doubts else len(sections), (counted(len(rows), f"{what} case"), [shown]))
    titles = [*map(score_title, [*keys, *(key for pair in pairs for key in pair)]), *("doubtful" for _ in doubts)]
    if words := list(legend(titles)):
        sections.append(("Words", [f"<p>{'<br>'.join(map(escape, words))}</p>"]))
    return render_sweep(config.name, sweep_facts(directory, config, cases, failures, damaged), sections)


def sweep_facts(
    directory: Path,
    config: SweepConfig,
    cases: Sequence[PlannedCase],
    failures: Mapping[str, str],
    damaged: Mapping[str, str],
) -> dict[str, str]:
    """What was swept and how far it is, with its pace where it is not finished."""
    done = [case for case in cases if is_done(directory, case.key) and case.key not in damaged]
    failed = [case for case in cases if case.key in failures and case not in done]
    remaining = len(cases) - len(done) - len(failed)
    facts = {
        "Base": config.base,
        "Design": f"{config.design}, {counted(len({case.point for case in cases}), 'point')}",
        "Axes": ", ".join(axis_names(config)) or "none",
        "Cases": f"{len(done)} of {len(cases)} done, {len(failed)} failed",
    }
    if damaged:
        facts["Cases"] += f", {len(damaged)} damaged"
    times = sorted((directory / "cases" / case.key / "scores.json").stat().st_mtime for case in done)
    if remaining and len(times) > 1 and times[-1] > times[0]:
        pace = (len(times) - 1) / (times[-1] - times[0])
        minutes = remaining / pace / 60
        facts["Pace"] = f"{60 * pace:.3g} cases a minute; {remaining} remain, about {minutes:.3g} minutes"
    if (directory / MANIFEST).is_file():
        facts["Made by"] = "; ".join(
            f"code {one['code']}, Python {one['python']}, {one['machine']['processor']}"
            for one in read_manifest(directory).made_by
        )
    return facts


def _axis_figures(results: SweepResults, keys: Sequence[str]) -> list[SweepFigure | str]:
    if not results.axes:
        return ["<p>The sweep has no axes; its tables hold the repeats.</p>"]
    return [
        SweepFigure(score_title(key), axis_figure(results, key), f"{axis_caption(results, key)} Score: {key}.")
        for key in keys
    ]


def _pareto_figures(results: SweepResults, pairs: Sequence[tuple[str, str]]) -> list[SweepFigure | str]:
    caption = pareto_caption(results)
    return [
        SweepFigure(f"{score_title(x)} against {score_title(y)}", pareto_figure(results, x, y), caption)
        for x, y in pairs
    ]


def _parallel_figures(results: SweepResults, keys: Sequence[str]) -> list[SweepFigure | str]:
    if not results.axes:
        return []
    shown = list(keys[:5])
    caption = parallel_caption(results, shown[0])
    return [SweepFigure("Parallel coordinates", parallel_figure(results, shown), caption)]


def _case_settings(config: SweepConfig, case: PlannedCase) -> str:
    values = [f"{name} = {value}" for name, value in zip(axis_names(config), case.values, strict=True)]
    return ", ".join([*values, f"seed {case.seed}"])
