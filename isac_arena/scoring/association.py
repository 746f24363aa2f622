"""Assignment of estimated paths to true paths: one to one, optimal, within a gate.

Parameters are (delay in s, AoD in rad, AoA in rad) and, where elevations were estimated, those of departure and
arrival in rad: `parameter` is 3 or 5. A parameter that is unknown is NaN and in no error.
"""

from dataclasses import dataclass

import numpy as np

from estimation.channel.record import MIN_PARAMETERS, ChannelEstimate
from isac_arena.scoring.config import Gate
from isac_arena.scoring.metrics.sets import Gospa, gospa
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

STATED_DEVIATIONS = 3.0  # an elevation may err by so many of those that it states: few rows show it coarsely


def reported_elevations(estimate: ChannelEstimate) -> tuple[FloatArray, FloatArray]:
    """Elevations (path, 2) of departure and arrival in rad and their deviations, NaN where they state none."""
    std = np.full((len(estimate), 2), np.nan)
    own = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2)[:, MIN_PARAMETERS:])
    std[:, : own.shape[1]] = np.where(np.isfinite(own), own, np.nan)
    elevation = np.stack([estimate.aod_elevation_rad, estimate.aoa_elevation_rad], axis=1)
    return np.where(np.isfinite(std), elevation, np.nan), std


@dataclass(frozen=True)
class GatedPaths:
    """Estimated paths as the assignment takes them."""

    parameters: FloatArray  # (path, parameter)
    half_width: FloatArray  # (path, parameter) of the gate around each
    gate: FloatArray  # (parameter,) half-widths of the gate around true paths

    def take(self, rows: IntArray | BoolArray) -> "GatedPaths":
        """Some of the paths."""
        return GatedPaths(self.parameters[rows], self.half_width[rows], self.gate)


def gated_paths(estimate: ChannelEstimate, gate: Gate) -> GatedPaths:
    """The estimated paths with their gates; in space where any elevation has a stated deviation.

    The gate of an elevation is not narrower than `STATED_DEVIATIONS`: an elevation that states nothing counts as
    one that is not reported.
    """
    plane = estimate.plane_parameters
    elevation, std = reported_elevations(estimate)
    if not np.isfinite(elevation).any():
        return GatedPaths(plane, np.tile(gate.half_width, (len(plane), 1)), gate.half_width)
    half_width = np.tile(gate.half_width_in_space, (len(plane), 1))
    half_width[:, MIN_PARAMETERS:] = np.fmax(half_width[:, MIN_PARAMETERS:], STATED_DEVIATIONS * std)
    return GatedPaths(np.column_stack([plane, elevation]), half_width, gate.half_width_in_space)


def parameter_errors(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Estimate minus truth (..., parameter), the angles wrapped."""
    error = np.asarray(estimate - truth)
    error[..., 1:] = wrap_angle(error[..., 1:])
    return error


def inside_gate(error: FloatArray, half_width: FloatArray) -> BoolArray:
    """Whether all known errors (..., parameter) are within the half-widths (..., parameter) of the gate."""
    return np.asarray(~(np.abs(error) > half_width).any(axis=-1))


def assign(
    estimate: FloatArray, truth: FloatArray, half_width: FloatArray, possible: BoolArray | None = None
) -> IntArray:
    """Index (estimate,) of the true path assigned to each estimate, -1 for none.

    The assignment minimises the sum over all pairs of min(d, sqrt(parameters)), where d is the error in units of
    the gate of `half_width` ((estimate,) parameter). A pair outside the gate costs as much as a pair at its corner
    and is not assigned; nor is one that is not `possible` (estimate, true), by default all are. The distance
    counts, not its square: squares would rather have several poor pairs than a good one and an estimate without a
    path.
    """
    error = parameter_errors(estimate[:, None], truth[None])
    if possible is not None:
        error[~possible] = np.inf
    corner = float(np.sqrt(error.shape[-1]))
    return assign_by_error(error, _of_pairs(half_width), corner)


def assign_by_error(error: FloatArray, half_width: FloatArray, unassigned_cost: float) -> IntArray:
    """Column (row,) assigned to each row, -1 for none, of the least total cost (Hungarian method).

    The errors (row, column, parameter) of a pair have to lie within `half_width`, which has these axes or the last
    of them. The cost of such a pair is the norm of its error in units of that, and the cost of any other pair is
    `unassigned_cost`.
    """
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415  (slow to import)

    inside = inside_gate(error, half_width)
    known = np.where(np.isnan(error), 0.0, error)
    cost = np.where(inside, np.linalg.norm(known / half_width, axis=-1), unassigned_cost)
    rows, columns = linear_sum_assignment(cost)
    matched = inside[rows, columns]
    result = np.full(len(error), -1)
    result[rows[matched]] = columns[matched]
    return result


def gates_off(estimate: FloatArray, truth: FloatArray, half_width: FloatArray) -> FloatArray:
    """Largest of the known errors (estimate, true) in units of the gate: 1 at its edge."""
    error = parameter_errors(estimate[:, None], truth[None])
    return np.asarray(np.fmax.reduce(np.abs(error / _of_pairs(half_width)), axis=2))


def path_gospa(estimate: FloatArray, truth: FloatArray, half_width: FloatArray) -> Gospa:
    """GOSPA of estimated (estimate, parameter) and true paths (true, parameter), cutoff 1.

    The base distance is the root mean square of the known errors in units of the gate.
    """
    error = parameter_errors(estimate[:, None], truth[None]) / _of_pairs(half_width)
    return gospa(np.sqrt(np.nanmean(np.square(error), axis=-1)), 1.0)


def _of_pairs(half_width: FloatArray) -> FloatArray:
    """Half-widths of all pairs (estimate or 1, 1, parameter) from those of estimates, or of all alike."""
    return half_width.reshape(-1, 1, half_width.shape[-1])
