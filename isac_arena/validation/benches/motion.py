"""Time of the generation of sweeps whose paths move, as a ratio to one FFT pass over the same cube."""

from functools import partial

import numpy as np
import scipy.fft
from threadpoolctl import threadpool_limits

from isac_arena.validation.benches.signal import ORIGIN, signal_link
from isac_arena.validation.benches.timing import paired_ratios
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.scenarios.moving_stops import steady_sweep
from isac_arena.validation.scenarios.paths import random_paths
from sim.signal.moving import moving_channel

N_PATHS, FASTEST_HZ = 64, 800.0
SWEEP_S = 9e-3


def bench_moving_generation(seed: int, quick: bool) -> list[Measurement]:
    """32 x 32 beams x 3,168 subcarriers without noise, 64 paths that all move."""
    link, rng = signal_link(), np.random.default_rng(seed)
    shape = len(link.tx_codebook), len(link.rx_codebook)
    time_s = np.linspace(-SWEEP_S / 2, SWEEP_S / 2, shape[0] * shape[1]).reshape(shape)
    paths, shift_hz = random_paths(rng, N_PATHS), rng.uniform(-FASTEST_HZ, FASTEST_HZ, N_PATHS)
    motion = steady_sweep(link.carrier_hz, paths, shift_hz, time_s.ravel())
    make = partial(
        moving_channel, motion, time_s, tx_codebook=link.tx_codebook, rx_codebook=link.rx_codebook,
        tx_heading_rad=lambda _: 0.0, rx_pose=ORIGIN, frequency_offset_hz=link.frequency_offset_hz,
        clock_bias_s=0.0,
    )  # fmt: skip
    with threadpool_limits(1):
        cube = np.ones((*shape, len(link.frequency_offset_hz)), np.complex64)
        ratios, times = paired_ratios(make, lambda: scipy.fft.fft(cube, axis=-1), 9 if quick else 25)
    taken_ms, fft_ms = 1e3 * np.median(times, axis=0)
    reason = f"{taken_ms:.0f} ms over {fft_ms:.1f} ms of processor time, one thread; median of {len(ratios)} pairs"
    return [at_most("motion.generation.64_paths", np.median(ratios), 5.0, reason, "FFT passes")]
