"""`arena dataset`: a data set for learning from a specification."""

from pathlib import Path
from typing import Annotated

import typer

from isac_arena.cli.options import StopLimit, WorkerCount


def dataset(
    spec: Annotated[Path, typer.Argument(help="TOML file of the data set; docs/datasets.md.")],
    out: Annotated[Path, typer.Option(help="Directory of the data set; made where missing.")],
    workers: WorkerCount = None,
    stop_limit: StopLimit = None,
) -> None:
    """Make a data set: shards of simulated stops, splits by scene, datasheet and checksums; resumable."""
    from rich.console import Console  # noqa: PLC0415

    from isac_arena.datasets.config import DatasetConfig  # noqa: PLC0415
    from isac_arena.datasets.making import DatasetPlan, make_dataset  # noqa: PLC0415
    from isac_arena.progress import progress_bar  # noqa: PLC0415
    from scenes.toml_config import load_config  # noqa: PLC0415

    console = Console(highlight=False)
    config = load_config(spec, DatasetConfig)
    shards = DatasetPlan(config, out).shards
    with progress_bar(console) as progress:
        task = progress.add_task("shards", total=len(shards), completed=sum(shard.is_done for shard in shards))
        make_dataset(config, out, workers=workers, limit_s=stop_limit, tell=lambda _: progress.advance(task))
    n_stops = config.scenes.count * config.scenes.n_stops
    console.print(
        f"{n_stops} stops of {config.scenes.count} scenes in {len(shards)} shards: {out / 'DATASHEET.md'}"
    )
