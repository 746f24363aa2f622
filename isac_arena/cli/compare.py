"""`arena compare`: two runs over the same stops, pair by pair."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from isac_arena.cli.options import with_clock

if TYPE_CHECKING:
    from isac_arena.insight.comparison.runs import RunComparison
    from isac_arena.scoring.metrics.metric import Metric
    from isac_arena.scoring.record import ScoreTables
    from isac_arena.setting_differences import SettingDifference

SHOWN_KEYS = 4  # of the scores that one run alone has


@dataclass(frozen=True)
class Run:
    """A scored run: settings, scene (None where its file is gone) and scores."""

    directory: Path
    settings: dict[str, Any]
    methods: dict[str, str]  # of each stage that a function of a user can replace
    scene: dict[str, Any] | None
    tables: ScoreTables
    metrics: tuple[Metric, ...]


@with_clock
def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="Directory of a campaign or of a sweep's case.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="The directory to compare with it.")],
    out: Annotated[Path, typer.Option(help="Directory of the table and the figure; made where missing.")],
) -> None:
    """Compare two scored runs over the same stops: paired differences B minus A with 95 % intervals.

    Also lists the settings that differ, and what only one run has.
    """
    from rich.console import Console  # noqa: PLC0415

    from isac_arena.insight.comparison.runs import compare_runs  # noqa: PLC0415
    from isac_arena.insight.comparison.table import difference_table, difference_words, method_table, setting_table  # noqa: PLC0415

    if (out / "campaign.json").exists():
        raise ValueError(f"--out = {out}: holds a campaign; choose another directory")
    a, b = read_run(first), read_run(second)
    try:
        compared = compare_runs(a.tables, b.tables)
    except ValueError as error:
        raise ValueError(f"{first}, {second}: {error}") from error
    changed = changed_settings(a, b)
    notes = [*compared.notes, *_score_notes(a, b)]
    if a.scene is None or b.scene is None:
        notes.append(f"the scene of {'A' if a.scene is None else 'B'} is not there: scenes are not compared")
    write_comparison(out, (a, b), compared, changed, notes)
    console = Console(highlight=False)
    console.print(difference_table(compared))
    for line in difference_words(compared):
        console.print(line, markup=False, soft_wrap=True)
    console.print(method_table(a.methods, b.methods) if a.methods != b.methods else "methods: all are the same")
    console.print(setting_table(changed) if changed else "settings: all are the same")
    for note in notes:
        console.print(f"note: {note}", markup=False, soft_wrap=True)
    console.print(
        f"compare: {out / 'compare.png'} and compare.json, which has all scores side by side", soft_wrap=True
    )


def read_run(directory: Path) -> Run:
    """A scored campaign, or a case of a sweep.

    Raises `ValueError`, one line, where the directory holds neither, or files of it are missing or damaged.
    """
    from isac_arena.campaign.config import CampaignConfig, methods  # noqa: PLC0415
    from isac_arena.campaign.directory import stored_settings  # noqa: PLC0415
    from isac_arena.campaign.manifest import MANIFEST, check_unchanged, read_manifest  # noqa: PLC0415
    from scenes.toml_config import validate_stored  # noqa: PLC0415

    if (directory / "sweep.json").is_file():
        raise ValueError(f"{directory}: holds a sweep; compare two of its cases, {directory}/cases/KEY")
    for name, verb in (("campaign.json", "run"), ("provenance.nc", "score"), ("scores.json", "score")):
        if not (directory / name).is_file():
            raise ValueError(f"{directory}: holds no scored run (no {name}); make one with 'arena {verb}'")
    check_unchanged(directory, ("campaign.json", "scene.toml", "provenance.nc", "scores.json"))
    is_known = (directory / MANIFEST).is_file() and "scene.toml" in read_manifest(directory).files
    if is_known and not (directory / "scene.toml").is_file():
        raise ValueError(f"{directory / 'scene.toml'}: missing; put it back as it was")
    file = directory / "campaign.json"
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        config = validate_stored(stored_settings(content), CampaignConfig, "settings")
        settings = {name: content.get(name) for name in ("measured", "stop_every")}
        case_scene = content.get("scene")
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ValueError(f"{file}: no settings of a campaign ({reason})") from error
    settings |= {**config.model_dump(mode="json"), "code": _code(directory)}
    scene = _read_scene(directory, case_scene)
    return Run(
        directory,
        settings,
        {str(stage): method for stage, method in methods(config).items()},
        scene,
        read_tables(directory),
        read_metrics(directory),
    )


def read_tables(directory: Path) -> ScoreTables:
    """The tables behind the scores of a run; `ValueError`, one line, where another version made them."""
    from isac_arena.campaign.files import read_record  # noqa: PLC0415
    from isac_arena.scoring.record import ScoreTables  # noqa: PLC0415

    try:
        return read_record(directory / "provenance.nc", ScoreTables)
    except ValueError as error:
        raise ValueError(f"{error}; score the run again where another version made it") from error


def read_metrics(directory: Path) -> tuple[Metric, ...]:
    """The scores of a run; `ValueError`, one line, where they are damaged."""
    from isac_arena.scoring.metrics.metric import from_json  # noqa: PLC0415

    file = directory / "scores.json"
    try:
        return from_json(json.loads(file.read_text(encoding="utf-8")))
    except (ValueError, TypeError) as error:
        raise ValueError(f"{file}: no scores ({error})") from error


def changed_settings(first: Run, second: Run) -> list[SettingDifference]:
    """Settings, then fields of the scene, that are not the same in both runs."""
    from isac_arena.setting_differences import setting_differences  # noqa: PLC0415

    changed = setting_differences(first.settings, second.settings)
    if first.scene is not None and second.scene is not None:
        changed += setting_differences({"scene": first.scene}, {"scene": second.scene})
    return changed


def write_comparison(
    out: Path, runs: tuple[Run, Run], compared: RunComparison, changed: list[SettingDifference], notes: list[str]
) -> None:
    """Write compare.json and compare.png."""
    from isac_arena.campaign.files import write_bytes, write_json  # noqa: PLC0415
    from isac_arena.report.figures.comparison import compare_figure  # noqa: PLC0415
    from isac_arena.report.style import png_bytes  # noqa: PLC0415

    paired = [
        {**{name: _number(value) for name, value in vars(one).items()}, "verdict": one.verdict}
        for one in compared.differences
    ]
    content = {
        "first": str(runs[0].directory),
        "second": str(runs[1].directory),
        "n_stops": compared.n_stops,
        "notes": notes,
        "methods": [
            {"stage": stage, "first": method, "second": runs[1].methods[stage]}
            for stage, method in runs[0].methods.items()
        ],
        "settings": [vars(one) for one in changed],
        "paired": paired,
        "scores": _side_by_side(runs[0].metrics, runs[1].metrics),
    }
    write_json(out / "compare.json", content)
    labels = [run.directory.resolve().name for run in runs]
    if labels[0] == labels[1]:
        labels = ["A", "B"]
    write_bytes(out / "compare.png", png_bytes(compare_figure(compared.differences, *labels)))


def _score_notes(first: Run, second: Run) -> list[str]:
    """Which scores only one run has: the other lacks the key or a finite value."""
    a, b = ({metric.key: metric.value for metric in run.metrics} for run in (first, second))
    notes = []
    for name, own, other in (("A", a, b), ("B", b, a)):
        finite = (key for key, value in own.items() if math.isfinite(value))
        alone = [key for key in finite if not math.isfinite(other.get(key, math.nan))]
        if alone:
            more = f" and {len(alone) - SHOWN_KEYS} more" if len(alone) > SHOWN_KEYS else ""
            one = "one score is" if len(alone) == 1 else f"{len(alone)} scores are"
            notes.append(f"{one} known only in {name}: {', '.join(alone[:SHOWN_KEYS])}{more}")
    return notes


def _side_by_side(first: tuple[Metric, ...], second: tuple[Metric, ...]) -> list[dict[str, Any]]:
    """All scores of both runs, without intervals: a score is one number of a whole run."""
    values = [{metric.key: metric for metric in metrics} for metrics in (first, second)]
    rows = []
    for key in dict.fromkeys([*values[0], *values[1]]):
        known = values[0].get(key) or values[1][key]
        a, b = (_number(found[key].value) if key in found else None for found in values)
        change = None if a is None or b is None else b - a
        rows.append(
            {"key": key, "first": a, "second": b, "difference": change, "unit": known.unit,
             "direction": known.direction}
        )  # fmt: skip
    return rows


def _read_scene(directory: Path, case_scene: str | None) -> dict[str, Any] | None:
    """The tables of the scene file of a campaign or of a sweep's case; None where it is gone."""
    from scenes.names import path_in, refuse_outer_links  # noqa: PLC0415
    from scenes.toml_config import read_toml  # noqa: PLC0415

    files = [directory / "scene.toml"]
    if case_scene is not None:
        files.append(path_in(directory.resolve().parents[1] / "scenes", case_scene) / "scene.toml")
        refuse_outer_links(files[-1].parent)
    known = [file for file in files if file.is_file()]
    return read_toml(known[0]) if known else None


def _code(directory: Path) -> str | None:
    """The code that made a run; None where its manifest does not say."""
    from isac_arena.campaign.manifest import read_manifest  # noqa: PLC0415

    try:
        return ", ".join(dict.fromkeys(str(one["code"]) for one in read_manifest(directory).made_by))
    except (ValueError, LookupError):
        return None


def _number(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
