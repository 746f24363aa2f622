"""`arena compare`: two runs over the same stops, pair by pair."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from estimation.compare import Comparison
    from estimation.scoring.metric import Metric
    from estimation.scoring.record import ScoreTables

COLORS = {"better": "green", "worse": "bold red", "different": "magenta"}


def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="Directory of a campaign or of a sweep's case.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="The directory to compare with it.")],
    out: Annotated[Path, typer.Option(help="Directory of the table and the figure; made where missing.")],
) -> None:
    """Compare two scored runs over the same stops: paired differences B minus A with 95 % intervals."""
    from rich.console import Console  # noqa: PLC0415

    from estimation.compare import compare_runs  # noqa: PLC0415

    if (out / "campaign.json").exists():
        raise ValueError(f"--out = {out}: holds a campaign; choose another directory")
    tables = [read_tables(directory) for directory in (first, second)]
    metrics = [read_metrics(directory) for directory in (first, second)]
    try:
        compared = compare_runs(*tables)
    except ValueError as error:
        raise ValueError(f"{first}, {second}: {error}") from error
    write_comparison(out, compared, metrics, (str(first), str(second)))
    console = Console(highlight=False)
    console.print(difference_table(compared))
    for note in compared.notes:
        console.print(f"note: {note}")
    console.print(f"compare: {out / 'compare.png'} and compare.json, which has all scores side by side")


def read_tables(directory: Path) -> ScoreTables:
    """The tables behind the scores of a run.

    Raises `ValueError`, one line, where the directory holds no scored run, or one with other tables.
    """
    from estimation.scoring.record import ScoreTables  # noqa: PLC0415
    from sim.store import read_record  # noqa: PLC0415

    for name, verb in (("campaign.json", "run"), ("provenance.nc", "score")):
        if not (directory / name).is_file():
            raise ValueError(f"{directory}: holds no scored run (no {name}); make one with 'arena {verb}'")
    try:
        return read_record(directory / "provenance.nc", ScoreTables)
    except ValueError as error:
        raise ValueError(f"{error}; score the run again where another version made it") from error


def read_metrics(directory: Path) -> tuple[Metric, ...]:
    """The scores of a run; `ValueError`, one line, where they are missing or damaged."""
    from estimation.scoring.metric import from_json  # noqa: PLC0415

    file = directory / "scores.json"
    if not file.is_file():
        raise ValueError(f"{directory}: holds no scored run (no scores.json); make one with 'arena score'")
    try:
        return from_json(json.loads(file.read_text(encoding="utf-8")))
    except (ValueError, TypeError) as error:
        raise ValueError(f"{file}: no scores ({error})") from error


def difference_table(compared: Comparison) -> Table:
    """A row per paired quantity that both runs have."""
    from rich.box import SIMPLE  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    shown = [one for one in compared.differences if one.n_pairs]
    table = Table(
        "quantity",
        "A",
        "B",
        "B - A, 95 % interval",
        "n",
        "B is",
        title=f"Paired differences over {compared.n_stops} stops",
        caption="n: stops or objects; intervals: BCa bootstrap over them. A difference is told where the"
        f" signed-rank test agrees; of {len(shown)} quantities about {round(0.05 * len(shown))} may by chance",
        box=SIMPLE,
        padding=(0, 1, 0, 0),
        show_edge=False,
    )
    table.columns[0].overflow = "fold"
    for column in table.columns[1:]:
        column.no_wrap = True
        column.justify = "left" if column is table.columns[-1] else "right"
    for one in shown:
        interval = "-" if math.isnan(one.low) else f"{one.low:+.2g} .. {one.high:+.2g}"
        color = COLORS.get(one.verdict)
        verdict = f"[{color}]{one.verdict}[/]" if color else one.verdict
        unit = "" if one.unit == "1" else f" {one.unit}"
        values = f"{one.first:.3g}", f"{one.second:.3g}", f"{one.difference:+.2g}, {interval}"
        table.add_row(f"{one.key}{unit}", *values, str(one.n_groups), verdict)
    return table


def write_comparison(
    out: Path, compared: Comparison, metrics: list[tuple[Metric, ...]], names: tuple[str, str]
) -> None:
    """Write compare.json and compare.png."""
    from estimation.report.compare_figure import compare_figure  # noqa: PLC0415
    from estimation.report.style import png_bytes  # noqa: PLC0415
    from sim.store import write_bytes, write_text  # noqa: PLC0415

    content = {
        "first": names[0],
        "second": names[1],
        "n_stops": compared.n_stops,
        "notes": list(compared.notes),
        "paired": [
            {
                **{name: _number(value) for name, value in vars(one).items()},
                "verdict": one.verdict,
            }
            for one in compared.differences
        ],
        "scores": _side_by_side(*metrics),
    }
    write_text(out / "compare.json", json.dumps(content, indent=1) + "\n")
    labels = [Path(name).name or name for name in names]
    if labels[0] == labels[1]:
        labels = ["A", "B"]
    write_bytes(out / "compare.png", png_bytes(compare_figure(compared.differences, *labels)))


def _side_by_side(first: tuple[Metric, ...], second: tuple[Metric, ...]) -> list[dict[str, Any]]:
    """All scores that one run or the other has, without intervals: a score is one number of a whole run."""
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


def _number(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
