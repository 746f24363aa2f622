"""A whole run on one core and on two, its stages, and the map stage over FFT passes: ratios inside one bench."""

import io
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.fft

from estimation.execution import one_blas_thread
from isac_arena.campaign import stages
from isac_arena.campaign.campaign import Campaign, load_campaign
from isac_arena.campaign.integrity import file_digest
from isac_arena.campaign.results import MemoryResults
from isac_arena.validation.benches.timing import paired_ratios
from isac_arena.validation.measurement import InfoTable, Measured, Measurement, at_least, at_most
from isac_arena.workers.stops import StopMakers

HEAVY_STOPS, HEAVY_PAIRS = 72, 2
QUICK_STOPS = 4
SPEED_UP = 1.7
MAP_PASSES, MAP_PAIRS = 3.0, 3  # FFT passes that the map stage of a stop may take; pairs of times
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


def bench_map_stage(seed: int, quick: bool) -> list[Measurement]:
    """Mapping, SLAM and both contour stages of the campus arena, per stop, over one FFT pass over a stop's sweep.

    Processor times, in turns; channel estimates by the settings of the campaign. The pass is over the subcarriers.
    """
    run = (box_campaign(seed, QUICK_STOPS, SMALL) if quick else load_campaign("campus_arena", seed=seed)).chain()
    truths = list(run.truths())
    channel, receiver = list(run.channel(truths)), run.surveyed_receiver(truths)
    samples, n_stops = run.sweep(truths[0]).samples, len(truths)

    def passes() -> None:
        for _ in range(n_stops):
            scipy.fft.fft(samples, axis=-1)

    def maps() -> None:
        replace(run, results=MemoryResults()).maps(channel, receiver)

    with one_blas_thread():
        ratios, times_s = paired_ratios(maps, passes, 1 if quick else MAP_PAIRS)
    maps_ms, pass_ms = 1e3 * np.median(times_s, axis=0) / n_stops
    n_paths = np.mean([len(estimate) for estimate in channel])
    about = f"{n_stops} stops of {n_paths:.0f} paths: {maps_ms:.0f} ms a stop over {pass_ms:.0f} ms"
    spread = f"; from {ratios.min():.2f} to {ratios.max():.2f}"
    return [at_most("campaign.map_stage", np.median(ratios), MAP_PASSES, about + spread, "FFT passes")]


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

    with redirect_stdout(io.StringIO()), stages.opened(campaign, out, None) as store, makers:
        timed("plan", lambda: stages.run_plan(store))
        timed("trace, sweep, estimate", lambda: stages.sweep_and_estimate(store, makers, keep_sweeps=False))
        timed("mapping, SLAM, shapes", lambda: stages.build_maps(store, makers))
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
