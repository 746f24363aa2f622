"""`arena import-deepmimo`: the paths of a DeepMIMO v4 scenario as a campaign of ours."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def import_deepmimo(
    folder: Annotated[Path, typer.Argument(help="DeepMIMO v4 scenario folder.")],
    out: Annotated[Path, typer.Option(help="Folder for campaign.toml, scene.toml and what they name.")],
    stops: Annotated[
        int | None,
        typer.Option(min=1, help="At most so many receivers, evenly over the set; all of them by default."),
    ] = None,
    tx_set: Annotated[int | None, typer.Option(help="TX set; the first by default.")] = None,
    tx: Annotated[int, typer.Option(min=0, help="TX within its set.")] = 0,
    rx_set: Annotated[int | None, typer.Option(help="RX set; the first by default.")] = None,
) -> None:
    """Make a campaign whose paths are those of a scenario; 'arena run' then sweeps beams over them."""
    from isac_arena.exchange.deepmimo_import import import_scenario  # noqa: PLC0415

    done = import_scenario(folder, out, n_stops=stops, tx_set=tx_set, tx=tx, rx_set=rx_set)
    typer.echo(
        f"{done.n_stops} of {done.n_receivers} receivers, {done.n_meshes} of {done.n_objects} objects; "
        f"next: arena run {out / 'campaign.toml'} --out DIR"
    )
