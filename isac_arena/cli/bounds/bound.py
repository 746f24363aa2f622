"""`arena bound`: lower bounds of the errors of paths, receiver and contours, over the plan of a scene."""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from isac_arena.cli.options import Campaign

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from isac_arena.campaign.campaign import Campaign as LoadedCampaign
    from isac_arena.insight.bounds.position import PlanGrid

CHANNEL_SHARE = 0.25  # of the time of a place beside its position bound
JsonNumbers = Annotated[Path | None, typer.Option("--json", help="Write the numbers to this JSON file as well.")]
Results = tuple[dict[Path, "Figure"], list[Any], dict[str, Any]]  # figures, tables and lines, and numbers


def bound(
    campaign: Campaign,
    out: Annotated[Path, typer.Option(help="PNG file to write.")],
    step_m: Annotated[
        float | None,
        typer.Option(
            "--step",
            min=0.05,
            max=5.0,
            help="Distance of the places over the plan in m; by default 400 places over all TX, some minutes.",
        ),
    ] = None,
    fixed: Annotated[
        bool, typer.Option("--fixed", help="Give all paths the fixed errors of table slam.noise instead.")
    ] = False,
    contours: Annotated[
        bool,
        typer.Option("--contours", help="Bounds of stops and pillars by TX, and what each TX lights, instead."),
    ] = False,
    json_file: JsonNumbers = None,
) -> None:
    """Draw the bounds of position and channel over the plan, and print those along the walk.

    Bounds are those of the scores: from the signal, the arrays and all paths of a stop together. The channel's
    figure, of delay and angles of the strongest path of a TX, is written beside: NAME_channel.png, of several TX
    NAME_channel_TX.png. With --contours a single figure shows stops and pillars. Half the --step takes four times
    as long; the time to expect is said after two stops.
    """
    from isac_arena.campaign.campaign import load_campaign  # noqa: PLC0415
    from isac_arena.campaign.files import write_bytes  # noqa: PLC0415
    from isac_arena.campaign.stages import console  # noqa: PLC0415
    from isac_arena.report.style import png_bytes  # noqa: PLC0415

    if out.suffix != ".png":
        raise ValueError(f"--out = {out}: must end in .png")
    if contours and (fixed or step_m is not None):
        raise ValueError("--contours: bounds stops and pillars from the signal; leave --fixed and --step out")
    loaded = load_campaign(campaign)
    figures, texts, numbers = _contours(loaded, out) if contours else _plan(loaded, out, step_m, fixed=fixed)
    for file, figure in figures.items():
        write_bytes(file, png_bytes(figure))
    for each in texts:
        console.print(each, soft_wrap=isinstance(each, str))
    console.print("figures: " + ", ".join(map(str, figures)))
    if json_file is not None:
        write_bytes(json_file, json.dumps({"campaign": loaded.config.name, **numbers}, indent=2).encode())


