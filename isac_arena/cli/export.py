"""`arena export`: a campaign directory in the formats of other tools."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from isac_arena.cli.campaign import Directory


class ExportFormat(StrEnum):
    """What a campaign is written as."""

    mat = "mat"
    deepmimo = "deepmimo"
    tum = "tum"
    geojson = "geojson"
    glb = "glb"


def export(
    directory: Directory,
    file_format: Annotated[
        ExportFormat,
        typer.Option(
            "--format",
            help="mat: layout of the public measurement file; deepmimo: v4 scenario; tum: trajectories; "
            "geojson: contours; glb: scene with rays.",
        ),
    ],
    out: Annotated[Path | None, typer.Option(help="Folder to write to; DIRECTORY/export by default.")] = None,
    stop: Annotated[int, typer.Option(min=0, help="glb: the stop whose rays are drawn.")] = 0,
    max_paths: Annotated[
        int, typer.Option(min=1, help="deepmimo, glb: strongest paths of each stop that are kept.")
    ] = 25,
) -> None:
    """Write a campaign for MATLAB, DeepMIMO, trajectory tools, GIS tools or 3-D viewers."""
    from isac_arena.campaign import stages  # noqa: PLC0415
    from isac_arena.campaign.recording import recorded_additions  # noqa: PLC0415
    from isac_arena.exchange import formats as exchange  # noqa: PLC0415

    store = stages.reopen(directory, reads=stages.SCORED)
    folder = out or directory / "export"
    with recorded_additions(directory):
        if file_format == ExportFormat.deepmimo:
            files = [exchange.write_scenario(store, folder / store.config.name.lower(), max_paths)]
        elif file_format == ExportFormat.glb:
            files = [exchange.write_glb(store, folder / f"stop_{stop:03d}.glb", stop, max_paths)]
        else:
            write = {
                ExportFormat.mat: exchange.write_mat,
                ExportFormat.tum: exchange.write_tum,
                ExportFormat.geojson: exchange.write_geojson,
            }[file_format]
            files = list(write(store, folder))
    for file in files:
        stages.console.print(f"{file_format.value}: {file}")
