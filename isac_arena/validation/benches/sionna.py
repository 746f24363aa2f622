"""The sweep of traced paths against Sionna's own channel of all elements, turned into beams afterwards."""

import time
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from isac_arena.validation.benches.signal import noiseless_cube, signal_link
from isac_arena.validation.benches.timing import spread_of, times_in_turns
from isac_arena.validation.measurement import Measurement, at_least, at_most
from scenes.config import load_scene, scene_path
from scenes.record import ComplexArray, FloatArray
from sim.config import PropagationConfig
from sim.propagation.llvm import LLVM_VARIANT, mitsuba_variant
from sim.propagation.tracer import Tracer, solved_between_panels
from sim.signal.link import Link

SUBCARRIERS_AT_ONCE = 396  # of Sionna's channel: fewer take it longer, more take gigabytes


def bench_against_sionna(seed: int, quick: bool) -> list[Measurement]:
    """32 x 32 beams x 3,168 subcarriers (an eighth in the quick run) of the specular paths of a stop of box_room.

    Sionna's `Paths.cfr` has to be made for all 64 x 64 elements first. Tracing is not counted on either side.
    """
    link, scene = signal_link(), load_scene(scene_path("box_room"))
    rx, settings = scene.stops[0], PropagationConfig(diffuse_samples=0)
    solved, element_m = solved_between_panels(scene, rx, link.carrier_hz, settings, rows=4, columns=16)
    paths = Tracer(scene, link.carrier_hz, settings).specular(rx.position_m)
    frequency_hz = link.frequency_offset_hz[: SUBCARRIERS_AT_ONCE if quick else None]
    weights = in_order_of(link, element_m)
    on_cpu = mitsuba_variant() == LLVM_VARIANT
    clock = time.process_time if on_cpu else time.perf_counter
    with threadpool_limits(1):
        our_work = partial(noiseless_cube, link, paths, scene.tx, rx, frequency_hz)
        their_work = partial(sionna_swept, solved, weights, frequency_hz)
        ours, theirs = our_work(), their_work()
        times_s = times_in_turns((our_work, their_work), 1 if quick else 3, (5, 1), is_warm=True, clock=clock)
    error = float(np.abs(ours - theirs).max() / np.abs(ours).max())
    where = "both as processor time, Dr.Jit on all cores" if on_cpu else "Sionna on the GPU, wall clock"
    ratios, (ours_s, theirs_s) = times_s[:, 1] / times_s[:, 0], np.median(times_s, axis=0)
    times = f"{len(paths)} paths, {theirs_s:.2f} s over {1e3 * ours_s:.0f} ms, {where}; {spread_of(ratios)}"
    rounding = "over the largest sample; single precision rounds Sionna's delays by 1 fs, 0.4 mrad at 60 GHz"
    return [
        at_most("signal.sionna.difference", error, 1e-3, rounding),
        at_least("signal.sionna.time_ratio", np.median(ratios), 20.0, times),
    ]


def sionna_swept(solved: Any, weights: ComplexArray, frequency_hz: FloatArray) -> ComplexArray:
    """The same by Sionna, with the weights (beam, element) of both ends applied to the channel of the elements."""
    beams = np.empty((len(weights), len(weights), len(frequency_hz)), np.complex64)
    for first in range(0, len(frequency_hz), SUBCARRIERS_AT_ONCE):
        part = slice(first, first + SUBCARRIERS_AT_ONCE)
        at_hz = frequency_hz[part].astype(np.float32)
        channel = solved.cfr(at_hz, normalize_delays=False, out_type="numpy")[0, :, 0, :, 0]
        received = np.tensordot(weights, channel, 1)  # (rx_beam, tx_element, subcarrier)
        beams[:, :, part] = np.tensordot(weights, received, (1, 1))
    return beams


def in_order_of(link: Link, element_m: FloatArray) -> ComplexArray:
    """Weights (beam, element) of a link whose codebooks agree, for elements (element, xyz) in another order."""
    gap_m = np.linalg.norm(link.tx_codebook.element_position_m - element_m[:, None], axis=2)
    return link.tx_codebook.weights[:, gap_m.argmin(axis=1)].astype(np.complex64)
