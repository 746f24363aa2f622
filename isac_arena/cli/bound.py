"""`arena bound`: lower bounds of the errors of paths and receiver, over the plan of a scene."""

from pathlib import Path
from typing import Annotated

import typer

from isac_arena.cli.options import Campaign


def bound(
    campaign: Campaign,
    out: Annotated[Path, typer.Option(help="PNG file to write.")],
    step_m: Annotated[float, typer.Option("--step", min=0.05, max=5.0, help="Grid step in m.")] = 0.5,
) -> None:
    """Draw the bounds of position and channel over the plan, and print those along the walk.

    The channel's figure, of delay and angles of the strongest path, is written beside: NAME_channel.png.
    """
    from isac_arena.campaign.files import write_bytes  # noqa: PLC0415
    from isac_arena.campaign.stages import console  # noqa: PLC0415
    from isac_arena.insight.bounds import channel as channel_bound  # noqa: PLC0415
    from isac_arena.insight.bounds import position as bound_map  # noqa: PLC0415
    from isac_arena.report.figures.bound import bound_figure, channel_bound_figure  # noqa: PLC0415
    from isac_arena.report.style import png_bytes  # noqa: PLC0415

    if out.suffix != ".png":
        raise ValueError(f"--out = {out}: must end in .png")
    prepared = bound_map.bound_inputs(campaign)
    model = channel_bound.channel_model(prepared)
    with console.status("paths and bounds"):
        grid = bound_map.plan_grid(prepared, step_m)
        figures = {
            out: bound_figure(prepared.scene, bound_map.over_plan(prepared, grid)),
            out.with_stem(f"{out.stem}_channel"): channel_bound_figure(
                prepared.scene, channel_bound.over_plan(model, grid)
            ),
        }
        tables = [channel_bound.along_walk(model), bound_map.along_walk(prepared)]
    for file, figure in figures.items():
        write_bytes(file, png_bytes(figure))
    for table in tables:
        console.print(table)
    console.print("figures: " + ", ".join(map(str, figures)))
