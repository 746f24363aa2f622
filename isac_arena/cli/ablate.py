"""`arena ablate`: one campaign with each hardware impairment alone, with all and with none."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from isac_arena.cli.options import Campaign, OutFolder, Seed

if TYPE_CHECKING:
    from rich.table import Table

    from isac_arena.insight.ablation import Ablation


def ablate(
    campaign: Campaign,
    out: OutFolder,
    seed: Seed = None,
    step: Annotated[int, typer.Option(min=1, help="Take every step-th receiver stop.")] = 1,
) -> None:
    """Rank the hardware impairments of a campaign by their effect on ToA, angles, pose, map and shape.

    Paths are traced once and all variants draw the same random numbers.
    """
    from rich.console import Console  # noqa: PLC0415

    from isac_arena.campaign.campaign import load_campaign  # noqa: PLC0415
    from isac_arena.insight.ablation import score_variants, variants  # noqa: PLC0415
    from isac_arena.progress import progress_bar, tracked  # noqa: PLC0415

    console = Console(highlight=False)
    loaded = load_campaign(campaign, seed=seed)
    config, scene = loaded.config, loaded.scene
    n_variants = len(variants(config.impairments))
    stops = range(0, len(scene.stops), step)
    traced = loaded.chain(stops).truths()
    truths = list(tracked(console, traced, len(stops), "trace"))
    with progress_bar(console, transient=True) as progress:
        task = progress.add_task("variants", total=n_variants)
        ablation = score_variants(
            config, scene, truths, lambda name: progress.update(task, advance=1, description=f"{name} done")
        )
    console.print(ablation_table(ablation))
    write_ablation(out, ablation)
    console.print(f"ablation: {out / 'ablation.png'}, .csv and .json")


def ablation_table(ablation: Ablation) -> Table:
    """One row per variant, the strongest impairment first."""
    from rich.box import SIMPLE  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    from isac_arena.insight.ablation import EFFECTS, score_text  # noqa: PLC0415

    table = Table(
        "impairment", *[f"{label}\n{unit}" for label, unit in EFFECTS.values()], "mean\nratio",
        title="RMS errors with each impairment alone",
        caption="mean ratio: geometric mean over the columns of the error over that without impairments;"
        " values that could not be measured (-) do not count",
        box=SIMPLE, padding=0, show_edge=False,
    )  # fmt: skip
    for column in table.columns:
        column.no_wrap = True
        column.justify = "left" if column is table.columns[0] else "right"
    for name, values, growth in zip(ablation.variant, ablation.value, ablation.growth, strict=True):
        table.add_row(name, *map(score_text, values), f"{2.0**growth:.2f}")
    return table


def write_ablation(out: Path, ablation: Ablation) -> None:
    """Write ablation.csv, ablation.json and ablation.png."""
    from isac_arena.campaign.files import write_bytes, write_csv, write_json  # noqa: PLC0415
    from isac_arena.insight.ablation import table_rows  # noqa: PLC0415
    from isac_arena.report.figures.ablation import ablation_figure  # noqa: PLC0415
    from isac_arena.report.style import png_bytes  # noqa: PLC0415

    rows = list(table_rows(ablation))
    write_csv(out / "ablation.csv", rows)
    write_json(out / "ablation.json", {"variants": rows})
    write_bytes(out / "ablation.png", png_bytes(ablation_figure(ablation)))
