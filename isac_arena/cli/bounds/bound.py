"""`arena bound`: lower bounds of the errors of paths, receiver and contours, over the plan of a scene."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from isac_arena.cli.options import Campaign, Json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from isac_arena.campaign.campaign import Campaign as LoadedCampaign


def bound(
    campaign: Campaign,
    out: Annotated[Path, typer.Option(help="PNG file to write.")],
    step_m: Annotated[
        float | None, typer.Option("--step", min=0.05, max=5.0, help="Grid step in m; by default 40 cells.")
    ] = None,
    fixed: Annotated[
        bool, typer.Option("--fixed", help="Give all paths the fixed errors of table slam.noise instead.")
    ] = False,
    contours: Annotated[
        bool,
        typer.Option("--contours", help="Bounds of stops and pillars by TX, and what each TX lights, instead."),
    ] = False,
    json_file: Json = None,
) -> None:
    """Draw the bounds of position and channel over the plan, and print those along the walk.

    Bounds are those of the scores: from the signal, the arrays and the joint paths of the campaign. The channel's
    figure, of delay and angles of the strongest path of a TX, is written beside: NAME_channel.png, of several TX
    NAME_channel_TX.png. With --contours a single figure shows stops and pillars, and --json has its numbers.
    """
    from isac_arena.campaign.campaign import load_campaign  # noqa: PLC0415
    from isac_arena.campaign.files import write_bytes  # noqa: PLC0415
    from isac_arena.campaign.stages import console  # noqa: PLC0415
    from isac_arena.report.style import png_bytes  # noqa: PLC0415

    if out.suffix != ".png":
        raise ValueError(f"--out = {out}: must end in .png")
    if json_file is not None and not contours:
        raise ValueError(f"--json = {json_file}: only with --contours")
    if contours and (fixed or step_m is not None):
        raise ValueError("--contours: bounds stops and pillars from the signal; leave --fixed and --step out")
    loaded = load_campaign(campaign)
    figures, tables = _contours(loaded, out, json_file) if contours else _plan(loaded, out, step_m, fixed=fixed)
    for file, figure in figures.items():
        write_bytes(file, png_bytes(figure))
    for each in tables:
        console.print(each)
    console.print("figures: " + ", ".join(map(str, figures)))


def _plan(
    loaded: "LoadedCampaign", out: Path, step_m: float | None, *, fixed: bool
) -> tuple[dict[Path, "Figure"], list[Any]]:
    """Figures and tables of the position over the plan, and of the channel of every TX."""
    from dataclasses import replace  # noqa: PLC0415

    from isac_arena.campaign.stages import console  # noqa: PLC0415
    from isac_arena.insight.bounds import channel as channel_bound  # noqa: PLC0415
    from isac_arena.insight.bounds import position as bound_map  # noqa: PLC0415
    from isac_arena.insight.bounds import signal as signal_bound  # noqa: PLC0415
    from isac_arena.progress import progress_bar, working  # noqa: PLC0415
    from isac_arena.report.figures.bound import FROM_SIGNAL, bound_figure, channel_bound_figure  # noqa: PLC0415
    from sim.transmitters import refuse_several_tx  # noqa: PLC0415

    if fixed:
        refuse_several_tx(loaded.config, loaded.scene, "arena bound --fixed")
    links = signal_bound.links_of_walk(loaded)
    channels: dict[Path, Any] = {}
    tables: list[Any] = []
    with working(console, "paths and bounds of the channel"):
        for link_name, link in links.items():
            prepared = bound_map.bound_inputs(replace(loaded, config=link.config, scene=link.scene))
            model, grid = channel_bound.channel_model(prepared), bound_map.plan_grid(prepared, step_m)
            name = "channel" if len(links) == 1 else f"channel_{link_name}"
            over_plan = channel_bound.over_plan(model, grid)
            channels[out.with_stem(f"{out.stem}_{name}")] = channel_bound_figure(prepared.scene, over_plan)
            tables.append(channel_bound.along_walk(model, link.chosen_stops))
            tables[-1].title = None if len(links) == 1 else link_name
        if fixed:
            noise = loaded.config.slam.noise
            errors = f"for fixed errors of {noise.delay_std_ns:g} ns and {noise.angle_std_deg:g} deg of every path"
            found, table = bound_map.over_plan(prepared, grid), bound_map.along_walk(prepared)
    if not fixed:
        with progress_bar(console, transient=True) as progress:
            bounds, errors = signal_bound.SignalBounds(loaded), FROM_SIGNAL
            table, _ = signal_bound.along_walk(bounds, lambda stops: progress.track(stops, description="stops"))
            found = signal_bound.over_plan(bounds, grid, lambda rows: progress.track(rows, description="plan"))
    return {out: bound_figure(loaded.scene, found, errors), **channels}, [*tables, table]


def _contours(
    loaded: "LoadedCampaign", out: Path, json_file: Path | None
) -> tuple[dict[Path, "Figure"], list[Any]]:
    """Figure and tables of the bounds of stops and pillars from every TX and from all."""
    import json  # noqa: PLC0415

    from isac_arena.campaign.files import write_bytes  # noqa: PLC0415
    from isac_arena.campaign.stages import console  # noqa: PLC0415
    from isac_arena.insight.bounds import tables as bound_tables  # noqa: PLC0415
    from isac_arena.insight.bounds.several_tx import SeveralTx  # noqa: PLC0415
    from isac_arena.insight.bounds.signal import LinkBounds, links_of_walk  # noqa: PLC0415
    from isac_arena.progress import progress_bar  # noqa: PLC0415
    from isac_arena.report.figures.several_tx import several_tx_figure  # noqa: PLC0415

    runs = list(links_of_walk(loaded).values())
    links, stops = [LinkBounds(run, single=True) for run in runs], list(runs[0].chosen_stops)
    if any(list(run.chosen_stops) != stops for run in runs):
        raise ValueError("links: with --contours all walks of the links must have the same stops")
    with progress_bar(console, transient=True) as progress:
        several = SeveralTx(
            links, stops, loaded.config.contours, lambda rows: progress.track(rows, description="TX")
        )
    bounds = bound_tables.by_tx(several)
    if json_file is not None:
        numbers = {"campaign": loaded.config.name, "from": bound_tables.as_numbers(several, bounds)}
        write_bytes(json_file, json.dumps(numbers, indent=2).encode())
    title = f"{loaded.scene.name}: expected errors of stops and outlines"
    figure = several_tx_figure(several, range(len(links)), list(bounds.values())[-1], title=title)
    return {out: figure}, [bound_tables.pose_table(bounds), bound_tables.contour_table(several, bounds)]
