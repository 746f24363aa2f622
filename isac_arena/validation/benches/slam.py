"""`arena bench slam`: snapshot and trajectory solvers over the published snapshot algorithm, compiled.

All times are processor time of one thread, taken in turns; every row is a ratio inside one run.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from estimation.execution import one_blas_thread
from estimation.laws.plane import ray_directions
from estimation.shape.config import ShapeConfig
from estimation.shape.gp.estimate import estimate_shapes
from estimation.slam.config import SnapshotConfig, TrajectoryConfig
from estimation.slam.snapshot.problem import SnapshotProblem, snapshot_problem
from estimation.slam.snapshot.reference import PARALLEL_GATE, solve_reference
from estimation.slam.snapshot.solve import solve_snapshot
from estimation.slam.walk.trajectory import run_trajectory
from isac_arena.validation.benches.compiled_reference import los_state, nlos_state, published_state
from isac_arena.validation.benches.timing import on_each, paired_ratios, spread_of, times_in_turns
from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.scenarios.halls import ScenarioConfig
from isac_arena.validation.scenarios.stops import Scenario, draw_stop, draw_trajectory
from isac_arena.validation.slam.trials import MAPPING, NOISE, OURS
from scenes.record import BoolArray, FloatArray

REFERENCE = SnapshotConfig(method="reference", noise=NOISE)
# As in the measured stops without line of sight: nine paths, about a quarter of them no single bounce.
STOPS = ScenarioConfig(n_paths=9, outlier_share=0.25)
N_PAIRS = 15
OURS_CALLS, PAIRS_CALLS = 10, 200  # of solvers that are short beside the published search
WALK_PAIRS, GROWTH_PAIRS = 5, 2


def bench_snapshot(seed: int, quick: bool) -> list[Measurement]:
    """Our solver over the published search of quadruples on the same stops, with and without line of sight.

    The published chain tests only pairs where a line of sight is credible. Ours ranks states with and without one
    at every stop, so both rows take the published search without one; the time of the pairs is in the reason.
    """
    rng = np.random.default_rng(seed)
    n = 5 if quick else 15
    los = [draw_stop(rng, STOPS) for _ in range(n)]
    nlos = [draw_stop(rng, replace(STOPS, has_los=False)) for _ in range(n)]
    pairs_us = _published_los_us(los)
    alone = f"; the published pairs with the line of sight alone take {pairs_us:.0f} us"
    return [
        _over_search("snapshot.nlos.over_compiled_reference", nlos, 1 / 30, ""),
        _over_search("snapshot.los.over_compiled_reference", los, 1 / 20, alone),
    ]


def bench_plain(seed: int, quick: bool) -> list[Measurement]:
    """Our solver and our reference mode beside the published search in plain NumPy, without line of sight."""
    rng = np.random.default_rng(seed)
    nlos = [draw_stop(rng, replace(STOPS, has_los=False)) for _ in range(1 if quick else 5)]
    problems = [snapshot_problem(stop.estimate, stop.tx, NOISE) for stop in nlos]
    works = (
        on_each(lambda stop: solve_snapshot(stop.estimate, stop.tx, OURS), nlos),
        on_each(lambda problem: solve_reference(problem, REFERENCE, False), problems),
        on_each(lambda problem: plain_grid(problem, REFERENCE), problems),
    )
    with one_blas_thread():
        times_s = times_in_turns(works, 3 if quick else 5, (OURS_CALLS, 1, 1))
    ours, tuned = times_s[:, 2] / times_s[:, 0], times_s[:, 2] / times_s[:, 1]
    grid, same = f"NumPy heading grid; {spread_of(ours)}", f"same results; {spread_of(tuned)}"
    return [
        at_least("snapshot.nlos.speed_over_plain", np.median(ours), 300, grid),
        at_least("snapshot.reference_mode.speed_over_plain", np.median(tuned), 1, same),
    ]


def bench_trajectory(seed: int, quick: bool) -> list[Measurement]:
    """The smoother with shapes over 45 stops beside as many published snapshots, and how its time grows."""
    walk = draw_trajectory(np.random.default_rng(seed), STOPS, 45)
    problems = [snapshot_problem(stop.estimate, stop.tx, NOISE) for stop in walk]
    works = (
        _solving(walk, shapes=True),
        on_each(lambda problem: published_state(problem, REFERENCE), problems),
        on_each(lambda problem: nlos_state(problem, REFERENCE), problems),
    )
    small, large = (50, 100) if quick else (250, 1000)
    walks = [draw_trajectory(np.random.default_rng(seed), STOPS, n) for n in (large, small)]
    with one_blas_thread():
        times_s = times_in_turns(works, 2 if quick else WALK_PAIRS)
        growths, seconds = paired_ratios(
            _solving(walks[0]), _solving(walks[1]), 1 if quick else GROWTH_PAIRS, is_warm=True
        )
    ratios, growths = times_s[:, 0] / times_s[:, 1], growths * small / large
    walk_s, published_s, search_s = np.median(times_s, axis=0)
    n_los = sum(bool(stop.is_los.any()) for stop in walk)
    about = (
        f"{walk_s:.2f} s over {published_s:.2f} s, with the line of sight at the {n_los} stops that have one;"
        f" {search_s:.2f} s without; {spread_of(ratios)}"
    )
    took = f"{large} stops in {np.median(seconds[:, 0]):.1f} s, {small} in {np.median(seconds[:, 1]):.1f} s"
    return [
        at_most("trajectory.stops45_with_shapes.over_references", np.median(ratios), 1.0, about),
        at_most("trajectory.growth_over_linear", np.median(growths), 1.15, f"{took}; {spread_of(growths)}"),
    ]


def _over_search(key: str, stops: Sequence[Scenario], bar: float, more: str) -> Measurement:
    """The median ratio of our solver to the published search without line of sight, over all stops in turns."""
    problems = [snapshot_problem(stop.estimate, stop.tx, NOISE) for stop in stops]
    with one_blas_thread():
        ratios, times_s = paired_ratios(
            on_each(lambda stop: solve_snapshot(stop.estimate, stop.tx, OURS), stops),
            on_each(lambda problem: nlos_state(problem, REFERENCE), problems),
            N_PAIRS,
            (OURS_CALLS, 1),
        )
    ours_ms, search_ms = 1e3 * np.median(times_s, axis=0) / len(stops)
    about = f"{ours_ms:.2f} ms a stop over {search_ms:.2f} ms, {len(stops)} stops; {spread_of(ratios)}"
    return at_most(key, np.median(ratios), bar, about + more)


def _published_los_us(stops: Sequence[Scenario]) -> float:
    """Time of a stop in us by the published pairs with the line of sight."""
    problems = [snapshot_problem(stop.estimate, stop.tx, NOISE) for stop in stops]
    work = on_each(lambda problem: los_state(problem, REFERENCE), problems)
    return float(1e6 * np.median(times_in_turns((work,), N_PAIRS, (PAIRS_CALLS,))) / len(stops))


def _solving(walk: Sequence[Scenario], *, shapes: bool = False) -> Callable[[], object]:
    """The smoother over a walk, with or without the shapes from its points."""
    estimates = [stop.estimate for stop in walk]

    def solve() -> None:
        _, points, _ = run_trajectory(estimates, walk[0].tx, OURS, TrajectoryConfig(), MAPPING)
        if shapes:
            estimate_shapes(points, ShapeConfig())

    return solve


def plain_grid(problem: SnapshotProblem, config: SnapshotConfig) -> FloatArray:
    """State (4,) of the published search without line of sight, written out in plain vectorised NumPy.

    All quadruples at all headings at once: projections Q, normal equations, gate, refit, cost.
    """
    first, tau = problem.earliest, problem.measured[:, 0]
    heading = np.linspace(-np.pi, np.pi, config.n_headings)
    sets = np.array(list(combinations(range(len(problem)), 4)))
    weight = 10 ** (problem.power_dbm / 10)
    u, v = ray_directions(problem.tx, heading[:, None], problem.measured)
    eta = u + v
    projection = np.eye(2) - eta[..., :, None] * eta[..., None, :] / np.sum(eta**2, axis=-1)[..., None, None]
    h = np.concatenate([np.broadcast_to(np.eye(2), (*v.shape, 2)), -v[..., None]], axis=-1)
    mu = problem.tx.position_m[:2] - tau[:, None] * v
    normal = weight[:, None, None] * np.swapaxes(h, -1, -2) @ projection @ h
    right = weight[:, None] * np.einsum("hmji,hmjk,hmk->hmi", h, projection, mu)

    def feasible(z: FloatArray, member: BoolArray) -> BoolArray:
        offset = np.einsum("hmij,hsj->hsmi", h, z) - mu[:, None]
        length = tau - z[..., 2, None]
        eta2 = np.sum(eta**2, axis=-1)[:, None]
        share = np.einsum("hmi,hsmi->hsm", eta, offset) / (length * eta2)
        outside = member & ~((share >= 0) & (share <= 1))
        outside[..., first] &= eta2[..., first] >= PARALLEL_GATE
        return np.asarray((length >= 0).all(axis=-1) & ~outside.any(axis=-1))

    def distance2(z: FloatArray) -> FloatArray:
        offset = np.einsum("hmij,hsj->hsmi", h, z) - mu[:, None]
        return np.asarray(np.sum(np.einsum("hmij,hsmj->hsmi", projection, offset) ** 2, axis=-1))

    member = np.zeros((len(sets), len(problem)), bool)
    np.put_along_axis(member, sets, True, axis=1)
    z = _solved(normal[:, sets].sum(axis=2), right[:, sets].sum(axis=2))
    good = feasible(z, np.broadcast_to(member, (*z.shape[:2], len(problem))))
    inlier = distance2(z) <= config.gate_m2
    good &= inlier.sum(axis=-1) >= 4
    z = _solved(np.einsum("hsm,hmij->hsij", inlier, normal), np.einsum("hsm,hmi->hsi", inlier, right))
    good &= feasible(z, inlier)
    cost = np.where(good, np.minimum(distance2(z), config.gate_m2) @ weight, np.inf)
    at = np.unravel_index(np.argmin(cost), cost.shape)
    x, y, bias = z[at]
    return np.array([x, y, heading[at[0]], bias])


def _solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    scale = np.maximum(np.trace(normal, axis1=-2, axis2=-1), 1e-30)[..., None, None]
    return np.asarray(np.linalg.solve(normal + 1e-13 * scale * np.eye(3), right[..., None])[..., 0])
