"""Terms of one TX in the likelihood of a state that several TX share; compiled."""

from typing import NamedTuple

import numpy as np

from estimation.execution import compiled
from estimation.slam.snapshot.likelihood import (
    N_COLUMNS,
    derivatives,
    direct_residual,
    evaluate,
    fisher,
    log_gain,
    square_of,
)
from estimation.slam.snapshot.path_table import LineOfSight, PathModel, PathTable
from scenes.record import FloatArray


class TxTerms(NamedTuple):
    """Log-likelihood of the paths of one TX and its derivatives by [x, y, heading, bias]."""

    log_likelihood: float
    gradient: FloatArray  # (4,) of minus the log-likelihood
    curvature: FloatArray  # (4, 4) the positive part of its second derivative
    information: FloatArray  # (4, 4) under Gaussian errors
    square: FloatArray  # (path,) squared residuals over their variances; inf where no single bounce


@compiled
def gain_between(
    paths: PathTable, los: LineOfSight, model: PathModel, fixed: FloatArray, state: FloatArray
) -> float:
    """Log-likelihood at a state (4,) with the variances of the residuals at the state `fixed` (4,)."""
    before, now = np.empty((len(paths.range_m), N_COLUMNS)), np.empty((len(paths.range_m), N_COLUMNS))
    evaluate(paths, los, model, fixed, before)
    evaluate(paths, los, model, state, now)
    direct, slope = np.zeros(3), np.zeros((3, 4))
    direct_residual(los, state, direct, slope)
    return log_gain(paths, before, now, model) - 0.5 * square_of(direct)


@compiled
def terms_at(
    paths: PathTable, los: LineOfSight, model: PathModel, state: FloatArray
) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The fields of `TxTerms` at a state (4,) relative to the TX."""
    n = len(paths.range_m)
    work, direct, slope = np.empty((n, N_COLUMNS)), np.zeros(3), np.zeros((3, 4))
    newton, gauss, gradient, information = np.empty((4, 4)), np.empty((4, 4)), np.empty(4), np.zeros((4, 4))
    evaluate(paths, los, model, state, work)
    direct_residual(los, state, direct, slope)
    cost = derivatives(paths, work, model, direct, slope, newton, gauss, gradient)
    for a in range(4):
        for b in range(a):
            gauss[b, a] = gauss[a, b]
    fisher(paths, work, model, slope, information)
    square = np.full(n, np.inf)
    for j in range(n):
        if work[j, 2] > 0.0:
            square[j] = work[j, 0] ** 2 / work[j, 1] * model.degrees_of_freedom
    return -cost, gradient, gauss, information, square
