"""`arena budget`: where the final pose and shape errors of a campaign come from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from isac_arena.cli.options import Campaign, Channel, Mapping, Seed, Shapes, Slam, functions

if TYPE_CHECKING:
    from rich.table import Table

    from isac_arena.insight.budget.record import Budget


def budget(
    campaign: Campaign,
    out: Annotated[Path, typer.Option(help="Directory of the budget; CAMPAIGN_DIR/budget puts it in the report.")],
    seed: Seed = None,
    repeats: Annotated[
        int, typer.Option(min=1, help="Runs with seeds that count up; paths are traced once for all.")
    ] = 1,
    stops: Annotated[
        str | None, typer.Option(help="Receiver stops: 0,4,9 or first:last:step without last; all by default.")
    ] = None,
    channel: Channel = None,
    mapping: Mapping = None,
    slam: Slam = None,
    shapes: Shapes = None,
) -> None:
    """Replace each stage by truth, switch off physics, and report how much the final errors fall.

    All variants draw the same random numbers. The same command resumes an interrupted budget.
    """
    from rich.console import Console  # noqa: PLC0415

    from isac_arena.insight.budget.runs import budget_job, run_budget  # noqa: PLC0415

    console = Console(highlight=False)
    named = functions(channel=channel, mapping=mapping, slam=slam, shapes=shapes)
    with budget_job(campaign, out, seed, repeats, stops, named) as job:
        found = run_budget(job, console)
        write_budget(job.side or out, found)
    for table in budget_tables(found):
        console.print(table)
    console.print(f"budget: {out / 'budget.png'}, .csv and .json")


def budget_tables(budget: Budget) -> list[Table]:
    """A table per outcome and kind of budget: the contribution of every part to the mean square error.

    In shares with intervals, or in cm^2 where shares would have no meaning.
    """
    from rich.box import SIMPLE  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    from isac_arena.insight.budget.record import OUTCOMES, table_rows  # noqa: PLC0415

    tables: dict[tuple[str, str], Table] = {}
    for row in table_rows(budget):
        key = str(row["outcome"]), str(row["budget"])
        if key not in tables:
            caption = f"Shares of the mean square; intervals over {OUTCOMES[key[0]][1]}s and orders;"
            caption += " undecided: the interval holds zero."
            columns = ["share %", "95 % from", "to", "RMS m", "alone m", "without it"]
            if row["objection"]:
                caption = f"No shares: {row['objection']}. Parts of the mean square in cm2 and their roots."
                columns = ["cm2", "RMS m", "alone m"]
            tables[key] = Table(
                "part", *columns, title=f"{key[0]} error by {key[1]}", caption=caption, box=SIMPLE,
                padding=(0, 1, 0, 0), show_edge=False, pad_edge=False, caption_justify="left",
            )  # fmt: skip
            for column in tables[key].columns[1:]:
                column.justify = "left" if column.header == "without it" else "right"
                column.no_wrap = True
        roots = _cell(row["rms_m"], 1, 4), _cell(row["alone_rms_m"], 1, 4)
        if row["objection"]:
            tables[key].add_row(str(row["part"]), _cell(row["mean_square_m2"], 1e4, 2), *roots)
        else:
            shares = [_cell(row[name], 100, 1) for name in ("share", "share_low", "share_high")]
            tables[key].add_row(str(row["part"]), *shares, *roots, str(row["effect"]))
    return list(tables.values())


def write_budget(out: Path, budget: Budget) -> None:
    """Write budget.csv, budget.json and budget.png."""
    from isac_arena.campaign.files import write_bytes, write_csv, write_json  # noqa: PLC0415
    from isac_arena.insight.budget.record import table_rows  # noqa: PLC0415
    from isac_arena.report.figures.budget import budget_figure  # noqa: PLC0415
    from isac_arena.report.style import png_bytes  # noqa: PLC0415

    rows = list(table_rows(budget))
    write_csv(out / "budget.csv", rows)
    about = {name: getattr(budget, name) for name in ("campaign", "stops", "objects", "repeats")} | {"rows": rows}
    write_json(out / "budget.json", about, allow_nan=False)
    write_bytes(out / "budget.png", png_bytes(budget_figure(budget)))


def _cell(value: str | float | None, scale: float, decimals: int) -> str:
    return "-" if value is None else f"{scale * float(value):.{decimals}f}"
