"""Assignment of estimated paths to true paths: one to one, optimal, within a gate."""

import numpy as np

from isac_arena.scoring.config import Gate
from isac_arena.scoring.metrics.sets import Gospa, gospa
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray


def parameter_errors(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Estimate minus truth (..., 3) of (delay in s, AoD in rad, AoA in rad), the angles wrapped."""
    error = np.asarray(estimate - truth)
    error[..., 1:] = wrap_angle(error[..., 1:])
    return error


def inside_gate(error: FloatArray, gate: Gate) -> BoolArray:
    """Whether all three errors (..., 3) are within the gate."""
    return np.asarray((np.abs(error) <= gate.half_width).all(axis=-1))


def assign(estimate: FloatArray, truth: FloatArray, gate: Gate, possible: BoolArray | None = None) -> IntArray:
    """Index (estimate,) of the true path assigned to each estimate, -1 for none.

    The assignment minimises the sum over all pairs of min(d, sqrt(3)), where d is the error in units of the gate.
    A pair outside the gate costs as much as a pair at its corner and is not assigned; nor is one that is not
    `possible` (estimate, true), by default all are. The distance counts, not its square: squares would rather have
    several poor pairs than a good one and an estimate without a path.
    """
    error = parameter_errors(estimate[:, None], truth[None])
    if possible is not None:
        error[~possible] = np.inf
    return assign_by_error(error, gate.half_width, np.sqrt(3.0))


def assign_by_error(error: FloatArray, half_width: FloatArray, unassigned_cost: float) -> IntArray:
    """Column (row,) assigned to each row, -1 for none, of the least total cost (Hungarian method).

    The errors (row, column, 3) of a pair have to lie within `half_width` (3,). The cost of such a pair is the norm
    of its error in units of that, and the cost of any other pair is `unassigned_cost`.
    """
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415  (slow to import)

    inside = np.asarray((np.abs(error) <= half_width).all(axis=-1))
    cost = np.where(inside, np.linalg.norm(error / half_width, axis=-1), unassigned_cost)
    rows, columns = linear_sum_assignment(cost)
    matched = inside[rows, columns]
    result = np.full(len(error), -1)
    result[rows[matched]] = columns[matched]
    return result


def path_gospa(estimate: FloatArray, truth: FloatArray, gate: Gate) -> Gospa:
    """GOSPA of estimated (estimate, 3) and true paths (true, 3) in (s, rad, rad), cutoff 1.

    The base distance is the root mean square of the three errors in units of the gate.
    """
    error = parameter_errors(estimate[:, None], truth[None]) / gate.half_width
    return gospa(np.sqrt(np.square(error).mean(axis=-1)), 1.0)
