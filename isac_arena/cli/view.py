"""`arena view`: a campaign in three dimensions, in the browser."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from isac_arena.cli.options import Directory, with_clock

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


@with_clock
def view(
    directory: Directory,
    stop: Annotated[
        int | None, typer.Option(min=0, help="RX stop whose paths are shown at first; by default the first.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="HTML file; DIRECTORY/view.html by default.")] = None,
    show: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the browser.")] = True,
) -> None:
    """Show the hall with its paths and the estimated contours in 3-D: one HTML file, about 5 MB."""
    import webbrowser  # noqa: PLC0415

    from isac_arena.campaign import stages, stored  # noqa: PLC0415
    from isac_arena.campaign.files import write_text  # noqa: PLC0415
    from isac_arena.campaign.recording import recorded_additions  # noqa: PLC0415
    from isac_arena.report.figures.path_lines import PathLine, path_lines  # noqa: PLC0415
    from isac_arena.report.view.page import view_page  # noqa: PLC0415
    from sim.links import link_nodes  # noqa: PLC0415

    store = stages.reopen(directory)
    scene = store.scene
    results = stored.stored_results(store, len(scene.stops))
    nodes = {name: scene.txs[node] for name, node in link_nodes(store.config, scene).items()}
    lines: list[list[PathLine]] = [[] for _ in scene.stops]
    for truth in () if store.measured is not None else stored.stored_truths(store, len(scene.stops)):
        tx = truth.tx_pose or list(nodes.values())[truth.tx]
        lines[truth.stop] += path_lines(truth.paths, tx.position_m, truth.rx_pose.position_m)
    path = out or directory / "view.html"
    page = view_page(store.config.name, scene, results, lines, stop or 0, nodes)
    with recorded_additions(directory):
        write_text(path, page)
    typer.echo(f"3-D view: {path}")
    if show and _has_display():
        webbrowser.open(path.resolve().as_uri())


def _has_display() -> bool:
    """Whether a browser would open a window: without a display Linux would start one in the terminal."""
    return not sys.platform.startswith("linux") or any(os.environ.get(name) for name in DISPLAYS)
