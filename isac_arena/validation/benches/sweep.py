"""Cost of the sweep engine, as ratios inside one run: of two workers to one, of the engine to a plain loop."""

import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console

from isac_arena.sweep.config import AxisConfig, SweepConfig
from isac_arena.sweep.engine import run_jobs
from isac_arena.sweep.job import Job, store_scene
from isac_arena.sweep.plan import make_plan
from isac_arena.sweep.run import case_run, make_signals, run_cases, trace_stops
from isac_arena.sweep.runner import run_sweep
from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.workers.workers import Workers

COMMON = """
name = "bench"
scene = "box_room"
seed = {seed}
propagation = {{max_bounces = 1, diffuse_samples = 0, diffraction = false, compare_planar = false}}
channel.method = "power"
"""
SMALL = COMMON + "waveform.n_rb = 132\ntx_array.rows = 1\n"
SMALL += "rx_array = {{rows = 1, panel_azimuth_deg = [0.0], beams_per_panel = 32, sector_deg = 140.0}}\n"
FULL = COMMON + "waveform.combine_symbols = true\n"
POWER = "link.tx_power_dbm"
RANGE = "channel.power.dynamic_range_db"
WARM_SEED = 900_000  # of the case that loads and compiles, not one of those that are timed


def bench_workers(seed: int, quick: bool) -> list[Measurement]:
    """Small cases in a plain loop, on one worker and on two, all with libraries loaded and code compiled."""
    n_cases, repeats = (4, 1) if quick else (64, 2)
    with tempfile.TemporaryDirectory() as folder:
        sweep = sweep_of(POWER, [0.0, 20.0], n_cases // 2)
        loop_s = _best(repeats, lambda k: _time_loop(make_jobs(Path(folder, f"loop{k}"), sweep, seed)))
        one_s = _best(repeats, lambda k: _time_engine(make_jobs(Path(folder, f"one{k}"), sweep, seed), 1))
        two_s = _best(repeats, lambda k: _time_engine(make_jobs(Path(folder, f"two{k}"), sweep, seed), 2))
    reason = f"{n_cases} cases: {loop_s:.1f} s in a loop, {one_s:.1f} s on one worker, {two_s:.1f} s on two"
    overhead = "one worker beside a plain loop over the same cases; start and end weigh more with few cases"
    return [
        at_least("sweep.two_workers.speed_up", one_s / two_s, 1.0 if quick else 1.8, reason),
        at_most("sweep.engine.overhead", one_s / loop_s - 1, 0.5 if quick else 0.05, overhead),
    ]


def bench_cached(seed: int, quick: bool) -> list[Measurement]:
    """A sweep run twice in the same directory, workers started where they are needed."""
    n_cases, n_workers = (4, 1) if quick else (64, None)
    with tempfile.TemporaryDirectory() as folder:
        sweep = sweep_of(POWER, [0.0, 20.0], n_cases // 2)
        first_s, second_s = (_time_sweep(Path(folder), sweep, seed, n_workers) for _ in range(2))
    reason = f"{first_s:.1f} s, then {second_s:.2f} s"
    bar = 0.2 if quick else 0.02  # the first run of a few cases is short
    return [at_most("sweep.cached.second_run", second_s / first_s, bar, reason, "of the first")]


def bench_estimators(seed: int, quick: bool) -> list[Measurement]:
    """Eight settings of the channel estimator on one campaign that is traced and generated."""
    with tempfile.TemporaryDirectory() as folder:
        settings = [12.0 + 2.0 * step for step in range(2 if quick else 8)]
        sweep = sweep_of(RANGE, settings, 1).model_copy(update={"stop_every": 2 if quick else 1})
        jobs = make_jobs(Path(folder, "sweep"), sweep, seed, FULL)
        _run([_warm(jobs, FULL)])
        trace_stops(jobs[0], jobs[0].stops)
        make_signals(jobs[0], jobs[0].stops)
        alone_s = sum(_time_estimation(job) for job in jobs)
        sweep_s = _time_engine(jobs, 1, FULL)
    reason = f"{sweep_s:.1f} s beside {alone_s:.1f} s for {len(jobs)} settings, with scores and files"
    bar = 2.0 if quick else 1.3
    return [at_most("sweep.estimators.cost", sweep_s / alone_s, bar, reason, "of estimation")]


def bench_memory(seed: int, quick: bool) -> list[Measurement]:
    """Largest resident memory of one worker after a quarter of many cases and after all of them."""
    n_cases = 8 if quick else 200
    with tempfile.TemporaryDirectory() as folder, Workers(1, None) as one:
        jobs = make_jobs(Path(folder), sweep_of(POWER, [0.0, 20.0], n_cases // 2), seed)
        peaks_mb = []
        for part in (jobs[: n_cases // 4], jobs[n_cases // 4 :]):
            run_jobs(one.client, part, _raise)
            peaks_mb += [max(one.client.run(peak_memory_mb).values())]
    reason = f"{peaks_mb[0]:.0f} MB after {n_cases // 4} cases, {peaks_mb[1]:.0f} MB after {n_cases}"
    bar = 1.1 if quick else 1.05
    return [at_most("sweep.worker.memory", peaks_mb[1] / peaks_mb[0], bar, reason, "of the first quarter")]


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def sweep_of(field: str, values: Sequence[float], repeats: int) -> SweepConfig:
    """A sweep of one field, with repeats."""
    return SweepConfig(
        name="bench", base="base.toml", repeats=repeats, axes=[AxisConfig(field=field, values=list(values))]
    )


def make_jobs(folder: Path, config: SweepConfig, seed: int, base: str = SMALL) -> list[Job]:
    """The cases of a sweep in a directory of its own, with their scene stored."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "base.toml").write_text(base.format(seed=seed), encoding="utf-8")
    plan = make_plan(str(folder / "sweep.toml"), config, folder / "out", range(config.repeats))
    for scene in plan.scenes.values():
        store_scene(folder / "out", scene)
    return plan.jobs


def _warm(jobs: Sequence[Job], base: str = SMALL) -> Job:
    """A case like those timed, in a directory of its own."""
    folder = jobs[0].root.parent / f"warm{time.monotonic_ns()}"
    return make_jobs(folder, SweepConfig(name="warm", base="base.toml"), WARM_SEED, base)[0]


def _time_loop(jobs: Sequence[Job]) -> float:
    _run([_warm(jobs)])
    started = time.perf_counter()
    for job in jobs:
        _run([job])
    return time.perf_counter() - started


def _time_engine(jobs: Sequence[Job], workers: int, base: str = SMALL) -> float:
    with Workers(workers, None) as some:
        some.client.run(run_cases, [_warm(jobs, base)])
        started = time.perf_counter()
        run_jobs(some.client, jobs, _raise)
        return time.perf_counter() - started


def _time_sweep(folder: Path, config: SweepConfig, seed: int, n_workers: int | None) -> float:
    (folder / "base.toml").write_text(SMALL.format(seed=seed), encoding="utf-8")
    file, out = folder / "sweep.toml", folder / "out"
    started = time.perf_counter()
    plan = make_plan(str(file), config, out, range(config.repeats))
    run_sweep(Console(quiet=True), file, config, out, plan, Workers(n_workers, None))
    return time.perf_counter() - started


def _time_estimation(job: Job) -> float:
    """Seconds of the estimators alone: samples in memory, nothing scored or written."""
    run = case_run(job)
    truths = list(run.truths())
    sweeps = [run.sweep(truth) for truth in truths]
    receiver = run.surveyed_receiver(truths)
    started = time.perf_counter()
    channel = [run.estimate(truth, sweep) for truth, sweep in zip(truths, sweeps, strict=True)]
    run.maps(channel, receiver)
    return time.perf_counter() - started


def _best(repeats: int, measure: Callable[[int], float]) -> float:
    return min(measure(repeat) for repeat in range(repeats))


def _run(jobs: Sequence[Job]) -> None:
    for job, reason in zip(jobs, run_cases(jobs), strict=True):
        _raise(job, reason)


def _raise(job: Job, reason: str | None) -> None:
    if reason is not None:
        raise RuntimeError(f"case {job.key}: {reason}")
