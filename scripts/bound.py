"""`arena bound`: how well a receiver could be located, over the plan of a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def bound(
    campaign: Annotated[str, typer.Argument(help="Campaign name of the library, or path of a TOML file.")],
    out: Annotated[Path, typer.Option(help="PNG file to write.")],
    step_m: Annotated[float, typer.Option("--step", min=0.05, max=5.0, help="Grid step in m.")] = 0.5,
) -> None:
    """Draw the position error bound over the plan, and print the bounds along the walk."""
    from estimation.report.bound_figure import bound_figure  # noqa: PLC0415
    from estimation.report.style import png_bytes  # noqa: PLC0415
    from scripts import bound_map  # noqa: PLC0415
    from scripts.stages import console  # noqa: PLC0415
    from sim.store import complete_file  # noqa: PLC0415

    if out.suffix != ".png":
        raise ValueError(f"--out = {out}: must end in .png")
    prepared = bound_map.prepare(campaign)
    with console.status("paths and bounds"):
        figure = bound_figure(prepared.scene, bound_map.over_plan(prepared, step_m))
        table = bound_map.along_walk(prepared)
    with complete_file(out) as partial:
        partial.write_bytes(png_bytes(figure))
    console.print(table)
    console.print(f"figure: {out}")
