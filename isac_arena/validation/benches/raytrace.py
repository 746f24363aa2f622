"""`arena bench raytrace`: the exact solver against the ray tracer, as ratios inside one run."""

import resource
import time

import numpy as np

from isac_arena.validation.benches.timing import median_time_s
from isac_arena.validation.measurement import Measurement, at_most
from scenes.config import load_scene
from sim.config import PropagationConfig
from sim.propagation.specular.solver import ExactSolver
from sim.propagation.tracer import Tracer

CARRIER_HZ = 60e9


def bench_exact_solver(seed: int, quick: bool) -> list[Measurement]:
    """Time per receiver of the exact solver, 2 bounces with curves, against the tracer's specular solve.

    The exact solver takes all stops of campus_arena at once, the tracer one by one (it loses paths if it takes
    them together), both after a warm-up. The tracer shoots the default number of rays of `PropagationConfig`,
    with which it loses no planar path in this scene.
    """
    scene = load_scene("campus_arena")
    stops = [pose.position_m for pose in scene.stops][:: 9 if quick else 1]
    config = PropagationConfig(diffuse_samples=0)
    solver, tracer = ExactSolver(scene, CARRIER_HZ, config), Tracer(scene, CARRIER_HZ, config)
    solver.paths(np.array(stops))
    started = time.perf_counter()
    solver.paths(np.array(stops))
    exact_s = (time.perf_counter() - started) / len(stops)
    traced_s = median_time_s(tracer.specular, stops)
    call_s = median_time_s(tracer.solved_specular, stops)
    exact = "exact curved and planar paths must not cost more than the tracer, which loses some"
    records = "records, names and double precision on top of the tracer's own solve"
    return [
        at_most("exact_over_tracer_time", exact_s / traced_s, 1 / 3, exact),
        at_most("tracing_overhead", traced_s / call_s, 1.2, records),
        at_most("exact_per_receiver", 1e3 * exact_s, 50.0, "time of a plain numpy prototype", "ms"),
    ]


def bench_memory(seed: int, quick: bool) -> list[Measurement]:
    """Peak memory of this process after 1,000 receivers of campus_arena (100 in the quick run)."""
    scene = load_scene("campus_arena")
    rng = np.random.default_rng(seed)
    positions = np.array([pose.position_m for pose in scene.stops])
    receivers = positions[rng.integers(0, len(positions), 100 if quick else 1000)]
    receivers = receivers + rng.uniform(-0.1, 0.1, receivers.shape) * [1, 1, 0]
    config = PropagationConfig(diffuse_samples=0)
    solver = ExactSolver(scene, CARRIER_HZ, config)
    for receiver in receivers:
        solver.paths(receiver)
    tracer = Tracer(scene, CARRIER_HZ, config)
    for receiver in receivers[:: 10 if quick else 5]:
        tracer.specular(receiver)
    peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    return [at_most("peak_memory", peak_gb, 2.0, "memory must not grow with the receivers", "GB")]
