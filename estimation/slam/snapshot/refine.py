"""Maximum-likelihood refinement of RX states with the IPs eliminated.

The likelihood and its maximisation are compiled (`estimation.slam.snapshot.likelihood`). `bounce_terms` is the
residual of single bounces, for arrays of paths.
"""

from dataclasses import dataclass

import numpy as np

from estimation.laws.plane import FEASIBLE_STDS, bounce_gap
from estimation.slam.config import SnapshotConfig
from estimation.slam.snapshot.likelihood import MAX_ITERATIONS, refine_states
from estimation.slam.snapshot.path_table import line_of_sight, path_model, path_table
from estimation.slam.snapshot.problem import SnapshotProblem
from scenes.pose import Pose
from scenes.record import BoolArray, FloatArray

_NO_CLUTTER = 1e-12  # share that keeps logarithms finite where every path counts


@dataclass(frozen=True)
class BounceResidual:
    """Residuals of paths as single bounces."""

    value_m: FloatArray  # (...)
    variance_m2: FloatArray  # (...)
    jacobian: FloatArray  # (..., 4), per [x, y, heading, bias]
    by_measurement: FloatArray  # (..., 3), per [range, departure, arrival]
    is_feasible: BoolArray  # (...): the IP is between the devices' rays

    def excess_m(self, further_m2: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """By how much the paths (...) are too long, and standard deviations; `further_m2` adds to the variance."""
        by_range = self.by_measurement[..., 0]
        return self.value_m / by_range, np.sqrt(self.variance_m2 + further_m2) / np.abs(by_range)


def refine_members(
    problem: SnapshotProblem, los: int, start: FloatArray, config: SnapshotConfig
) -> tuple[FloatArray, FloatArray]:
    """State (4,) and covariance (4, 4) where every path is a single bounce except `los`, -1 for none."""
    mixture = config.mixture.model_copy(update={"clutter_share": _NO_CLUTTER, "double_share": 0.0})
    direct = line_of_sight(problem, los)
    state, information, _, _ = refine_states(
        path_table(problem, mixture), direct, path_model(mixture), start[None], MAX_ITERATIONS
    )
    return state[0], np.linalg.inv(information[0] + np.diag(config.prior_std**-2.0))


def bounce_terms(
    tx: Pose | FloatArray, measured: FloatArray, covariance: FloatArray, state: FloatArray
) -> BounceResidual:
    """Residual of the bounce equation, its variance and Jacobian; paths (..., 3) and states (..., 4) broadcast.

    `tx` is one TX, or rows (..., 3) of x, y and heading.

    A bounce is feasible where its IP is between the devices' rays, up to two standard deviations of the angles:
    nearly opposite rays, as at the line of sight or just behind an obstacle, do not fix the IP along them.
    """
    value, by_state, by_measurement, place = bounce_gap(tx, state, measured)
    variance = np.einsum("...i,...ij,...j->...", by_measurement, covariance, by_measurement)
    length = measured[..., 0] - state[..., 3]
    angle_std = np.sqrt(covariance[..., 1, 1] + covariance[..., 2, 2])
    slack = FEASIBLE_STDS * angle_std * length * np.abs(by_state[..., 3])
    feasible = (length > 0) & (np.abs(place[..., 0]) <= np.abs(place[..., 1]) + slack)
    return BounceResidual(value, np.maximum(variance, 1e-18), by_state, by_measurement, feasible)
