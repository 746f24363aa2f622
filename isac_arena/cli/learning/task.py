"""`arena task make`, `grade` and `baselines`: public tasks with sealed truth."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from isac_arena.public_tasks.board import BoardRow

app = typer.Typer(
    no_args_is_help=True, help="Tasks for all: observations to estimate from, the truth kept back, a leaderboard."
)
Task = Annotated[Path, typer.Argument(help="Directory of the task.")]


class TierName(StrEnum):
    """Rooms of a task."""

    pillar = "pillar"
    halls = "halls"
    people = "people"


class StageName(StrEnum):
    """Stage of a task."""

    channel = "channel"
    slam = "slam"
    contours = "contours"


@app.command("make")
def make(
    out: Annotated[Path, typer.Option(help="Directory of the task; made where missing.")],
    tier: Annotated[TierName, typer.Option(help="pillar: one in a room; halls; people: halls with people.")],
    stage: Annotated[StageName, typer.Option(help="What is asked for: channel, slam or contours.")],
    scenes: Annotated[int, typer.Option(min=1, max=1000, help="Scenes.")] = 5,
    stops: Annotated[int, typer.Option(min=1, max=1000, help="Stops of each.")] = 10,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed to keep secret; by default drawn.")] = None,
) -> None:
    """Simulate the scenes of a task: observations in public/, the truth in seal.tar."""
    from rich.console import Console  # noqa: PLC0415

    from isac_arena.progress import progress_bar  # noqa: PLC0415
    from isac_arena.public_tasks.making import SEAL, TaskSpec, make_task  # noqa: PLC0415

    console = Console(highlight=False)
    secret = secrets.randbits(64) if seed is None else seed  # who knows it can make the truth again
    spec = TaskSpec(f"{stage.value} in {tier.value}", tier.value, stage.value, scenes, stops, secret)
    with progress_bar(console) as progress:
        bar = progress.add_task("scenes", total=scenes)
        make_task(spec, out, lambda _: progress.advance(bar))
    console.print(f"publish {out / 'public'}, keep {out / SEAL}; next: arena task baselines {out}", soft_wrap=True)


@app.command("grade")
def grade(
    submission: Annotated[Path, typer.Argument(help="Table: .csv, .parquet, .mat, .nc or .npz.")],
    task: Annotated[Path, typer.Option(help="Directory of the task, with its seal.")],
    name: Annotated[str | None, typer.Option(help="Name on the leaderboard; by default that of the file.")] = None,
) -> None:
    """Grade a submission against the truth that was kept back and enter it in the leaderboard."""
    from isac_arena.campaign.integrity import file_digest  # noqa: PLC0415
    from isac_arena.public_tasks import grading  # noqa: PLC0415
    from isac_arena.public_tasks.board import BoardRow  # noqa: PLC0415
    from isac_arena.public_tasks.making import read_task  # noqa: PLC0415
    from isac_arena.public_tasks.submissions import read_submission  # noqa: PLC0415

    about, scenes = read_task(task)
    rows = read_submission(submission, about["stage"], about["n_scenes"], about["n_stops"])
    found = grading.grade(about["stage"], scenes, rows)
    _enter(task, about, [BoardRow.of(name or submission.stem, "submission", found, file_digest(submission))])


@app.command("baselines")
def baselines(task: Task) -> None:
    """Run the methods of the project on a task and enter them and the bound in the leaderboard."""
    from rich.console import Console  # noqa: PLC0415

    from isac_arena.progress import progress_bar  # noqa: PLC0415
    from isac_arena.public_tasks import baselines as methods  # noqa: PLC0415
    from isac_arena.public_tasks.board import BoardRow  # noqa: PLC0415
    from isac_arena.public_tasks.grading import grade as graded  # noqa: PLC0415
    from isac_arena.public_tasks.making import read_task  # noqa: PLC0415
    from isac_arena.public_tasks.submissions import submission_of  # noqa: PLC0415

    about, scenes = read_task(task)
    stage, rows = about["stage"], []
    with progress_bar(Console(highlight=False)) as progress:
        for method in progress.track(methods.BASELINES[stage], description="methods"):
            table = methods.baseline_rows(stage, scenes, method)
            read = submission_of(table, stage, about["n_scenes"], about["n_stops"], method.name)
            rows.append(BoardRow.of(method.name, "baseline", graded(stage, scenes, read)))
    limit = methods.bound(stage, scenes)
    if limit is not None:
        rows.append(BoardRow.of("Cramer-Rao bound", "bound", limit))
    _enter(task, about, rows)


def _enter(task: Path, about: dict[str, Any], rows: Sequence[BoardRow]) -> None:
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    from isac_arena.public_tasks.board import PAGE, enter, plain  # noqa: PLC0415

    table = Table("method", "kind", "mean", "95 % interval", title=str(about["name"]))
    for row in enter(task, about, rows):
        table.add_row(row.name, row.kind, plain(row.mean), row.interval)
    console = Console(highlight=False)
    console.print(table)
    console.print(f"leaderboard: {task / PAGE}", soft_wrap=True)
