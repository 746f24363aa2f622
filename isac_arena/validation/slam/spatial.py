"""`arena validate slam`: stops and walks with elevations, solved in space."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from estimation.laws import plane as plane_law
from estimation.laws import space as space_law
from estimation.slam.bounds import StopPaths, stop_bound
from estimation.slam.config import SnapshotConfig, TrajectoryConfig
from estimation.slam.record import SolveStatus
from estimation.slam.snapshot.solution import SnapshotSolution, collect_poses
from estimation.slam.space.bounds import SpatialPaths, spatial_bound
from estimation.slam.space.mapping import map_stops_spatial
from estimation.slam.space.snapshot import solve_spatial
from estimation.slam.space.trajectory import run_spatial_trajectory
from isac_arena.scoring.metrics.statistics import squared_mahalanobis
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.scenarios.halls import ScenarioConfig
from isac_arena.validation.scenarios.spatial_halls import (
    SpatialScenario,
    covariance_of,
    draw_spatial_stop,
    draw_spatial_walk,
)
from isac_arena.validation.slam.common import (
    CLEAN,
    GAUSSIAN,
    MAPPING,
    MATCHED,
    MAX_PEB_M,
    OURS,
    consistency_rows,
    derivative_error,
    solution_error,
)
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import FloatArray

_TO_METRES = np.array([SPEED_OF_LIGHT_M_S, 1.0, 1.0, 1.0, 1.0])


@dataclass(frozen=True)
class SpatialTrial:
    """One solved stop: its error (5,) and covariance in (m, m, m, rad, m)."""

    scenario: SpatialScenario
    solution: SnapshotSolution
    error: FloatArray
    covariance: FloatArray
    peb_m: float


def solve_trial(scenario: SpatialScenario, config: SnapshotConfig) -> SpatialTrial:
    """Solve a made-up stop; the bound is that of its true single bounces and line of sight."""
    solution = solve_spatial(scenario.estimate, scenario.tx, config)
    covariance = scenario.estimate.covariance * np.outer(_TO_METRES, _TO_METRES)
    los = covariance[scenario.is_los]
    paths = SpatialPaths(
        scenario.point_m[scenario.is_single], covariance[scenario.is_single], los[0] if len(los) else None
    )
    bound, _ = spatial_bound(scenario.tx, scenario.state, paths)
    return SpatialTrial(scenario, solution, *solution_error(solution, scenario.state), bound.position_m)


def check_space_noiseless(seed: int, quick: bool) -> list[Measurement]:
    """Stops without errors and without outliers, with and without line of sight."""
    rng = np.random.default_rng(seed + 20)
    exact = replace(CLEAN, is_noisy=False)
    rows = []
    for name, has_los in (("los", True), ("nlos", False)):
        trials = [
            solve_trial(draw_spatial_stop(rng, replace(exact, has_los=has_los)), OURS)
            for _ in range(5 if quick else 30)
        ]
        worst = max(float(np.max(np.nan_to_num(np.abs(trial.error), nan=np.inf))) for trial in trials)
        rows.append(at_most(f"space.noiseless.{name}.state_error_m", worst, 1e-6, "m, m, m, rad, m", "m"))
    return rows


def check_space_efficiency(seed: int, quick: bool) -> list[Measurement]:
    """RMSE over the bound, and consistency of the covariances, with Gaussian errors and no outliers."""
    rng = np.random.default_rng(seed + 21)
    rows: list[Measurement] = []
    every: list[SpatialTrial] = []
    for name, has_los in (("los", True), ("nlos", False)):
        settings = replace(GAUSSIAN, has_los=has_los)
        trials = [solve_trial(draw_spatial_stop(rng, settings), MATCHED) for _ in range(40 if quick else 500)]
        trials = [trial for trial in trials if trial.peb_m <= MAX_PEB_M]
        square = [np.nan_to_num(np.sum(trial.error[:3] ** 2), nan=np.inf) for trial in trials]
        ratio = float(np.sqrt(np.mean(square) / np.mean([trial.peb_m**2 for trial in trials])))
        bar = 1.3 if quick else 1.1  # a mean of 40 squares of 3 components scatters by 15 %
        rows.append(at_most(f"space.{name}.rmse_over_peb", ratio, bar, "efficient estimator"))
        every += trials
    solved = [trial for trial in every if trial.solution.status != SolveStatus.FAILED]
    error = np.array([trial.error for trial in solved])
    covariance = np.array([trial.covariance for trial in solved])
    points = [_point_nees(trial) for trial in solved]
    loose = (0.25, 0.25, 0.08) if quick else None
    return rows + consistency_rows("space", error, covariance, points, 3, loose)


def check_space_trajectory(seed: int, quick: bool) -> list[Measurement]:
    """Walks with elevations and 30 % outliers, solved all stops together."""
    worst, height = [], []
    for run in range(1 if quick else 8):
        rng = np.random.default_rng([seed, run, 22])
        walk = draw_spatial_walk(rng, ScenarioConfig(n_paths=10, outlier_share=0.3), 15 if quick else 30)
        estimates = [scenario.estimate for scenario in walk]
        poses, _, _ = run_spatial_trajectory(estimates, walk[0].tx, OURS, TrajectoryConfig(), MAPPING)
        truth = np.array([scenario.state[:3] for scenario in walk])
        plan = np.nan_to_num(np.hypot(*(poses.position_m - truth[:, :2]).T), nan=np.inf)
        worst.append(float(np.sqrt(np.mean(plan**2))))
        height.append(float(np.sqrt(np.mean(np.nan_to_num(poses.height_m - truth[:, 2], nan=np.inf) ** 2))))
    return [
        at_most("space.trajectory.outliers30.worst_rmse_m", max(worst), 0.5, "as in the plane", "m"),
        at_most("space.trajectory.outliers30.worst_height_rmse_m", max(height), 0.5, "worst run", "m"),
    ]


def check_space_plane(seed: int, quick: bool) -> list[Measurement]:
    """Everything in one horizontal plane: prediction, equation and bound are those of the plane."""
    rng = np.random.default_rng(seed + 23)
    predicted, equation, peb = [], [], []
    for _ in range(20):
        tx = Pose(np.array([*rng.uniform(-2, 2, 2), 1.8]), rng.uniform(-3, 3))
        state = np.array([*rng.uniform(-6, 6, 2), 1.8, rng.uniform(-3, 3), rng.uniform(-5, 15)])
        point = np.column_stack([rng.uniform(-9, 9, (6, 2)), np.full(6, 1.8)])
        flat = state[[0, 1, 3, 4]]
        measured = space_law.predict_bounce(tx, state, point)
        in_plane = plane_law.predict_bounce(tx, flat, point[:, :2])
        predicted.append(np.abs(measured[:, :3] - in_plane).max())
        shifted = measured + rng.normal(size=measured.shape) * [0.3, 0.05, 0.05, 0.0, 0.0]
        two = space_law.bounce_equations(tx, state, shifted).value_m
        one = plane_law.bounce_equation(tx, flat[2], shifted[:, :3]).residual_m(flat[[0, 1, 3]])
        equation.append(np.abs(np.abs(two) - np.column_stack([np.abs(one), np.zeros(6)])).max())
        covariance = np.tile(covariance_of(CLEAN), (6, 1, 1))
        space, _ = spatial_bound(tx, state, SpatialPaths(point, covariance, covariance[0]))
        plane, _ = stop_bound(
            tx,
            flat,
            StopPaths(point[:, :2], covariance[:, :3, :3], np.full(6, -1), covariance[0, :3, :3]),
        )
        peb.append(abs(space.plan_m / float(plane.position_m) - 1))
    return [
        at_most("space.plane.prediction_deviation", max(predicted), 1e-12, "same law", "m, rad"),
        at_most("space.plane.equation_deviation_m", max(equation), 1e-12, "same equation", "m"),
        at_most("space.plane.peb_deviation", max(peb), 1e-6, "same bound"),
    ]


def check_space_jacobians(seed: int, quick: bool) -> list[Measurement]:
    """Every derivative in space against central differences, away from any solution."""
    rng = np.random.default_rng(seed + 24)
    scenario = draw_spatial_stop(rng, CLEAN)
    tx, x, point = scenario.tx, scenario.state, scenario.point_m[scenario.is_single]
    measured = space_law.predict_bounce(tx, x, point) + rng.normal(size=(len(point), 5)) * 0.05
    at = space_law.bounce_equations(tx, x, measured)
    one = space_law.bounce_equations(tx, x, measured[0])
    cases: dict[str, tuple[Callable[[FloatArray], FloatArray], FloatArray, FloatArray]] = {
        "bounce_state": (
            lambda s: space_law.predict_bounce(tx, s, point),
            x,
            space_law.bounce_jacobian_rx(tx, x, point),
        ),
        "bounce_point": (
            lambda q: space_law.predict_bounce(tx, x, q),
            point[0],
            space_law.bounce_jacobian_point(tx, x, point[0]),
        ),
        "los_state": (lambda s: space_law.predict_los(tx, s), x, space_law.los_jacobian_rx(tx, x)),
        "equations_state": (lambda s: space_law.bounce_equations(tx, s, measured).value_m, x, at.by_state),
        "equations_measurement": (
            lambda y: space_law.bounce_equations(tx, x, y).value_m,
            measured[0],
            one.by_measurement,
        ),
    }
    return [
        at_most(f"space.jacobian.{name}", derivative_error(*case, _unwrapped), 1e-6, "central differences")
        for name, case in cases.items()
    ]


def _unwrapped(ahead: FloatArray, behind: FloatArray) -> FloatArray:
    """Difference of measurements with the angles unwrapped; of anything else as it is."""
    is_measurement = ahead.shape[-1] == space_law.N_MEASURED
    return space_law.residual(ahead, behind) if is_measurement else ahead - behind


def _point_nees(trial: SpatialTrial) -> FloatArray:
    """Squared Mahalanobis error (ip,) in space of the IPs taken for single bounces that are."""
    solution, scenario = trial.solution, trial.scenario
    points = map_stops_spatial(
        [scenario.estimate],
        collect_poses([solution]),
        scenario.tx,
        MAPPING,
        is_los=[solution.is_los],
        is_inlier=[solution.is_inlier],
        state_covariance=[solution.covariance],
    )
    right = points.is_inlier & scenario.is_single[points.path]
    error = (
        np.column_stack([points.position_m, points.height_m])[right] - scenario.point_m[points.path[right]]
    )
    covariance = np.zeros((len(points), 3, 3))
    covariance[:, :2, :2] = points.covariance_m2
    covariance[:, 2], covariance[:, :, 2] = points.height_covariance_m2, points.height_covariance_m2
    return squared_mahalanobis(error, covariance[right])
