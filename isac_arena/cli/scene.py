"""`arena scene`: list the scenes of the library, draw them with their paths, and export their meshes."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from isac_arena.cli.options import with_clock, with_memory

if TYPE_CHECKING:
    from scenes.scene import Scene
    from sim.propagation.paths import Paths

CARRIER_HZ = 60e9

app = typer.Typer(help="The scenes of the library and your own.", no_args_is_help=True)

SceneName = Annotated[str, typer.Argument(help="Library name, or path of a scene TOML file.")]


class View(StrEnum):
    """How a scene is drawn."""

    plan = "plan"
    space = "3d"


class MeshFormat(StrEnum):
    """How a scene is exported."""

    glb = "glb"
    ply = "ply"
    xml = "xml"


@app.command("list")
def list_scenes() -> None:
    """List the scenes of the library."""
    from scenes.config import library_scenes  # noqa: PLC0415

    for name in library_scenes():
        typer.echo(name)


@app.command("show")
@with_memory
@with_clock
def show(
    name: SceneName,
    out: Annotated[
        Path | None, typer.Option(help="PNG file to write; by default my_hall.png of my_hall.toml.")
    ] = None,
    everything: Annotated[bool, typer.Option("--all/--walk-only", help="Whole scene, or near the walk.")] = True,
    view: Annotated[View, typer.Option(help="Plan from above, or a picture in space.")] = View.plan,
    stop: Annotated[
        int | None, typer.Option("--paths", metavar="STOP", help="Draw the paths to this RX stop, from 0.")
    ] = None,
    tx: Annotated[str | None, typer.Option(help="TX to use where the scene has several.")] = None,
    walk: Annotated[str | None, typer.Option(help="Walk to use where the scene has several.")] = None,
) -> None:
    """Draw a scene: its objects, the TX, the walk, and the paths to a stop; list them, and what is doubtful."""
    from isac_arena.campaign import stages  # noqa: PLC0415
    from isac_arena.campaign.files import write_bytes  # noqa: PLC0415
    from isac_arena.campaign.plan import scene_doubts, sight_doubts  # noqa: PLC0415
    from isac_arena.campaign.summary import scene_summary, scene_table  # noqa: PLC0415
    from isac_arena.report.figures.plan import plan_figure  # noqa: PLC0415
    from isac_arena.report.figures.scene3d import scene_figure  # noqa: PLC0415
    from isac_arena.report.style import png_bytes  # noqa: PLC0415
    from scenes.config import load_scene, scene_path  # noqa: PLC0415
    from scenes.names import path_in  # noqa: PLC0415

    scene = load_scene(name, CARRIER_HZ).choose(tx or 0, walk or 0)
    paths = None if stop is None else _paths(scene, stop)
    path = out or path_in(Path(), f"{scene_path(name).stem}.png")
    draw = plan_figure if view == View.plan else scene_figure
    figure = draw(scene, extent="all" if everything else "walk", paths=paths, stop=stop)
    write_bytes(path, png_bytes(figure))
    typer.echo(f"{scene.name}: {scene_summary(scene)}, {len(scene.stops)} stops; {view.value} in {path}")
    stages.console.print(scene_table(scene))
    stages.print_scene_notices(scene.notices, [*sight_doubts(scene, CARRIER_HZ), *scene_doubts(scene)])


@app.command("export")
@with_memory
@with_clock
def export(
    name: SceneName,
    mesh_format: Annotated[MeshFormat, typer.Option("--format", help="glTF, PLY, or Mitsuba XML.")],
    out: Annotated[
        Path | None,
        typer.Option(
            help="File to write, by default my_hall.glb of my_hall.toml; for xml the folder of the XML file and "
            "its meshes."
        ),
    ] = None,
) -> None:
    """Export a scene as triangle meshes: one GLB or PLY file, or a Mitsuba XML file that Sionna RT loads."""
    from isac_arena.campaign.files import write_bytes  # noqa: PLC0415
    from isac_arena.campaign.summary import scene_summary  # noqa: PLC0415
    from scenes.config import load_scene, scene_path  # noqa: PLC0415
    from scenes.meshes.mesh import glb_bytes, ply_bytes, write_mitsuba  # noqa: PLC0415
    from scenes.names import path_in  # noqa: PLC0415

    scene, stem = load_scene(name, CARRIER_HZ), scene_path(name).stem
    if mesh_format == MeshFormat.xml:
        path = write_mitsuba(scene, out or path_in(Path(), stem))
    else:
        path = out or path_in(Path(), f"{stem}.{mesh_format.value}")
        if path.is_dir():
            path = path_in(path, f"{stem}.{mesh_format.value}")
        make = glb_bytes if mesh_format == MeshFormat.glb else ply_bytes
        write_bytes(path, make(scene))
    typer.echo(f"{scene.name}: {scene_summary(scene)} in {path}")


def _paths(scene: Scene, stop: int) -> Paths:
    """Paths from the TX to one stop; `ValueError` where the walk has no such stop."""
    from sim.propagation.propagator import Propagator  # noqa: PLC0415

    if not 0 <= stop < len(scene.stops):
        raise ValueError(f"paths = {stop}: the walk has stops 0 to {len(scene.stops) - 1}")
    return Propagator(scene, CARRIER_HZ).paths(scene.stops[stop].position_m)
