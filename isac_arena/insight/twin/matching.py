"""Assignment of simulated paths to measured ones: one to one, within gates."""

import numpy as np
from scipy.optimize import linear_sum_assignment

from scenes.pose import wrap_angle
from scenes.record import FloatArray, IntArray

# Largest differences of delay, departure and arrival in s, rad, rad.
WIDE_GATE = np.array([1.5e-9, np.deg2rad(3.0), np.deg2rad(3.0)])
NARROW_GATE = np.array([1.0e-9, np.deg2rad(2.0), np.deg2rad(2.0)])


def differences(measured: FloatArray, simulated: FloatArray) -> FloatArray:
    """Measured minus simulated (path, candidate, 3) of paths (path, 3) and candidates (candidate, 3).

    The columns are delay in s, azimuth of departure and of arrival in rad; angles are wrapped.
    """
    difference: FloatArray = np.asarray(measured, float)[:, None] - np.asarray(simulated, float)[None]
    difference[..., 1:] = wrap_angle(difference[..., 1:])
    return difference


def assign(difference: FloatArray, gate: FloatArray) -> IntArray:
    """Candidate (path,) that explains each path, -1 for none.

    A candidate explains at most one path, and only where all three differences (path, candidate, 3) lie within the
    gate (3,). The assignment explains as many paths as possible; among such assignments it has the least sum of
    squared differences in units of the gate (Hungarian method).
    """
    inside = np.asarray((np.abs(difference) <= gate).all(axis=2))
    none_costs = 3.0 * (len(difference) + 1)  # more than all pairs within the gate together
    cost = np.where(inside, ((difference / gate) ** 2).sum(axis=2), none_costs)
    path, candidate = linear_sum_assignment(cost)
    found = np.full(len(difference), -1)
    explained = inside[path, candidate]
    found[path[explained]] = candidate[explained]
    return found
