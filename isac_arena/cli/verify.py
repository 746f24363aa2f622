"""`arena verify`: are the files of a directory as they were written, and can the results be reproduced?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from isac_arena.cli.options import RandomSeed

if TYPE_CHECKING:
    from rich.console import Console

    from isac_arena.verification.compare import Finding


def verify(
    directory: Annotated[Path, typer.Argument(help="Directory of a campaign or of a sweep.")],
    share: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of the stops, or cases, computed again.")
    ] = 0.1,
    seed: RandomSeed = 1,
) -> None:
    """Check every file against the manifest and compute a share of the results again; exit 1 if one differs.

    With the same machine, code and libraries results must agree bit by bit, otherwise within a tolerance.
    """
    from rich.console import Console  # noqa: PLC0415

    from isac_arena.campaign.manifest import MANIFEST, check_files, made_by  # noqa: PLC0415
    from isac_arena.progress import working  # noqa: PLC0415
    from isac_arena.verification.campaign import recomputed_campaign  # noqa: PLC0415
    from isac_arena.verification.sweep import checked_tables, recomputed_cases  # noqa: PLC0415
    from isac_arena.workers.threads import one_thread  # noqa: PLC0415

    console = Console(highlight=False, soft_wrap=True)
    is_sweep = (directory / "sweep.json").is_file()
    if not is_sweep and not any((directory / name).is_file() for name in ("campaign.json", MANIFEST)):
        raise ValueError(f"{directory}: holds no campaign and no sweep; 'arena run' and 'arena sweep' make them")
    with working(console, "files"):
        checked = check_files(directory)
    for problem in checked.problems:
        console.print(f"  {problem}", markup=False)
    if checked.unknown:
        console.print(f"  not of the run: {', '.join(checked.unknown[:5])}", markup=False)
    n_good = checked.n_files - len(checked.problems)
    console.print(f"files: {n_good} of {checked.n_files} as they were written")
    with one_thread():  # as every run computes
        here = made_by()
        for origin in checked.made_by:
            print_origin(console, origin, here)
        findings: list[Finding] = list(checked_tables(directory)) if is_sweep else []
        if is_sweep or (directory / "campaign.json").is_file():
            with working(console, "computing again"):
                recomputed = recomputed_cases if is_sweep else recomputed_campaign
                findings += recomputed(directory, share, seed)
    exact = all(origin == here for origin in checked.made_by)
    for finding in findings:
        console.print(f"  {finding.line(exact)}", markup=False)
    bad = sum(not finding.holds(exact) for finding in findings)
    if findings:
        wanted = "bit by bit" if exact else "within the tolerance"
        console.print(f"computed again: {len(findings) - bad} of {len(findings)} agree {wanted}")
    if checked.problems or bad:
        raise typer.Exit(1)


def print_origin(console: Console, made: dict[str, object], here: dict[str, object]) -> None:
    """Print how code, libraries and machine of the run differ from those here."""
    differing = [name for name in here if made.get(name) != here[name]]
    if differing:
        shown = ", ".join(f"{name} {_shown(made.get(name), here[name])}" for name in differing)
        console.print(f"made elsewhere: {shown}", markup=False)


def _shown(made: object, here: object) -> str:
    if isinstance(made, dict) and isinstance(here, dict):
        pairs = [f"{key} {made.get(key)} (here {here[key]})" for key in here if made.get(key) != here[key]]
        return ", ".join(pairs)
    return f"{made} (here {here})"
