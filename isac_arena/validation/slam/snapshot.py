"""`arena validate slam`: Monte Carlo on made-up halls, bounds, consistency and Jacobians."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import softmax

from estimation.laws.plane import (
    bounce_jacobian_point,
    bounce_jacobian_rx,
    los_jacobian_rx,
    predict_bounce,
    predict_los,
    residual,
)
from estimation.slam.bounds import StopPaths, stop_bound
from estimation.slam.config import Mixture, SnapshotConfig, TrajectoryConfig
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.record import SolveStatus
from estimation.slam.snapshot.refine import bounce_terms
from estimation.slam.snapshot.solution import SnapshotSolution, collect_poses
from estimation.slam.snapshot.solve import solve_snapshot
from estimation.slam.stops import run_slam
from estimation.slam.walk.filter import run_filter
from estimation.slam.walk.landmarks import predict_circle, predict_walls
from estimation.slam.walk.trajectory import run_trajectory
from isac_arena.scoring.metrics.statistics import squared_mahalanobis
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.scenarios.halls import Scenario, ScenarioConfig, draw_stop, draw_trajectory
from isac_arena.validation.slam.common import (
    CLEAN,
    GAUSSIAN,
    MAPPING,
    MAX_PEB_M,
    NOISE,
    OURS,
    consistency_rows,
    derivative_error,
    solution_error,
)
from scenes.record import BoolArray, FloatArray

REFERENCE = SnapshotConfig(method="reference", noise=NOISE)
# By default nothing is assumed of the building; the walls of the made-up halls stand at right angles.
RIGHT_ANGLES = OURS.model_copy(update={"mixture": Mixture(double_share=0.1)})
CLUTTERED = ScenarioConfig(outlier_share=0.5)
GROSS_M, CONFIDENT_M = 1.0, 0.5


@dataclass(frozen=True)
class SnapshotTrial:
    """One solved stop: its error (4,) and covariance in (m, m, rad, m)."""

    scenario: Scenario
    solution: SnapshotSolution
    error: FloatArray
    covariance: FloatArray

    @property
    def distance_m(self) -> float:
        """Position error in m; infinite where the stop was not solved."""
        return float(np.nan_to_num(np.hypot(*self.error[:2]), nan=np.inf))

    @property
    def peb_m(self) -> float:
        """Bound of the position from the true single bounces and the line of sight."""
        single, covariance = self.scenario.is_single, NOISE.covariance(self.scenario.estimate)
        los = covariance[self.scenario.is_los]
        paths = StopPaths(
            self.scenario.point_m[single],
            covariance[single],
            np.full(int(single.sum()), -1),
            los[0] if len(los) else None,
        )
        return float(stop_bound(self.scenario.tx, self.scenario.state, paths)[0].position_m)


def solve(scenario: Scenario, config: SnapshotConfig) -> SnapshotTrial:
    """Solve a made-up stop."""
    solution = solve_snapshot(scenario.estimate, scenario.tx, config)
    return SnapshotTrial(scenario, solution, *solution_error(solution, scenario.state))


def check_noiseless(seed: int, quick: bool) -> list[Measurement]:
    """Stops without errors and without outliers, with and without line of sight."""
    rng = np.random.default_rng(seed)
    exact = replace(CLEAN, is_noisy=False)
    worst = {}
    for name, has_los in (("los", True), ("nlos", False)):
        trials = [
            solve(draw_stop(rng, replace(exact, has_los=has_los)), OURS) for _ in range(10 if quick else 40)
        ]
        worst[name] = max(float(np.max(np.nan_to_num(np.abs(trial.error), nan=np.inf))) for trial in trials)
    return [
        at_most(f"noiseless.{name}.state_error_m", value, 1e-6, "m, m, rad, m", "m")
        for name, value in worst.items()
    ]


def check_efficiency(seed: int, quick: bool) -> list[Measurement]:
    """RMSE over the bound, and consistency of the covariances, with Gaussian errors and no outliers."""
    rng = np.random.default_rng(seed + 1)
    rows: list[Measurement] = []
    every: list[SnapshotTrial] = []
    for name, has_los in (("los", True), ("nlos", False)):
        settings = replace(GAUSSIAN, has_los=has_los)
        trials = [solve(draw_stop(rng, settings), OURS) for _ in range(50 if quick else 800)]
        trials = [trial for trial in trials if trial.peb_m <= MAX_PEB_M]
        error = np.array([trial.distance_m for trial in trials])
        peb = np.array([trial.peb_m for trial in trials])
        ratio = float(np.sqrt(np.mean(error**2) / np.mean(peb**2)))
        bar = 1.3 if quick else 1.1  # a mean of 50 squares of 2 components scatters by 14 %
        rows.append(at_most(f"monte_carlo.{name}.rmse_over_peb", ratio, bar, "efficient estimator"))
        every += trials
    error = np.array([trial.error for trial in every])
    covariance = np.array([trial.covariance for trial in every])
    points = [_point_nees(trial) for trial in every]
    loose = (0.25, 0.25, 0.07) if quick else None
    return rows + consistency_rows("monte_carlo", error, covariance, points, 2, loose)


def check_outliers(seed: int, quick: bool) -> list[Measurement]:
    """Half of the paths are outliers: gross errors, ours beside the reference on the same stops.

    Ours knows that walls stand at right angles; the last row shows what it makes of the stops without.
    """
    rng = np.random.default_rng(seed + 2)
    los = [solve(draw_stop(rng, CLUTTERED), RIGHT_ANGLES) for _ in range(50 if quick else 300)]
    scenarios = [draw_stop(rng, replace(CLUTTERED, has_los=False)) for _ in range(20 if quick else 200)]
    nlos = [solve(scenario, RIGHT_ANGLES) for scenario in scenarios]
    reference = max(_gross_rate([solve(scenario, REFERENCE) for scenario in scenarios]), 1e-12)
    rate, unaware = _gross_rate(nlos), _gross_rate([solve(scenario, OURS) for scenario in scenarios])
    sure = [trial for trial in [*los, *nlos] if _position_std_m(trial) < CONFIDENT_M]
    rare = 0.05 if quick else 0.01  # of 50 stops, one or two may be off by chance
    return [
        at_most("outliers50.los.gross_rate", _gross_rate(los), rare, "error > 1 m"),
        at_most("outliers50.nlos.gross_rate", rate, 0.30, "error > 1 m"),
        at_most("outliers50.nlos.gross_rate_over_reference", rate / reference, 0.5, "same stops"),
        at_most("outliers50.confident.gross_rate", _gross_rate(sure), rare, "reported sigma < 0.5 m"),
        at_most(
            "outliers50.nlos.any_building.gross_rate_over_reference",
            unaware / reference,
            0.75,
            "default settings, same stops",
        ),
    ]


def check_trajectories(seed: int, quick: bool) -> list[Measurement]:
    """Walks with 30 % outliers and a stretch without line of sight: all stops together, and stop by stop."""
    worst, square = [], np.zeros(2)
    for run in range(3 if quick else 20):
        rng = np.random.default_rng([seed, run])
        walk = draw_trajectory(rng, ScenarioConfig(n_paths=9, outlier_share=0.3), 30)
        estimates, tx = [scenario.estimate for scenario in walk], walk[0].tx
        truth = np.array([scenario.state[:2] for scenario in walk])
        poses, _, _ = run_trajectory(estimates, tx, OURS, TrajectoryConfig(), MAPPING)
        error = np.nan_to_num(np.hypot(*(poses.position_m - truth).T), nan=np.inf)
        worst.append(float(np.sqrt(np.mean(error**2))))
        alone, _ = run_slam(estimates, tx, OURS, MAPPING)
        filtered, _ = run_filter(estimates, tx, OURS, TrajectoryConfig(), MAPPING)
        solved = (alone.status != SolveStatus.FAILED) & (filtered.status != SolveStatus.FAILED)
        square += [np.sum((p.position_m - truth)[solved] ** 2) for p in (filtered, alone)]
    return [
        at_most("trajectory.outliers30.worst_rmse_m", max(worst), 0.5, "worst of the runs", "m"),
        at_most(
            "filter.outliers30.rmse_over_stops_alone", np.sqrt(square[0] / square[1]), 1.0, "the past helps"
        ),
    ]


def check_jacobians(seed: int, quick: bool) -> list[Measurement]:
    """Every model's derivative against central differences."""
    rng = np.random.default_rng(seed + 3)
    scenario = draw_stop(rng, CLEAN)
    tx, x, single = scenario.tx, scenario.state, scenario.is_single
    point = scenario.point_m[single]
    measured = predict_bounce(tx, x, point)
    covariance = np.tile(CLEAN.covariance, (len(point), 1, 1))
    wall, circle = np.array([[0.4, 9.0], [2.1, -7.0]]), np.array([3.0, -6.0, 0.4])
    cases: dict[str, tuple[Callable[[FloatArray], FloatArray], FloatArray, FloatArray]] = {
        "bounce_state": (lambda s: predict_bounce(tx, s, point), x, bounce_jacobian_rx(tx, x, point)),
        "bounce_point": (
            lambda q: predict_bounce(tx, x, q),
            point[0],
            bounce_jacobian_point(tx, x, point[0]),
        ),
        "los_state": (lambda s: predict_los(tx, s), x, los_jacobian_rx(tx, x)),
        "equation_state": (
            lambda s: bounce_terms(tx, measured, covariance, s).value_m,
            x,
            bounce_terms(tx, measured, covariance, x).jacobian,
        ),
        "wall_state": (
            lambda s: predict_walls(tx, s, wall[:1]).value,
            x,
            predict_walls(tx, x, wall[:1]).by_state,
        ),
        "wall_line": (
            lambda w: predict_walls(tx, x, w.reshape(1, 2)).value,
            wall[0],
            predict_walls(tx, x, wall[:1]).by_landmark,
        ),
        "double_state": (lambda s: predict_walls(tx, s, wall).value, x, predict_walls(tx, x, wall).by_state),
        "double_lines": (
            lambda w: predict_walls(tx, x, w.reshape(2, 2)).value,
            wall.ravel(),
            predict_walls(tx, x, wall).by_landmark,
        ),
        "circle_state": (
            lambda s: predict_circle(tx, s, circle).value,
            x,
            predict_circle(tx, x, circle).by_state,
        ),
        "circle": (
            lambda c: predict_circle(tx, x, c).value,
            circle,
            predict_circle(tx, x, circle).by_landmark,
        ),
    }
    return [
        at_most(f"jacobian.{name}", derivative_error(*case, _unwrapped), 1e-6, "central differences")
        for name, case in cases.items()
    ]


