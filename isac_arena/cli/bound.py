"""`arena bound`: lower bounds of the errors of paths and receiver, over the plan of a scene."""

from pathlib import Path
from typing import Annotated

import typer

from isac_arena.cli.options import Campaign


def bound(
    campaign: Campaign,
    out: Annotated[Path, typer.Option(help="PNG file to write.")],
    step_m: Annotated[
        float | None, typer.Option("--step", min=0.05, max=5.0, help="Grid step in m; by default 40 cells.")
    ] = None,
    fixed: Annotated[
        bool, typer.Option("--fixed", help="Give all paths the fixed errors of table slam.noise instead.")
    ] = False,
) -> None:
    """Draw the bounds of position and channel over the plan, and print those along the walk.

    Bounds are those of the scores: from the signal, the arrays and the joint paths of the campaign. The channel's
    figure, of delay and angles of the strongest path, is written beside: NAME_channel.png.
    """
    from isac_arena.campaign.campaign import load_campaign  # noqa: PLC0415
    from isac_arena.campaign.files import write_bytes  # noqa: PLC0415
    from isac_arena.campaign.stages import console  # noqa: PLC0415
    from isac_arena.insight.bounds import channel as channel_bound  # noqa: PLC0415
    from isac_arena.insight.bounds import position as bound_map  # noqa: PLC0415
    from isac_arena.insight.bounds import signal as signal_bound  # noqa: PLC0415
    from isac_arena.progress import progress_bar, working  # noqa: PLC0415
    from isac_arena.report.figures.bound import FROM_SIGNAL, bound_figure, channel_bound_figure  # noqa: PLC0415
    from isac_arena.report.style import png_bytes  # noqa: PLC0415
    from sim.transmitters import refuse_several_tx  # noqa: PLC0415

    if out.suffix != ".png":
        raise ValueError(f"--out = {out}: must end in .png")
    loaded = load_campaign(campaign)
    refuse_several_tx(loaded.config, loaded.scene, "arena bound")
    prepared = bound_map.bound_inputs(loaded)
    with working(console, "paths and bounds of the channel"):
        model, grid = channel_bound.channel_model(prepared), bound_map.plan_grid(prepared, step_m)
        channel = channel_bound_figure(prepared.scene, channel_bound.over_plan(model, grid))
        tables = [channel_bound.along_walk(model)]
    with progress_bar(console, transient=True) as progress:
        if fixed:
            noise = loaded.config.slam.noise
            errors = f"for fixed errors of {noise.delay_std_ns:g} ns and {noise.angle_std_deg:g} deg of every path"
            found, table = bound_map.over_plan(prepared, grid), bound_map.along_walk(prepared)
        else:
            bounds, errors = signal_bound.SignalBounds(loaded), FROM_SIGNAL
            table, _ = signal_bound.along_walk(bounds, lambda stops: progress.track(stops, description="stops"))
            found = signal_bound.over_plan(bounds, grid, lambda rows: progress.track(rows, description="plan"))
    tables.append(table)
    figures = {out: bound_figure(prepared.scene, found, errors), out.with_stem(f"{out.stem}_channel"): channel}
    for file, figure in figures.items():
        write_bytes(file, png_bytes(figure))
    for each in tables:
        console.print(each)
    console.print("figures: " + ", ".join(map(str, figures)))
