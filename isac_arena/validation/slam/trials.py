"""What the checks of SLAM in the plane and in space share: settings, solved stops, and derivatives."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimation.slam.bounds import StopPaths, stop_bound
from estimation.slam.config import MappingConfig, Mixture, PathNoise, SnapshotConfig
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.record import IncidencePoints, SolveStatus
from estimation.slam.snapshot.solution import SnapshotSolution, collect_poses
from estimation.slam.snapshot.solve import solve_snapshot
from estimation.slam.space.bounds import SpatialPaths, spatial_bound
from estimation.slam.space.mapping import map_stops_spatial
from estimation.slam.space.snapshot import solve_spatial
from isac_arena.scoring.metrics.statistics import squared_mahalanobis
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.scenarios.halls import ScenarioConfig
from isac_arena.validation.scenarios.stops import Scenario
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from scenes.record import FloatArray

NOISE = PathNoise(floor_delay_std_ns=0.0, floor_angle_std_deg=0.0)  # what is drawn, and nothing else
OURS = SnapshotConfig(method="statistical", noise=NOISE)
# Gaussian errors and no clutter: a heavy-tailed model gives some efficiency away.
MATCHED = OURS.model_copy(
    update={"mixture": Mixture(clutter_share=0.005, double_share=0.005, degrees_of_freedom=1000)}
)
MAPPING = MappingConfig(noise=NOISE)
CLEAN = ScenarioConfig()
# Errors so small that the model is linear within them.
GAUSSIAN = ScenarioConfig(delay_std_ns=0.3, angle_std_deg=0.3)
MAX_PEB_M = 0.5  # beyond it the geometry, not the solver, decides

Case = tuple[Callable[[FloatArray], FloatArray], FloatArray, FloatArray]  # model, where, its derivative there


@dataclass(frozen=True)
class SnapshotTrial:
    """One solved stop: its error (4,) in (m, m, rad, m), or (5,) in (m, m, m, rad, m), and its covariance."""

    scenario: Scenario
    solution: SnapshotSolution
    error: FloatArray
    covariance: FloatArray

    @property
    def n_coordinates(self) -> int:
        """2 in the plane, 3 in space."""
        return len(self.error) - 2

    @property
    def distance_m(self) -> float:
        """Position error in m; infinite where the stop was not solved."""
        return float(np.nan_to_num(np.linalg.norm(self.error[: self.n_coordinates]), nan=np.inf))

    @property
    def peb_m(self) -> float:
        """Bound of the position from the true single bounces and the line of sight."""
        scenario, in_seconds = self.scenario, self.scenario.estimate.covariance
        to_metres = _to_metres(in_seconds.shape[-1], 0)
        covariance = in_seconds * np.outer(to_metres, to_metres)
        los = next(iter(covariance[scenario.is_los]), None)
        points, paths = scenario.point_m[scenario.is_single], covariance[scenario.is_single]
        tx, state = scenario.tx, scenario.state
        if self.n_coordinates == 3:
            return spatial_bound(tx, state, SpatialPaths(points, paths, los))[0].position_m
        no_walls = np.full(len(points), -1)
        return float(stop_bound(tx, state, StopPaths(points, paths, no_walls, los))[0].position_m)

    @property
    def point_nees(self) -> FloatArray:
        """Squared Mahalanobis error (ip,) of the IPs of true single bounces that the solver accepts."""
        if self.solution.status == SolveStatus.FAILED:
            return np.zeros(0)
        estimate, in_space = self.scenario.estimate, self.n_coordinates == 3
        points = (map_stops_spatial if in_space else map_stops)(
            [estimate],
            replace(collect_poses([self.solution]), stop=np.array([estimate.stop])),
            self.scenario.tx,
            MAPPING,
            is_los=[self.solution.is_los],
            is_inlier=[self.solution.is_inlier],
            state_covariance=[self.solution.covariance],
        )
        position, covariance = _in_space(points) if in_space else (points.position_m, points.covariance_m2)
        right = points.is_inlier & self.scenario.is_single[points.path]
        error = position[right] - self.scenario.point_m[points.path[right]]
        return squared_mahalanobis(error, covariance[right])


def solve(scenario: Scenario, config: SnapshotConfig) -> SnapshotTrial:
    """Solve a made stop, in space where its state has a height."""
    state = scenario.state
    solution = (solve_spatial if len(state) == 5 else solve_snapshot)(scenario.estimate, scenario.tx, config)
    bias_m = SPEED_OF_LIGHT_M_S * solution.clock_bias_s
    error = np.array([*solution.position_m, solution.heading_rad, bias_m]) - state
    error[-2] = wrap_angle(error[-2])
    to_metres = _to_metres(len(state), -1)
    return SnapshotTrial(scenario, solution, error, solution.covariance * np.outer(to_metres, to_metres))


def jacobian_rows(prefix: str, cases: Mapping[str, Case]) -> list[Measurement]:
    """Largest deviation of every derivative (..., n) from central differences over its model."""
    reason = "central differences are exact to rounding"
    return [at_most(f"{prefix}.{name}", _derivative_error(*case), 1e-6, reason) for name, case in cases.items()]


def _derivative_error(model: Callable[[FloatArray], FloatArray], at: FloatArray, derivative: FloatArray) -> float:
    step, columns = 1e-5, []
    for change in step * np.eye(len(at)):
        difference = model(at + change) - model(at - change)
        if difference.shape[-1] == 5 or (difference.shape[-1] == 3 and difference.ndim < 3):  # a measurement
            difference[..., 1:3] = wrap_angle(difference[..., 1:3])
        columns.append(difference / (2 * step))
    return float(np.abs(np.stack(columns, axis=-1) - derivative).max())


def _to_metres(size: int, time: int) -> FloatArray:
    """Factors (size,) that turn seconds, at index `time`, into metres."""
    factor = np.ones(size)
    factor[time] = SPEED_OF_LIGHT_M_S
    return factor


def _in_space(points: IncidencePoints) -> tuple[FloatArray, FloatArray]:
    """Positions (ip, xyz) and covariances (ip, 3, 3) of IPs with heights."""
    covariance = np.zeros((len(points), 3, 3))
    covariance[:, :2, :2] = points.covariance_m2
    covariance[:, 2], covariance[:, :, 2] = points.height_covariance_m2, points.height_covariance_m2
    return np.column_stack([points.position_m, points.height_m]), covariance
