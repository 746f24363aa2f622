"""`arena validate NAME`: closed-form and Monte Carlo checks of a stage, each value beside its bar."""

from __future__ import annotations

import importlib
import inspect
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated

import typer

from isac_arena.cli.options import Json, Quick, RandomSeed

if TYPE_CHECKING:
    from rich.table import Table

    from isac_arena.validation.measurement import InfoTable, Measured, Measurement

MODULES: Mapping[str, tuple[str, ...]] = {
    "signal": ("signal.waveform", "signal.generation"),
    "propagation": tuple(
        f"propagation.{name}" for name in ("closed_form", "specular", "diffraction", "mesh", "nist")
    ),
    "slam": ("slam.measured", "slam.snapshot", "slam.trajectory", "slam.laws"),
    "scoring": ("scoring.metrics", "scoring.bounds", "scoring.campaigns", "scoring.budget"),
    "channel": ("channel.efficiency", "channel.noise", "channel.hardware", "channel.arena"),
    "shape": tuple(f"shape.{name}" for name in ("gp", "points", "law", "reflection", "campaign", "measured")),
    "twin": ("twin",),
    "motion": (
        "motion.rates",
        "motion.samples",
        "motion.estimates",
        "motion.targets",
        "motion.nist",
        "motion.tracks",
        "motion.maps",
    ),
    "multistatic": tuple(
        f"multistatic.{name}" for name in ("samples", "stops", "links", "placement", "campaigns")
    ),
    "halls": ("halls.check",),
    "heights": ("heights",),
    "chain": ("chain.check", "chain.trials"),
    "robustness": ("robustness.check",),
    "exchange": tuple(f"exchange.{name}" for name in ("stages", "paths", "recordings")),
}
BENCHES: Mapping[str, tuple[str, ...]] = {
    "raytrace": ("benches.raytrace",),
    "signal": ("benches.signal", "benches.sionna"),
    "slam": ("benches.slam",),
    "channel": ("benches.channel", "benches.dense_room"),
    "shape": ("benches.shape",),
    "sweep": ("benches.sweep",),
    "endurance": ("benches.endurance",),
    "growth": ("benches.growth",),
    "campaign": ("benches.whole_run", "benches.campaign", "benches.start"),  # memory first: later ones fill it
    "motion": ("benches.motion",),
    "dataset": ("benches.dataset",),
}

INFO_WIDTH = 180  # columns of tables beside the rows: they are not broken on a narrow terminal

Trials = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Scenes of the longest Monte Carlo run; the others use a share of them. Rooms of halls and of chain,"
        " seeds of the campaign of multistatic.",
    ),
]
Estimator = Annotated[
    str | None, typer.Option(help="Check your own estimator in place of ours: package.module:function.")
]
Method = Annotated[
    str | None, typer.Option(help="halls, heights, chain: channel method: auto, coherent, incoherent or power.")
]
Out = Annotated[
    Path | None,
    typer.Option(
        help="halls, heights, chain, motion, multistatic: where an interrupted run goes on; by default out/NAME."
    ),
]
Processes = Annotated[
    int | None,
    typer.Option(min=1, help="halls, heights, chain, motion, multistatic: processes; by default one per core."),
]
Page = Annotated[
    Path | None, typer.Option(help="campaign: write what whole runs cost as a page, docs/performance.md.")
]


def validate(
    name: Annotated[str, typer.Argument(help=f"One of: {', '.join(MODULES)}.")],
    quick: Quick = False,
    seed: RandomSeed = 1,
    json_file: Json = None,
    trials: Trials = None,
    estimator: Estimator = None,
    method: Method = None,
    out: Out = None,
    workers: Processes = None,
) -> None:
    """Measure a stage against closed forms, exact solutions and brute force; exit 1 if a bar is missed."""
    options = {"trials": trials, "estimator": estimator, "method": method, "out": out, "workers": workers}
    given = {key: value for key, value in options.items() if value is not None}
    _measure(name, MODULES, "check_", quick, seed, json_file, given)


