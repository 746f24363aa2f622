"""What the checks of SLAM in the plane and in space share: settings, derivatives and consistency rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import chi2

from estimation.slam.config import MappingConfig, Mixture, PathNoise, SnapshotConfig
from estimation.slam.snapshot.solution import SnapshotSolution
from isac_arena.scoring.metrics.statistics import squared_mahalanobis
from isac_arena.validation.measurement import Measurement, at_most
from isac_arena.validation.scenarios.halls import ScenarioConfig
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


def solution_error(solution: SnapshotSolution, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Error (state,) and covariance (state, state) of a solution in m and rad; `state` (state,) is the truth."""
    bias_m = SPEED_OF_LIGHT_M_S * solution.clock_bias_s
    error = np.array([*solution.position_m, solution.heading_rad, bias_m]) - state
    error[-2] = wrap_angle(error[-2])
    to_metres = np.append(np.ones(len(state) - 1), SPEED_OF_LIGHT_M_S)
    return error, solution.covariance * np.outer(to_metres, to_metres)


def derivative_error(
    model: Callable[[FloatArray], FloatArray],
    at: FloatArray,
    derivative: FloatArray,
    residual: Callable[[FloatArray, FloatArray], FloatArray] = np.subtract,
    step: float = 1e-5,
) -> float:
    """Largest deviation of a derivative (..., n) from central differences; `residual` unwraps angles."""
    columns = []
    for change in step * np.eye(len(at)):
        columns.append(residual(model(at + change), model(at - change)) / (2 * step))
    return float(np.abs(np.stack(columns, axis=-1) - derivative).max())


def consistency_rows(
    prefix: str,
    error: FloatArray,
    covariance: FloatArray,
    point_nees: Sequence[FloatArray],
    n_point: int,
    loose: tuple[float, float, float] | None,
) -> list[Measurement]:
    """NEES and coverage of states (trial, state), and NEES of incidence points of `n_point` coordinates.

    `loose` are the bars of a quick run: a hundred trials scatter, NEES by 7 % and coverage by 2 %.
    """
    nees = squared_mahalanobis(error, covariance)
    size = error.shape[1]
    state, point = float(np.nanmean(nees)) / size, float(np.nanmean(np.concatenate(point_nees))) / n_point
    cover = float(np.mean(nees <= chi2.ppf(0.95, size)))
    bars = loose or (0.05, 0.05, 0.01)
    return [
        at_most(f"{prefix}.nees_pose_deviation", abs(state - 1), bars[0], f"NEES {state:.3f}"),
        at_most(f"{prefix}.nees_ip_deviation", abs(point - 1), bars[1], f"NEES {point:.3f}"),
        at_most(f"{prefix}.coverage95_deviation", abs(cover - 0.95), bars[2], f"{cover:.3f}"),
    ]
