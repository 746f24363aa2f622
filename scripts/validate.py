"""`arena validate NAME`: closed-form and Monte Carlo checks of a stage, each value beside its bar."""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from estimation.validation.measurement import Measurement

MODULES: Mapping[str, tuple[str, ...]] = {
    "signal": ("signal_waveform", "signal_generation"),
    "propagation": ("propagation_closed_form", "propagation_specular", "propagation_diffraction"),
    "slam": ("slam_measured", "slam"),
}
BENCHES: Mapping[str, tuple[str, ...]] = {
    "raytrace": ("bench_raytrace",),
    "signal": ("bench_signal",),
    "slam": ("bench_slam",),
}

Json = Annotated[Path | None, typer.Option("--json", help="Write the rows to this JSON file as well.")]
Quick = Annotated[bool, typer.Option("--quick", help="A subset that takes seconds.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the random cases.")]


def validate(
    name: Annotated[str, typer.Argument(help=f"One of: {', '.join(MODULES)}.")],
    quick: Quick = False,
    seed: Seed = 1,
    json_file: Json = None,
) -> None:
    """Measure a stage against closed forms, exact solutions and brute force; exit 1 where a bar is missed."""
    _measure(name, MODULES, "check_", quick, seed, json_file)


def bench(
    name: Annotated[str, typer.Argument(help=f"One of: {', '.join(BENCHES)}.")],
    quick: Quick = False,
    seed: Seed = 1,
    json_file: Json = None,
) -> None:
    """Time a stage, as ratios inside one run; exit 1 where a bar is missed."""
    _measure(name, BENCHES, "bench_", quick, seed, json_file)


def _measure(
    name: str,
    modules: Mapping[str, tuple[str, ...]],
    prefix: str,
    quick: bool,
    seed: int,
    json_file: Path | None,
) -> None:
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415

    from estimation.validation.measurement import to_json  # noqa: PLC0415
    from sim.store import write_text  # noqa: PLC0415

    if name not in modules:
        raise ValueError(f"name = '{name}': must be one of {', '.join(modules)}")
    console = Console(highlight=False)
    table = Table("key", "value", "bar", "unit", "met")
    for column in (1, 2):
        table.columns[column].justify = "right"
    table.columns[0].no_wrap = True
    rows: list[Measurement] = []
    for title, check in _checks(modules[name], prefix):
        started = time.perf_counter()
        with console.status(title):
            measured = check(seed, quick)
        _add_section(table, f"{title}, {time.perf_counter() - started:.1f} s", measured)
        rows += measured
    console.print(table)
    if json_file is not None:
        write_text(json_file, json.dumps(to_json(rows), indent=1) + "\n")
    missed = [row.key for row in rows if not row.met]
    console.print(f"{len(rows) - len(missed)} of {len(rows)} bars met")
    if missed:
        raise typer.Exit(1)


def _checks(
    modules: tuple[str, ...], prefix: str
) -> Iterator[tuple[str, Callable[[int, bool], list[Measurement]]]]:
    """The check functions of validation modules in the order they are written, with the title of each."""
    for module_name in modules:
        module = importlib.import_module(f"estimation.validation.{module_name}")
        for function_name, function in vars(module).items():
            if function_name.startswith(prefix) and getattr(function, "__module__", "") == module.__name__:
                yield function_name.removeprefix(prefix).replace("_", " "), function


def _add_section(table: Table, title: str, rows: list[Measurement]) -> None:
    table.add_row(f"[bold]{title}[/]")
    for row in rows:
        sign = "<=" if row.direction == "lower" else ">="
        met = "[green]yes[/]" if row.met else "[bold red]no[/]"
        table.add_row(row.key, f"{row.value:.4g}", f"{sign} {row.bar:g}", row.unit, met)
    table.add_section()
