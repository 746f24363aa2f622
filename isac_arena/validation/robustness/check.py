"""The rows of `arena validate robustness`: what was tried, and how it ended."""

import importlib
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console

from isac_arena.campaign.manifest import made_by
from isac_arena.validation.measurement import InfoTable, Measured, at_least, at_most
from isac_arena.validation.robustness.attempt import Trial
from isac_arena.validation.robustness.damage import damage_files, with_budget_and_sweep
from isac_arena.validation.robustness.inputs import try_files, try_settings
from isac_arena.validation.robustness.runs import bad_functions, finished_run, full_disks, killed_runs, two_at_once
from isac_arena.validation.robustness.sweeps import disturbed_sweeps, fatal_cases

REFUSED_MB = 500.0
WANTED_INPUTS = 5000
KILLS, DISKS, SWEEP_KILLS = 100, 20, 9
SHOWN = 30
LOCALES = 4


def check_inputs(seed: int, quick: bool, console: Console) -> Measured:
    """Hostile settings and damaged inputs: one line, soon, with little memory, and nothing outside the folder."""
    rng = random.Random(seed)
    counts = (160, 20) if quick else (None, None)
    with tempfile.TemporaryDirectory() as folder:
        box = Path(folder) / "box"
        console.print("hostile settings and damaged inputs ...")
        made = [*try_settings(box, rng, counts[0]), *try_files(box, rng, counts[1])]
    refused = [one for one in made if one.outcome == "refused"]
    peak_mb = max((one.peak_mb for one in refused), default=0.0)
    of = f"{len(refused)} refused in one line, {_count(made, 'accepted')} accepted"
    rows = [
        at_least("robustness.inputs.tried", len(made), 150 if quick else WANTED_INPUTS, of),
        at_most("robustness.inputs.internal_errors", _count(made, "internal"), 0, "defects of ours"),
        at_most("robustness.inputs.hangs", _count(made, "hang"), 0, "over 10 s of processor time"),
        at_most("robustness.inputs.outside", _count(made, "outside"), 0, "files beside the output folder"),
        at_most("robustness.inputs.refused_peak", peak_mb, REFUSED_MB, "it is asked before it is taken", "MB"),
    ]
    return Measured(rows, _bad(made))


def check_runs(seed: int, quick: bool, console: Console) -> Measured:
    """A finished run under damaged files, bad functions and full disks; and runs that are killed."""
    _import_all()
    rng = random.Random(seed)
    n_damages, n_functions, n_kills, n_disks = (6, 3, 2, 1) if quick else (None, None, KILLS, DISKS)
    with tempfile.TemporaryDirectory() as folder:
        made = finished_run(Path(folder) / "made" / "work", seed)
        console.print("damaged files of a run ...")
        damaged = list(damage_files(made.folder if quick else with_budget_and_sweep(made.folder), rng, n_damages))
        console.print("bad estimators ...")
        stayed = [stays for _, stays in bad_functions(made, n_functions)]
        console.print("kills, full disks, two commands at once ...")
        killed, full = list(killed_runs(made, rng, n_kills)), list(full_disks(made, rng, n_disks))
        both = quick or two_at_once(made)
        console.print("sweeps ...")
        swept = [] if quick else list(disturbed_sweeps(made.folder, rng, SWEEP_KILLS))
        fatal = [] if quick else fatal_cases(made.folder)
        told = _told_in_locales(made.folder, 1 if quick else LOCALES)
    good = sum(one.outcome in ("refused", "accepted") for one in damaged)
    of = f"{len(damaged)} files x damages x verbs: refused, or all other results are the same"
    rows = [
        at_least("robustness.damaged.explained", good / len(damaged), 1.0, of),
        at_least("robustness.estimators.same_bytes", _share(stayed), 1.0, f"{len(stayed)} bad functions"),
        at_least("robustness.kills.same_bytes", _share(killed), 1.0, f"{len(killed)} kills, then run again"),
        at_least("robustness.disks.same_bytes", _share(full), 1.0, f"{len(full)} disks, then run again"),
        at_least("robustness.two_commands.same_bytes", float(both), 1.0, "two runs in one directory"),
        at_least("robustness.locales.told", _share(told), 1.0, f"{len(told)} locales: one line, no traceback"),
    ]
    if not quick:
        of = f"{len(swept)}: two in one directory, a scheduler of another version, kills, then the same command"
        rows.append(
            at_least("robustness.sweeps.same_bytes", _share([one.outcome != "internal" for one in swept]), 1.0, of)
        )
        of = f"{len(fatal)} cases of a sweep: done, or listed"
        rows.append(at_least("robustness.fatal_cases.explained", _share(fatal), 1.0, of))
    return Measured(rows, _bad([*damaged, *swept]))


def _told_in_locales(folder: Path, count: int) -> list[bool]:
    """Whether a command tells its end in one line under each of some installed locales."""
    locale = shutil.which("locale")
    found = (
        [] if locale is None else subprocess.run([locale, "-a"], capture_output=True, check=False).stdout.split()
    )
    names = ["C", *(name.decode("ascii", "ignore") for name in found if name not in (b"C", b"POSIX"))]
    ended = []
    for name in names[:count]:
        done = subprocess.run(
            [sys.executable, "-m", "isac_arena", "score", "häuser"], cwd=folder, capture_output=True, check=False,
            env={**os.environ, "LC_ALL": name, "PYTHONPATH": str(Path(__file__).resolve().parents[3])},
        )  # fmt: skip
        ended.append(
            done.returncode == 2 and done.stderr.count(b"\n") == 1 and b"holds no campaign" in done.stderr
        )
    return ended


def _import_all() -> None:
    """Import once what every attempt needs: attempts are forks of this process."""
    for name in ("isac_arena.campaign.stages", "isac_arena.report.page.figures", "isac_arena.report.page.html"):
        importlib.import_module(name)
    made_by()  # reads all code once


def _bad(made: Iterable[Trial]) -> tuple[InfoTable, ...]:
    bad = [one for one in made if one.outcome not in ("refused", "accepted")]
    rows = tuple((one.what[:100], one.outcome, one.line[:200]) for one in bad[:SHOWN])
    return (
        (InfoTable("Attempts that did not end as they should", ("attempt", "outcome", "line"), rows),)
        if rows
        else ()
    )


def _count(made: Iterable[Trial], outcome: str) -> int:
    return sum(one.outcome == outcome for one in made)


def _share(held: list[bool]) -> float:
    return sum(held) / len(held) if held else 0.0
