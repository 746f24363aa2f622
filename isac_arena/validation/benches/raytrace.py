"""`arena bench raytrace`: the exact solver against the ray tracer, as ratios inside one run."""

import time

import numpy as np
import psutil

from estimation.execution import one_blas_thread
from isac_arena.validation.benches.timing import on_each, spread_of, times_in_turns
from isac_arena.validation.measurement import Measurement, at_most
from scenes.config import load_scene
from scenes.record import FloatArray
from sim.config import PropagationConfig
from sim.propagation.llvm import LLVM_VARIANT, mitsuba_variant
from sim.propagation.specular.solver import ExactSolver
from sim.propagation.tracer import Tracer

CARRIER_HZ = 60e9


def bench_exact_solver(seed: int, quick: bool) -> list[Measurement]:
    """Time per receiver of the exact solver, 2 bounces with curves, against the tracer's specular solve.

    The exact solver takes all stops of campus_arena at once, the tracer one by one (it loses paths if it takes
    them together), in turns. The tracer shoots the default number of rays of `PropagationConfig`, with which it
    loses no planar path in this scene. Processor time of all threads on the CPU, else wall clock.
    """
    scene = load_scene("campus_arena")
    stops = [pose.position_m for pose in scene.stops][:: 9 if quick else 3]
    config = PropagationConfig(diffuse_samples=0)
    solver, tracer = ExactSolver(scene, CARRIER_HZ, config), Tracer(scene, CARRIER_HZ, config)
    works = (
        lambda: solver.paths(np.array(stops)),
        on_each(solver.paths, stops),
        on_each(tracer.specular, stops),
        on_each(tracer.solved_specular, stops),
    )
    clock = time.process_time if mitsuba_variant() == LLVM_VARIANT else time.perf_counter
    with one_blas_thread():
        times_ms = 1e3 * times_in_turns(works, 3 if quick else 5, clock=clock) / len(stops)
    exact, _, traced, call = times_ms.T
    exact_ms, single_ms, traced_ms, call_ms = np.median(times_ms, axis=0)
    lossy = (
        f"exact curved and planar paths must not cost more than the tracer, which loses some; {traced_ms:.0f} ms"
    )
    records = "records, names and double precision on top of the tracer's own solve"
    prototype = (
        f"{exact_ms:.1f} ms over {call_ms:.0f} ms of the tracer's own solve of the same receiver at the same depth"
        f" ({single_ms:.1f} ms with a call for each receiver); a plain numpy prototype took 50 ms, about a fifth"
    )
    return [
        _median("exact_over_tracer_time", exact / traced, 1 / 3, lossy),
        _median("tracing_overhead", traced / call, 1.2, records),
        _median("exact_per_receiver.over_tracer_call", exact / call, 1 / 5, prototype),
    ]


def _median(key: str, ratios: FloatArray, bar: float, reason: str) -> Measurement:
    return at_most(key, np.median(ratios), bar, f"{reason}; {spread_of(ratios)}")


def bench_memory(seed: int, quick: bool) -> list[Measurement]:
    """Resident memory over 1,000 receivers of campus_arena (100 in the quick run), last quarter over first."""
    scene = load_scene("campus_arena")
    rng = np.random.default_rng(seed)
    positions = np.array([pose.position_m for pose in scene.stops])
    receivers = positions[rng.integers(0, len(positions), 100 if quick else 1000)]
    receivers = receivers + rng.uniform(-0.1, 0.1, receivers.shape) * [1, 1, 0]
    config = PropagationConfig(diffuse_samples=0)
    solver, tracer = ExactSolver(scene, CARRIER_HZ, config), Tracer(scene, CARRIER_HZ, config)
    process, resident_gb = psutil.Process(), []
    for number, receiver in enumerate(receivers):
        solver.paths(receiver)
        if number % 5 == 0:
            tracer.specular(receiver)
        resident_gb.append(process.memory_info().rss / 1e9)
    quarter = len(receivers) // 4
    early_gb, late_gb = max(resident_gb[:quarter]), max(resident_gb[-quarter:])
    reason = f"memory must not grow with the receivers: {early_gb:.2f} GB, then {late_gb:.2f} GB"
    return [at_most("memory.growth", late_gb / early_gb, 1.05, reason, "of the first quarter")]
