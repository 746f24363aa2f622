"""`arena place`: where to put TX so that poses and contours have the smallest bounds."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from isac_arena.cli.options import Campaign, Json

if TYPE_CHECKING:
    from isac_arena.campaign.campaign import Campaign as LoadedCampaign
    from isac_arena.insight.placement.placement import Placement


def place(
    campaign: Campaign,
    out: Annotated[Path, typer.Option(help="PNG file to write.")],
    candidates: Annotated[
        str,
        typer.Option(
            help="'all' or names of TX of the scene (a,b,c), a CSV file, or grid:STEP over the free floor."
        ),
    ] = "all",
    count: Annotated[int, typer.Option(min=1, max=20, help="How many TX to choose.")] = 1,
    criterion: Annotated[str, typer.Option(help="What to minimise: pose, contours or both.")] = "both",
    headings: Annotated[int, typer.Option(min=1, max=16, help="Headings to try at every candidate.")] = 1,
    keep: Annotated[bool, typer.Option("--keep", help="The TX of the campaign stand; choose more.")] = False,
    every: Annotated[int, typer.Option(min=1, help="Take every Nth stop of the walk.")] = 1,
    exhaustive: Annotated[bool, typer.Option("--exhaustive", help="Try all sets, not a greedy search.")] = False,
    run: Annotated[
        bool, typer.Option("--run", help="Run the campaign with the chosen TX: achieved beside predicted errors.")
    ] = False,
    json_file: Json = None,
) -> None:
    """Choose TX among candidates that minimise the bounds of poses and contours along the walk.

    The criterion is a geometric mean: over the stops of the position bound, over the pillars of the bound of the
    outline, or of both. The certificate says how far above the best possible choice it can be at most.
    """
    from isac_arena.campaign.campaign import load_campaign  # noqa: PLC0415
    from isac_arena.campaign.stages import console  # noqa: PLC0415
    from isac_arena.insight.placement import placement  # noqa: PLC0415
    from isac_arena.insight.placement.candidates import read_candidates  # noqa: PLC0415
    from isac_arena.insight.placement.criterion import criterion_name  # noqa: PLC0415
    from isac_arena.progress import progress_bar  # noqa: PLC0415
    from sim.transmitters import refuse_links  # noqa: PLC0415

    if out.suffix != ".png":
        raise ValueError(f"--out = {out}: must end in .png")
    wanted, loaded = criterion_name(criterion), load_campaign(campaign)
    refuse_links(loaded.config, "arena place")
    places = read_candidates(candidates, loaded.scene, headings)
    with progress_bar(console, transient=True) as progress:
        found = placement.place(
            loaded,
            places,
            count,
            wanted,
            stops=range(0, len(loaded.stops), every),
            keep=keep,
            all_sets=exhaustive,
            track=lambda rows: progress.track(rows, description="candidates"),
            track_sets=lambda sets: progress.track(sets, description="sets"),
        )
    _report(loaded, found, out, json_file, run=run)


def _report(
    campaign: "LoadedCampaign", found: "Placement", out: Path, json_file: Path | None, *, run: bool
) -> None:
    """Tables, the figure and the file of a placement; with `run` also what the campaign achieves with it."""
    import json  # noqa: PLC0415

    from isac_arena.campaign.files import write_bytes  # noqa: PLC0415
    from isac_arena.campaign.stages import console  # noqa: PLC0415
    from isac_arena.insight.bounds import tables  # noqa: PLC0415
    from isac_arena.insight.placement import achieved, placement  # noqa: PLC0415
    from isac_arena.progress import working  # noqa: PLC0415
    from isac_arena.report.figures.several_tx import several_tx_figure  # noqa: PLC0415
    from isac_arena.report.style import png_bytes  # noqa: PLC0415

    bounds = found.bounds()
    together = {tables.TOGETHER: bounds}
    for table in (
        placement.placement_table(found),
        tables.pose_table(together),
        tables.contour_table(found.several, together),
    ):
        console.print(table)
    console.print(placement.certificate(found))
    numbers = placement.as_numbers(found) | {"bounds": tables.as_numbers(found.several, together)}
    if run:
        with working(console, "the campaign with the chosen TX"):
            rows = achieved.compared_with_run(campaign, found)
        console.print(achieved.comparison_table(rows))
        numbers["achieved"] = achieved.as_numbers(rows)
    rest = [each.pose for row, each in enumerate(found.candidates) if row not in found.chosen]
    title = f"{campaign.scene.name}: {len(found.chosen)} of {len(found.candidates)} TX, {found.criterion}"
    write_bytes(out, png_bytes(several_tx_figure(found.several, found.chosen, bounds, rest, title)))
    if json_file is not None:
        write_bytes(json_file, json.dumps(numbers, indent=2).encode())
    console.print(f"figure: {out}")
