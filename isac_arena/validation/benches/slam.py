"""`arena bench slam`: snapshot and trajectory solvers, as ratios inside one run and in absolute time."""

import time
from dataclasses import replace
from itertools import combinations

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.laws.plane import ray_directions
from estimation.shape.config import ShapeConfig
from estimation.shape.gp.estimate import estimate_shapes
from estimation.slam.config import SnapshotConfig, TrajectoryConfig
from estimation.slam.snapshot.problem import SnapshotProblem, snapshot_problem
from estimation.slam.snapshot.reference import PARALLEL_GATE, solve_reference
from estimation.slam.snapshot.solve import solve_snapshot
from estimation.slam.walk.trajectory import run_trajectory
from isac_arena.validation.benches.timing import median_time_s
from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.scenarios.halls import ScenarioConfig
from isac_arena.validation.scenarios.stops import Scenario, draw_stop, draw_trajectory
from isac_arena.validation.slam.trials import MAPPING, NOISE, OURS
from scenes.record import BoolArray, FloatArray

REFERENCE = SnapshotConfig(method="reference", noise=NOISE)
# As in the measured stops without line of sight: nine paths, about a quarter of them no single bounce.
STOPS = ScenarioConfig(n_paths=9, outlier_share=0.25)


def bench_snapshot(seed: int, quick: bool) -> list[Measurement]:
    """Median time per stop of both modes on the same stops, with and without line of sight."""
    rng = np.random.default_rng(seed)
    n = 5 if quick else 15
    los = [draw_stop(rng, STOPS) for _ in range(n)]
    nlos = [draw_stop(rng, replace(STOPS, has_los=False)) for _ in range(n)]
    ours = median_time_s(lambda stop: solve_snapshot(stop.estimate, stop.tx, OURS), nlos, 5)
    with_los = median_time_s(lambda stop: solve_snapshot(stop.estimate, stop.tx, OURS), los, 5)
    problems = [snapshot_problem(stop.estimate, stop.tx, NOISE) for stop in nlos]
    grid = median_time_s(lambda problem: plain_grid(problem, REFERENCE), problems, 1)
    tuned = median_time_s(lambda problem: solve_reference(problem, REFERENCE, False), problems, 1)
    return [
        at_least("snapshot.nlos.speed_over_reference", grid / ours, 300, "plain NumPy heading grid"),
        at_least("snapshot.reference_mode.speed_over_plain", grid / tuned, 1, "same results"),
        at_most("snapshot.nlos.time_ms", 1e3 * ours, 0.5, "median per stop", "ms"),
        at_most("snapshot.los.time_ms", 1e3 * with_los, 0.3, "median per stop", "ms"),
    ]


def bench_trajectory(seed: int, quick: bool) -> list[Measurement]:
    """The smoother with shapes over 45 stops, and how its time grows."""
    short = _trajectory_s(seed, 45, shapes=True)
    rows = [at_most("trajectory.stops45_with_shapes_s", short, 0.3, "warm", "s")]
    small, large = (100, 200) if quick else (250, 1000)
    first, second = _trajectory_s(seed, small), _trajectory_s(seed, large)
    if not quick:
        rows.append(at_most("trajectory.stops1000_s", second, 10.0, "one run", "s"))
    growth = (second / first) / (large / small)
    rows.append(at_most("trajectory.growth_over_linear", growth, 1.3, f"{large} over {small} stops"))
    return rows


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


def _trajectory_s(seed: int, n_stops: int, *, shapes: bool = False) -> float:
    walk = draw_trajectory(np.random.default_rng(seed), STOPS, n_stops)
    estimates = [scenario.estimate for scenario in walk]
    if shapes:
        _solve_walk(walk, estimates[: n_stops // 3], shapes)
    started = time.perf_counter()
    _solve_walk(walk, estimates, shapes)
    return time.perf_counter() - started


def _solve_walk(walk: list[Scenario], estimates: list[ChannelEstimate], shapes: bool) -> None:
    _, points, _ = run_trajectory(estimates, walk[0].tx, OURS, TrajectoryConfig(), MAPPING)
    if shapes:
        estimate_shapes(points, ShapeConfig())
