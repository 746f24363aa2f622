"""`arena import-mat` and `arena import-deepmimo`: campaigns made from measured data and DeepMIMO scenarios."""

from pathlib import Path
from typing import Annotated

import typer


def import_mat(
    file: Annotated[Path, typer.Argument(help="MATLAB file of the measured campaign, of 30 or 45 stops.")],
    out: Annotated[Path, typer.Option(help="Directory of the campaign; made where missing.")],
    tx_offset_deg: Annotated[
        float, typer.Option(min=-180, max=180, help="Mounting offset added to the TX heading of the file.")
    ] = -1.6,
    clock_seed: Annotated[
        int | None,
        typer.Option(min=0, help="Add a clock bias: 10 m, then a random walk of 1 m per stop; none by default."),
    ] = None,
    method: Annotated[str, typer.Option(help="SLAM: statistical, or reference as published.")] = "statistical",
    scene: Annotated[str, typer.Option(help="Scene to score against: name or TOML file.")] = "campus_arena",
) -> None:
    """Import the public measurement file; then estimate, score and report work on the directory."""
    from isac_arena.campaign import stages  # noqa: PLC0415
    from isac_arena.exchange import measurement  # noqa: PLC0415

    n_stops = measurement.import_campaign(
        file, out, tx_offset_deg=tx_offset_deg, clock_seed=clock_seed, method=method, scene=scene
    )
    stages.console.print(f"{n_stops} stops imported; next: arena estimate {out}")


def import_deepmimo(
    folder: Annotated[Path, typer.Argument(help="DeepMIMO v4 scenario folder.")],
    out: Annotated[Path, typer.Option(help="Folder for campaign.toml, scene.toml and what they name.")],
    stops: Annotated[
        int | None, typer.Option(min=1, help="Largest number of receivers, evenly over the set; all by default.")
    ] = None,
    tx_set: Annotated[int | None, typer.Option(help="TX set; the first by default.")] = None,
    tx: Annotated[int, typer.Option(min=0, help="TX within its set.")] = 0,
    rx_set: Annotated[int | None, typer.Option(help="RX set; the first by default.")] = None,
) -> None:
    """Make a campaign whose paths are those of a scenario; 'arena run' then sweeps beams over them."""
    from isac_arena.exchange.deepmimo import import_scenario  # noqa: PLC0415

    done = import_scenario(folder, out, n_stops=stops, tx_set=tx_set, tx=tx, rx_set=rx_set)
    typer.echo(
        f"{done.n_stops} of {done.n_receivers} receivers, {done.n_meshes} of {done.n_objects} objects; "
        f"next: arena run {out / 'campaign.toml'} --out DIR"
    )
