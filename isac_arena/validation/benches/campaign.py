"""A whole run on one core and on two, as ratios inside one bench: what stops side by side save, and its stages."""

import io
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from isac_arena.campaign import stages
from isac_arena.campaign.campaign import Campaign, load_campaign
from isac_arena.campaign.integrity import file_digest
from isac_arena.validation.measurement import InfoTable, Measured, at_least
from isac_arena.workers.stops import StopMakers

HEAVY_STOPS, HEAVY_PAIRS = 72, 2
QUICK_STOPS = 4
SPEED_UP = 1.7
QUICK_START_S = float("-inf")  # workers start, though so few stops do not gain by them
HEAVY = {"channel.method": "coherent"}  # a stop takes seconds
SMALL = {
    "waveform.n_rb": 132, "propagation.max_bounces": 1, "propagation.diffuse_samples": 0,
    "propagation.diffraction": False, "propagation.compare_planar": False,
}  # fmt: skip


def bench_two_workers(seed: int, quick: bool) -> Measured:
    """A campaign from the scene to the report in this process, then with two workers, with libraries loaded."""
    settings: dict[str, Any] = SMALL if quick else HEAVY
    campaign = box_campaign(seed, QUICK_STOPS if quick else HEAVY_STOPS, settings)
    start_s = QUICK_START_S if quick else None
    pairs, same = [], True
    with tempfile.TemporaryDirectory() as folder:
        timed_run(box_campaign(seed, QUICK_STOPS, settings), Path(folder, "warm"), StopMakers(1))
        for pair in range(1 if quick else HEAVY_PAIRS):
            outs = [Path(folder, f"{pair}_{workers}") for workers in (1, 2)]
            one, two = (
                timed_run(campaign, out, StopMakers(workers, start_s=start_s))
                for workers, out in enumerate(outs, start=1)
            )
            pairs.append((one, two))
            same &= contents(outs[0]) == contents(outs[1])
    seconds = [[sum(run.values()) for run in pair] for pair in pairs]
    ratios = [one_s / two_s for one_s, two_s in seconds]
    told = "; ".join(f"{one_s:.1f} s and {two_s:.1f} s" for one_s, two_s in seconds)
    reason = f"whole runs of {len(campaign.stops)} stops, start of the workers included: {told}"
    rows = [
        at_least("campaign.two_workers_speedup", np.median(ratios), 0.05 if quick else SPEED_UP, reason),
        at_least("campaign.same_bits", float(same), 1.0, "all files of both runs, manifests included"),
    ]
    return Measured(rows, (shares(*pairs[-1]),))


def box_campaign(seed: int, n_stops: int, settings: dict[str, Any]) -> Campaign:
    """The box room with a walk of so many stops, and some settings."""
    return load_campaign("box_room", seed=seed, **{**settings, "scene.walk.n_stops": n_stops})


def timed_run(campaign: Campaign, out: Path, makers: StopMakers) -> dict[str, float]:
    """Seconds of every stage of a run into a directory."""
    times_s: dict[str, float] = {}

    def timed(name: str, stage: Callable[[], object]) -> None:
        started = time.perf_counter()
        stage()
        times_s[name] = time.perf_counter() - started

    with redirect_stdout(io.StringIO()), stages.opened(campaign, out, None, None) as store:
        timed("plan", lambda: stages.run_plan(store))
        timed("trace, sweep, estimate", lambda: stages.sweep_and_estimate(store, makers, keep_sweeps=False))
        timed("mapping, SLAM, shapes", lambda: stages.build_maps(store))
        timed("scores", lambda: stages.write_scores(store))
        timed("report", lambda: stages.write_report(store))
    return times_s


def shares(one: dict[str, float], two: dict[str, float]) -> InfoTable:
    """Seconds of every stage, and its share of the run, on one core and on two."""
    totals_s = [sum(run.values()) for run in (one, two)]
    rows = tuple(
        (name, one[name], f"{one[name] / totals_s[0]:.0%}", two[name], f"{two[name] / totals_s[1]:.0%}")
        for name in one
    )
    return InfoTable("Stages of a run", ("stage", "one core in s", "share", "two cores in s", "share"), rows)


def contents(folder: Path) -> dict[str, str]:
    """The hash of every file below a folder, by name."""
    return {file.relative_to(folder).as_posix(): file_digest(file) for file in folder.rglob("*") if file.is_file()}
