"""Time and memory of the sweep generation, as ratios to one FFT pass over the same cube in the same run."""

from functools import partial

import numpy as np
import scipy.fft
from threadpoolctl import threadpool_limits

from isac_arena.validation.benches.timing import paired_ratios, peak_bytes, spread_of
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.scenarios.paths import random_paths
from scenes.pose import Pose
from scenes.record import ComplexArray, FloatArray
from sim.config import ArrayConfig, SimulationConfig, WaveformConfig
from sim.propagation.paths import Paths
from sim.signal.generation import beam_channel
from sim.signal.link import Link, make_link
from sim.signal.noise import add_noise
from sim.signal.waveform.prs import PREFIX_SHARE

N_SUBCARRIERS = 3168
ORIGIN = Pose(np.zeros(3), 0.0)


def bench_generation(seed: int, quick: bool) -> list[Measurement]:
    """32 x 32 beams x 3,168 subcarriers with noise, from the paths on: array responses included."""
    link = signal_link()
    rng = np.random.default_rng(seed)
    rows: list[Measurement] = []
    with threadpool_limits(1):
        cube = np.ones((32, 32, N_SUBCARRIERS), np.complex64)
        for name, count, bar in (("64_paths", 64, 10.0), ("20000_paths", 20_000, 20.0)):
            work = partial(noisy_cube, link, random_paths(rng, count), rng)
            ratios, times_s = paired_ratios(work, lambda: scipy.fft.fft(cube, axis=-1), 3 if quick else 9, (1, 3))
            taken_s, fft_s = np.median(times_s, axis=0)
            reason = f"{1e3 * taken_s:.0f} ms over {1e3 * fft_s:.1f} ms of processor time, one thread"
            about = f"{reason}; {spread_of(ratios)}; {taken_s / air_time_s(link):.1f} times the time on air"
            rows.append(at_most(f"signal.generation.{name}", np.median(ratios), bar, about, "FFT passes"))
        cubes = peak_bytes(work) / cube.nbytes
    return [*rows, at_most("signal.generation.peak_memory", cubes, 4.0, "20,000 paths", "cubes")]


def signal_link() -> Link:
    """32 x 32 beams of 4 x 16 arrays over 3,168 subcarriers."""
    array, waveform = ArrayConfig(), WaveformConfig(combine_symbols=True)
    return make_link(SimulationConfig(scene="-", waveform=waveform, tx_array=array, rx_array=array))


def noiseless_cube(
    link: Link, paths: Paths, tx: Pose = ORIGIN, rx: Pose = ORIGIN, frequency_hz: FloatArray | None = None
) -> ComplexArray:
    """Channel (tx_beam, rx_beam, subcarrier) by the generator of the sweeps, by default on all subcarriers."""
    return beam_channel(
        paths, tx_codebook=link.tx_codebook, rx_codebook=link.rx_codebook, tx_pose=tx, rx_pose=rx,
        frequency_offset_hz=link.frequency_offset_hz if frequency_hz is None else frequency_hz, clock_bias_s=0.0,
    )  # fmt: skip


def noisy_cube(link: Link, paths: Paths, rng: np.random.Generator) -> ComplexArray:
    """Samples of all beam pairs."""
    channel = noiseless_cube(link, paths)
    channel *= np.sqrt(link.tx_power_mw).astype(np.float32) * link.prs_symbol[:, None, :]
    return add_noise(channel, link.noise_power_mw, rng)


def air_time_s(link: Link) -> float:
    """Time that a sweep takes on air: beam pairs x symbol duration."""
    step_hz = float(np.diff(link.frequency_offset_hz).min())
    return len(link.tx_codebook) * len(link.rx_codebook) * (1 + PREFIX_SHARE["normal"]) / step_hz
