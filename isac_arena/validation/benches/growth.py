"""`arena bench growth`: how time, memory and files of a campaign grow with its stops.

The link is small and the walk of one room gets more stops: so a stop costs little, and what a stage does for all
stops at once shows. Each run has a process of its own, and makes a small campaign first: it imports and compiles.
"""

import multiprocessing
import tempfile
from dataclasses import dataclass
from pathlib import Path

from isac_arena.validation.benches.campaign import box_campaign
from isac_arena.validation.benches.dataset import CAMPAIGN
from isac_arena.validation.benches.run_cost import STAGES
from isac_arena.validation.benches.sweep import peak_memory_mb
from isac_arena.validation.benches.whole_run import run_stages
from isac_arena.validation.measurement import InfoTable, Measured, Measurement, at_most
from isac_arena.workers.threads import one_thread

TIMED_STOPS, MANY_STOPS = (300, 3000), 10_000
QUICK_STOPS, QUICK_MANY = (4, 12), 24
LINEAR, SAME_MEMORY, REPORT_MB = 1.15, 1.1, 10.0
LINK = {**CAMPAIGN, "channel.method": "power"}


@dataclass(frozen=True)
class Grown:
    """A run: processor time of its stages in s, peak memory of its process, its files, the size of its report."""

    stages_s: dict[str, float]
    peak_mb: float
    n_files: int
    report_mb: float


def bench_growth(seed: int, quick: bool) -> Measured:
    """Every stage from 300 to 3,000 stops, over linear; the size of the report of the longer run."""
    counts = QUICK_STOPS if quick else TIMED_STOPS
    short, long = (_apart(seed, count, True) for count in counts)
    times, bar = counts[1] / counts[0], 4.0 if quick else LINEAR  # a few stops tell little about times
    rows, table = [], []
    for stage, short_s in short.stages_s.items():
        long_s = long.stages_s[stage]
        reason = f"{STAGES[stage]}: {short_s:.2f} s at {counts[0]} stops, {long_s:.2f} s at {counts[1]}"
        rows.append(at_most(f"growth.{stage}", long_s / (short_s * times), bar, reason, "of linear"))
        table.append((STAGES[stage], short_s, long_s, 1e3 * long_s / counts[1]))
    rows.append(at_most("growth.report_size", long.report_mb, REPORT_MB, f"at {counts[1]} stops", "MB"))
    columns = ("stage", f"s at {counts[0]} stops", f"s at {counts[1]} stops", "ms per stop")
    return Measured(rows, (InfoTable("Processor time of every stage", columns, tuple(table)),))


def bench_growth_of_memory(seed: int, quick: bool) -> list[Measurement]:
    """Peak memory of generation and channel estimates, 10,000 stops over 300, and the number of files."""
    few, many = (QUICK_STOPS[0], QUICK_MANY) if quick else (TIMED_STOPS[0], MANY_STOPS)
    short, long = (_apart(seed, count, False) for count in (few, many))
    reason = f"{short.peak_mb:.0f} MB at {few} stops, {long.peak_mb:.0f} MB at {many}"
    per_file = f"{long.n_files} files of {many} stops"
    return [
        at_most("growth.memory", long.peak_mb / short.peak_mb, SAME_MEMORY, reason, "of the short run"),
        at_most("growth.files_per_stop", long.n_files / many, 3.0 if quick else 0.1, per_file),
    ]


def _apart(seed: int, n_stops: int, maps: bool) -> Grown:
    """A run in a process of its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_grown, (seed, n_stops, maps))


def _grown(seed: int, n_stops: int, maps: bool) -> Grown:
    with tempfile.TemporaryDirectory() as folder, one_thread():
        out = Path(folder, "run")
        run_stages(box_campaign(seed, QUICK_STOPS[0], LINK), maps=maps)
        stages_s = run_stages(box_campaign(seed, n_stops, LINK), out, maps=maps)
        report = out / "report.html"
        size_mb = 1e-6 * report.stat().st_size if report.is_file() else 0.0
        return Grown(stages_s, peak_memory_mb(), sum(file.is_file() for file in out.rglob("*")), size_mb)