def _unwrapped(ahead: FloatArray, behind: FloatArray) -> FloatArray:
    """Difference of measurements with the angles unwrapped; of anything else as it is."""
    is_measurement = ahead.shape[-1] == 3 and ahead.ndim < 3
    return residual(ahead, behind) if is_measurement else ahead - behind


def _point_nees(trial: SnapshotTrial) -> FloatArray:
    """Squared Mahalanobis error (ip,) of the IPs taken for single bounces that are."""
    solution = trial.solution
    if solution.status == SolveStatus.FAILED:
        return np.zeros(0)
    estimate = trial.scenario.estimate
    points = map_stops(
        [estimate],
        replace(collect_poses([solution]), stop=np.array([estimate.stop])),
        trial.scenario.tx,
        MAPPING,
        is_los=[solution.is_los],
        is_inlier=[solution.is_inlier],
        state_covariance=[solution.covariance],
    )
    right: BoolArray = points.is_inlier & trial.scenario.is_single[points.path]
    error = points.position_m[right] - trial.scenario.point_m[points.path[right]]
    return squared_mahalanobis(error, points.covariance_m2[right])


def _gross_rate(trials: list[SnapshotTrial]) -> float:
    return float(np.mean([trial.distance_m > GROSS_M for trial in trials])) if trials else np.nan


def _position_std_m(trial: SnapshotTrial) -> float:
    """Standard deviation of the position over all ranked modes, weighed by their evidence."""
    solution = trial.solution
    if solution.status == SolveStatus.FAILED:
        return np.inf
    weight = softmax(solution.mode_log_evidence)
    place = solution.mode_state[:, :2]
    inside = np.trace(solution.mode_covariance[:, :2, :2], axis1=1, axis2=2)
    apart = np.sum((place - weight @ place) ** 2, axis=1)
    return float(np.sqrt(weight @ (inside + apart)))
