"""`arena golden`: small campaigns with stored scores, so that every change of a result is seen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from isac_arena.validation.golden import Deviation

FOLDER = Path(__file__).resolve().parents[2] / "tests" / "golden"  # of a checkout


def golden(
    remake: Annotated[
        bool, typer.Option("--remake", help="Run the campaigns and write their scores as the golden ones.")
    ] = False,
    folder: Annotated[Path, typer.Option(help="Folder of the golden files.")] = FOLDER,
) -> None:
    """Run small campaigns and compare their scores with stored ones; exit 1 if one deviates."""
    from rich.console import Console  # noqa: PLC0415

    from isac_arena.progress import working  # noqa: PLC0415
    from isac_arena.validation.golden import check_file, remake_file  # noqa: PLC0415

    console = Console(highlight=False)
    files = sorted(folder.glob("*.json"))
    if not files:
        hint = "; only a checkout of the project has them: name their folder" if folder == FOLDER else ""
        raise ValueError(f"--folder = {folder}: holds no golden file (*.json){hint}")
    deviations: list[Deviation] = []
    for file in files:
        with working(console, file.stem):
            if remake:
                remake_file(file)
                console.print(f"{file}: remade")
            else:
                deviations += check_file(file)
    if deviations:
        console.print(deviation_table(deviations))
        console.print(f"{len(deviations)} golden scores out of tolerance; if intended: arena golden --remake")
        raise typer.Exit(1)
    if not remake:
        console.print(f"{len(files)} golden campaigns: all scores within tolerance")


def deviation_table(deviations: Sequence[Deviation]) -> Table:
    """A row per golden score that is out of tolerance."""
    from rich.table import Table  # noqa: PLC0415

    table = Table("campaign", "score", "golden", "found", "tolerance")
    table.columns[1].overflow = "fold"
    for one in deviations:
        table.add_row(one.campaign, one.key, f"{one.golden:.5g}", f"{one.found:.5g}", f"{one.tolerance:.2g}")
    return table
