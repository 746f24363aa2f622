"""`arena study NAME`: the paper's synthetic studies, as figures and a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from isac_arena.cli.options import OutFolder, RandomSeed

if TYPE_CHECKING:
    from rich.table import Table

    from isac_arena.validation.shape.gp_study import StudyCell

app = typer.Typer(no_args_is_help=True, help="Studies on synthetic data, as figures and a table.")


@app.callback()
def studies() -> None:
    """Studies on synthetic data, as figures and a table."""


@app.command("gp-synthetic")
def gp_synthetic(
    out: OutFolder,
    runs: Annotated[int, typer.Option(min=1, help="Runs per shape, mode and number of points.")] = 1000,
    seed: RandomSeed = 1,
) -> None:
    """Radial Gaussian process on basic shapes (Fig. 1 of the paper): example, and RMSE against the points."""
    from rich.console import Console  # noqa: PLC0415

    from isac_arena.campaign.files import write_bytes, write_csv  # noqa: PLC0415
    from isac_arena.progress import tracked  # noqa: PLC0415
    from isac_arena.report.figures.gp_study import contour_figure, radial_function_figure, rmse_figure  # noqa: PLC0415
    from isac_arena.report.style import png_bytes  # noqa: PLC0415
    from isac_arena.validation.shape.gp_study import MODES, N_POINTS, SHAPES, example, study  # noqa: PLC0415

    console = Console(highlight=False)
    n_cells = len(MODES) * len(SHAPES) * len(N_POINTS)
    cells = list(tracked(console, study(runs, seed), n_cells, "fits"))
    shown = example(seed, "data-driven")
    figures = {"radial_function": radial_function_figure(shown), "contour": contour_figure(shown)}
    for name, figure in {**figures, "rmse": rmse_figure(cells)}.items():
        write_bytes(out / f"{name}.png", png_bytes(figure))
    write_csv(out / "rmse.csv", [asdict(cell) for cell in cells])
    console.print(rmse_table(cells))
    console.print(f"study: {out / 'rmse.csv'}, rmse.png, radial_function.png and contour.png")


def rmse_table(cells: Sequence[StudyCell]) -> Table:
    """RMSE in m, one row per mode and shape, one column per number of points."""
    from rich.table import Table  # noqa: PLC0415

    n_points = list(dict.fromkeys(cell.n_points for cell in cells))
    table = Table("mode", "shape", *[f"M = {n}" for n in n_points], title="RMSE in m at the training angles")
    by_row: dict[tuple[str, str], list[str]] = {}
    for cell in cells:
        by_row.setdefault((cell.mode, cell.shape), []).append(f"{cell.rmse_m:.3f}")
    for (mode, shape), values in by_row.items():
        table.add_row(mode, shape, *values)
    return table