def bench(
    name: Annotated[str, typer.Argument(help=f"One of: {', '.join(BENCHES)}.")],
    quick: Quick = False,
    seed: RandomSeed = 1,
    json_file: Json = None,
    page: Page = None,
) -> None:
    """Time a stage, as ratios inside one run; exit 1 if a bar is missed."""
    _measure(name, BENCHES, "bench_", quick, seed, json_file, {} if page is None else {"page": page})


def _measure(
    name: str,
    modules: Mapping[str, tuple[str, ...]],
    prefix: str,
    quick: bool,
    seed: int,
    json_file: Path | None,
    options: Mapping[str, object] = MappingProxyType({}),
) -> None:
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    from isac_arena.campaign.files import write_json  # noqa: PLC0415
    from isac_arena.progress import working  # noqa: PLC0415
    from isac_arena.validation.measurement import Measured, to_json  # noqa: PLC0415

    if name not in modules:
        raise ValueError(f"name = '{name}': must be one of {', '.join(modules)}")
    console = Console(highlight=False)
    table = Table("key", "value", "bar", "unit", "met")
    table.columns[0].overflow = "fold"  # on a narrow terminal the keys break, not the numbers
    for index, column in enumerate(table.columns[1:]):
        column.justify, column.no_wrap = "right" if index < 2 else "left", True
    rows: list[Measurement] = []
    tables: list[InfoTable] = []
    checks = list(_checks(modules[name], prefix))
    for option in options:
        if not any(option in inspect.signature(check).parameters for _, check in checks):
            raise ValueError(f"--{option}: the checks of '{name}' have none; leave it out")
    for title, check in checks:
        started = time.perf_counter()
        accepted = {key: options[key] for key in options if key in inspect.signature(check).parameters}
        if "console" in inspect.signature(check).parameters:  # it shows its own progress
            found = check(seed, quick, console=console, **accepted)
        else:
            with working(console, title):
                found = check(seed, quick, **accepted)
        measured = found if isinstance(found, Measured) else Measured(found)
        _add_section(table, f"{title}, {time.perf_counter() - started:.1f} s", measured.rows)
        rows += measured.rows
        tables += measured.tables
    for one in tables:
        Console(highlight=False, width=max(console.width, INFO_WIDTH)).print(_info_table(one))
    console.print(table)
    if json_file is not None:
        write_json(json_file, to_json(rows, tables))
    missed = [row.key for row in rows if not row.met]
    console.print(f"{len(rows) - len(missed)} of {len(rows)} bars met")
    if missed:
        raise typer.Exit(1)


def _checks(
    modules: tuple[str, ...], prefix: str
) -> Iterator[tuple[str, Callable[..., list[Measurement] | Measured]]]:
    """The check functions of validation modules in the order they are written, with the title of each."""
    for module_name in modules:
        module = importlib.import_module(f"isac_arena.validation.{module_name}")
        for function_name, function in vars(module).items():
            if function_name.startswith(prefix) and getattr(function, "__module__", "") == module.__name__:
                yield function_name.removeprefix(prefix).replace("_", " "), function


def _add_section(table: Table, title: str, rows: list[Measurement]) -> None:
    table.add_row(f"[bold]{title}[/]")
    for row in rows:
        sign = "<=" if row.direction == "lower" else ">="
        met = "[green]yes[/]" if row.met else "[bold red]no[/]"
        table.add_row(row.key, f"{row.value:.4g}", f"{sign} {row.bar:.4g}", row.unit, met)
    table.add_section()


def _info_table(info: InfoTable) -> Table:
    from rich.box import SIMPLE_HEAD  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    table = Table(*info.columns, title=info.title, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    rows = [[f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in row] for row in info.rows]
    for index, column in enumerate(table.columns[:-1]):
        column.no_wrap = True
        column.min_width = max(len(row[index]) for row in [info.columns, *rows])
    for row in rows:
        table.add_row(*row)
    return table
