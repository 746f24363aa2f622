"""`arena bench channel`: time and memory of the estimators, as ratios to one FFT pass over the same cube.

One thread. The pass is a complex64 FFT along the contiguous subcarrier axis of the cube of 32 x 32 beams and 3,168
subcarriers, the least any estimator has to do. Memory is the peak that is allocated on top of the cube itself, of
which the caller keeps the only copy.
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np
import scipy.fft
from threadpoolctl import threadpool_limits

from estimation.channel.coherent.paths import fit_coherent
from estimation.channel.incoherent.paths import fit_incoherent
from isac_arena.validation.benches.timing import peak_bytes
from isac_arena.validation.channel.efficiency import STRONGEST_DB
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.scenarios.link_bench import LinkBench, draw_paths, make_bench, observe_paths
from sim.observation import BeamSweep

BARS = {"coherent": 3.0, "incoherent": 10.0}
MEMORY_BAR = 1.5
METHODS: dict[str, Callable[[BeamSweep], object]] = {"coherent": fit_coherent, "incoherent": fit_incoherent}


def bench_methods(seed: int, quick: bool) -> list[Measurement]:
    """Median over random stops of the best of several repeats, each beside an FFT pass of its own.

    The median is over stops of 5 to 12 paths; compilation and the tables that a link needs once are not counted.
    """
    n_stops, repeats = (2, 2) if quick else (10, 5)
    rows = []
    with threadpool_limits(1):
        for method, fit in METHODS.items():
            bench = make_bench(seed, phase_noise_pair_deg=180.0 if method == "incoherent" else 0.0)
            sweeps = [_sweep(bench, seed, stop) for stop in range(n_stops)]
            fit(sweeps[0])
            times = np.array([_beside_fft(fit, sweep, repeats) for sweep in sweeps])
            ratio = float(np.median(times[:, 0] / times[:, 1]))
            taken_ms, fft_ms = (1e3 * np.median(times, axis=0)).tolist()
            cubes = peak_bytes(partial(fit, sweeps[0])) / sweeps[0].samples.nbytes
            key, beyond = f"channel.{method}", "peak beyond the cube itself"
            reason = f"{taken_ms:.0f} ms over {fft_ms:.1f} ms, median of {n_stops} stops, one thread"
            rows.append(at_most(f"{key}.time", ratio, BARS[method], reason, "FFT passes"))
            rows.append(at_most(f"{key}.memory", cubes, MEMORY_BAR, beyond, "cubes"))
    return rows


def _sweep(bench: LinkBench, seed: int, stop: int) -> BeamSweep:
    paths = draw_paths(np.random.default_rng([seed, stop]), bench.cell, strongest_db=STRONGEST_DB)
    return observe_paths(bench, paths, stop).sweep


def _beside_fft(fit: Callable[[BeamSweep], object], sweep: BeamSweep, repeats: int) -> tuple[float, float]:
    """Least CPU time in s of the estimator and of the FFT pass, taken in turns."""
    taken, passes = [], []
    for _ in range(repeats):
        started = time.process_time()
        fit(sweep)
        between = time.process_time()
        scipy.fft.fft(sweep.samples, axis=-1)
        taken.append(between - started)
        passes.append(time.process_time() - between)
    return min(taken), min(passes)
