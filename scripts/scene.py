"""`arena scene`: list the scenes of the library and draw their plans."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(help="The scenes of the library and your own.", no_args_is_help=True)


@app.command("list")
def list_scenes() -> None:
    """List the scenes of the library."""
    from scenes.config import library_scenes  # noqa: PLC0415

    for name in library_scenes():
        typer.echo(name)


@app.command("show")
def show(
    name: Annotated[str, typer.Argument(help="Library name, or path of a scene TOML file.")],
    out: Annotated[Path | None, typer.Option(help="PNG file to write; NAME.png by default.")] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="The whole scene, not only around the walk.")
    ] = False,
) -> None:
    """Draw the plan of a scene."""
    from estimation.report.plan import plan_figure  # noqa: PLC0415
    from estimation.report.style import png_bytes  # noqa: PLC0415
    from scenes.config import load_scene  # noqa: PLC0415
    from sim.store import complete_file  # noqa: PLC0415

    scene = load_scene(name)
    path = out or Path(f"{scene.name}.png")
    with complete_file(path) as partial:
        partial.write_bytes(png_bytes(plan_figure(scene, extent="all" if everything else "walk")))
    typer.echo(f"{scene.name}: {len(scene.objects)} objects, {len(scene.stops)} stops; plan in {path}")
