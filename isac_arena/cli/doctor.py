"""`arena doctor`: whether this machine can run the chain, and what to do about each problem."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from isac_arena.doctor import Check


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Check this machine: Python, packages, LLVM, Sionna, kernels, memory, disk. Ends with 1 if anything fails."""
    from rich.console import Console  # noqa: PLC0415

    from isac_arena.doctor import doctor_report  # noqa: PLC0415
    from isac_arena.progress import working  # noqa: PLC0415

    with working(Console(stderr=True, highlight=False), "doctor"):  # the standard output may be JSON
        checks = doctor_report()
    if as_json:
        typer.echo(json.dumps([asdict(check) for check in checks], indent=2))
    else:
        _print_table(checks)
    if any(check.status == "fail" for check in checks):
        raise typer.Exit(1)


def _print_table(checks: list[Check]) -> None:
    from rich.console import Console  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    styles = {"ok": "green", "warn": "yellow", "fail": "bold red"}
    console = Console()
    table = Table("check", "status", "found")
    for check in checks:
        table.add_row(check.name, Text(check.status, style=styles[check.status]), Text(check.detail))
    console.print(table)
    for check in checks:
        if check.status != "ok" and check.remedy:
            console.print(Text(f"{check.name}: {check.remedy}"), soft_wrap=True)