def _plan(loaded: "LoadedCampaign", out: Path, step_m: float | None, *, fixed: bool) -> Results:
    """Figures and tables of the position over the plan, and of the channel of every TX."""
    from dataclasses import replace  # noqa: PLC0415

    from isac_arena.campaign.stages import console  # noqa: PLC0415
    from isac_arena.insight.bounds import channel as channel_bound  # noqa: PLC0415
    from isac_arena.insight.bounds import position as bound_map  # noqa: PLC0415
    from isac_arena.insight.bounds import signal as signal_bound  # noqa: PLC0415
    from isac_arena.insight.bounds import tables as bound_tables  # noqa: PLC0415
    from isac_arena.progress import progress_bar, working  # noqa: PLC0415
    from isac_arena.report.figures.bound import FROM_SIGNAL, bound_figure, channel_bound_figure  # noqa: PLC0415
    from sim.transmitters import refuse_several_tx  # noqa: PLC0415

    if fixed:
        refuse_several_tx(loaded.config, loaded.scene, "arena bound --fixed")
    links = signal_bound.links_of_walk(loaded)
    inputs = [
        bound_map.bound_inputs(replace(loaded, config=link.config, scene=link.scene)) for link in links.values()
    ]
    grids = [bound_map.plan_grid(each, step_m, len(links)) for each in inputs]
    stops = None
    if not fixed:
        bounds = signal_bound.SignalBounds(loaded)
        with progress_bar(console, transient=True) as progress:
            each_stop = _timed(bounds.stops, grids[0])
            stops = signal_bound.along_walk(
                bounds, lambda _: progress.track(each_stop, len(bounds.stops), description="stops")
            )
    channels: dict[Path, Any] = {}
    texts: list[Any] = []
    with working(console, "paths and bounds of the channel"):
        for (link_name, link), prepared, grid in zip(links.items(), inputs, grids, strict=True):
            model = channel_bound.channel_model(prepared)
            name = "channel" if len(links) == 1 else f"channel_{link_name}"
            over_plan = channel_bound.over_plan(model, grid)
            channels[out.with_stem(f"{out.stem}_{name}")] = channel_bound_figure(prepared.scene, over_plan)
            texts.append(channel_bound.along_walk(model, link.chosen_stops))
            texts[-1].title = None if len(links) == 1 else link_name
    if stops is None:
        noise = loaded.config.slam.noise
        errors = f"for fixed errors of {noise.delay_std_ns:g} ns and {noise.angle_std_deg:g} deg of every path"
        found = bound_map.over_plan(inputs[0], grids[0])
        texts.append(bound_map.along_walk(inputs[0]))
        numbers = bound_tables.state_numbers((), None, found)
    else:
        with progress_bar(console, transient=True) as progress:
            errors = FROM_SIGNAL
            found = signal_bound.over_plan(bounds, grids, lambda rows: progress.track(rows, description="plan"))
        texts.append(bound_tables.state_table(stops, found))
        texts += bound_tables.about_unbounded(bounds.stops, stops, found)
        numbers = bound_tables.state_numbers(bounds.stops, stops, found)
    return {out: bound_figure(loaded.scene, found, errors), **channels}, texts, numbers


def _timed(stops: list[int], grid: "PlanGrid") -> Iterator[int]:
    """The stops; after two of them the time to expect for the plan is said: the first also compiles and loads."""
    from isac_arena.campaign.stages import console  # noqa: PLC0415
    from isac_arena.progress import duration  # noqa: PLC0415

    n_places, started = len(grid.position_m), time.monotonic()
    for number, stop in enumerate(stops):
        yield stop
        if number == min(1, len(stops) - 1):
            expected_s = n_places * (time.monotonic() - started) * (1 + CHANNEL_SHARE)
            about = f"{n_places} places over the plan, {grid.step_m:.2g} m apart"
            console.print(f"{about}: about {duration(expected_s)} (--step sets their distance)", soft_wrap=True)
        started = time.monotonic()


def _contours(loaded: "LoadedCampaign", out: Path) -> Results:
    """Figure and tables of the bounds of stops and pillars from every TX and from all."""
    from isac_arena.campaign.stages import console  # noqa: PLC0415
    from isac_arena.insight.bounds import tables as bound_tables  # noqa: PLC0415
    from isac_arena.insight.bounds.several_tx import SeveralTx  # noqa: PLC0415
    from isac_arena.insight.bounds.signal import LinkBounds, links_of_walk  # noqa: PLC0415
    from isac_arena.progress import progress_bar  # noqa: PLC0415
    from isac_arena.report.figures.several_tx import several_tx_figure  # noqa: PLC0415

    runs = list(links_of_walk(loaded).values())
    links, stops = [LinkBounds(run) for run in runs], list(runs[0].chosen_stops)
    if any(list(run.chosen_stops) != stops for run in runs):
        raise ValueError("links: with --contours all walks of the links must have the same stops")
    with progress_bar(console, transient=True) as progress:
        several = SeveralTx(
            links, stops, loaded.config.contours, lambda rows: progress.track(rows, description="TX")
        )
    bounds = bound_tables.by_tx(several)
    title = f"{loaded.scene.name}: expected errors of stops and outlines"
    figure = several_tx_figure(several, range(len(links)), list(bounds.values())[-1], title=title)
    tables = [bound_tables.pose_table(bounds), bound_tables.contour_table(several, bounds)]
    return {out: figure}, tables, {"from": bound_tables.as_numbers(several, bounds)}
