"""Snapshot SLAM with closed-form headings and modes ranked by evidence.

Four single bounces give the heading in closed form (the reference searches a grid). Hypotheses are refined under
the covariances of all paths (the reference gates by distance and weights by power). The modes are ranked by
evidence: with every credible path as line of sight, and without one.
"""

from functools import cache

import numpy as np

from estimation.distributions import chi_square_quantile
from estimation.execution import compiled
from estimation.slam.config import SnapshotConfig
from estimation.slam.snapshot.evidence import (
    PowerLaw,
    SnapshotPrior,
    log_clutter,
    log_evidence,
    power_law,
    prior_of,
)
from estimation.slam.snapshot.hypotheses import distinct_states, four_bounce_states, line_of_sight_states
from estimation.slam.snapshot.likelihood import MAX_ITERATIONS, log_likelihood, refine_states
from estimation.slam.snapshot.path_table import LineOfSight, PathModel, PathTable, path_model, path_table
from estimation.slam.snapshot.problem import (
    MIN_LOS_INLIERS,
    MIN_NLOS_INLIERS,
    Fit,
    SnapshotProblem,
    tied_with_first,
)
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

N_REFINED = 8  # hypotheses that are refined, with each line of sight
N_RANKED = 6  # modes that are kept
# Log-likelihood below the best hypothesis from which a hypothesis is not refined.
_MAX_DEFICIT = 15.0


def solve_statistical(problem: SnapshotProblem, config: SnapshotConfig) -> list[Fit]:
    """Distinct modes by falling evidence; none where no hypothesis has enough inliers.

    `cost` of a mode is minus its log evidence.
    """
    if not len(problem):
        return []
    state, covariance, evidence, inlier, los = _ranked(
        path_table(problem, config.mixture),
        np.column_stack([problem.measured[:, 0], problem.departure_rad, problem.measured[:, 2]]),
        problem.power_dbm,
        np.append(los_candidates(problem), -1),
        problem.strongest,
        path_model(config.mixture),
        power_law(config.path_loss),
        prior_of(config),
        _gate(config.gate_probability),
    )
    state[:, :2] += problem.tx.position_m[:2]
    state[:, 2] = wrap_angle(state[:, 2])
    number = np.arange(len(problem))
    return [
        Fit(state[k], inlier[k], number == los[k], float(-evidence[k]), covariance[k]) for k in range(len(state))
    ]


def los_candidates(problem: SnapshotProblem) -> IntArray:
    """Paths that may be the line of sight: those as early as the first within errors, and the strongest.

    A false path may arrive long before it.
    """
    if len(problem) < 2:
        return np.empty(0, np.int64)
    credible = tied_with_first(problem.measured[:, 0], problem.covariance[:, 0, 0])
    credible[np.argmax(problem.power_dbm)] = True
    return np.flatnonzero(credible)


@compiled
def _ranked(
    paths: PathTable,
    measured: FloatArray,
    power_dbm: FloatArray,
    lines: IntArray,
    strongest: IntArray,
    model: PathModel,
    law: PowerLaw,
    prior: SnapshotPrior,
    gate: float,
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray, IntArray]:
    """Modes with each of `lines` as line of sight, -1 for none, that have enough inliers, the best first.

    Their evidence must exceed that of clutter alone. `measured` (path, 3) holds world departures. Returns states
    (mode, 4) from the TX, covariances (mode, 4, 4), log evidences (mode,), inliers (mode, path) and lines of
    sight (mode,).
    """
    n, most = len(power_dbm), len(lines) * N_REFINED
    state, covariance = np.empty((most, 4)), np.empty((most, 4, 4))
    evidence, inlier, los = np.empty(most), np.zeros((most, n), np.bool_), np.empty(most, np.int64)
    clutter, found = log_clutter(paths.range_m, power_dbm, law, prior), 0
    for line in lines:
        direct, least = LineOfSight(-1, np.zeros(3), np.zeros((3, 3))), MIN_NLOS_INLIERS
        if line >= 0:
            whitening = np.ascontiguousarray(np.linalg.inv(np.linalg.cholesky(paths.covariance[line])))
            direct, least = LineOfSight(line, measured[line], whitening), MIN_LOS_INLIERS
            start = line_of_sight_states(paths, line, measured[line, 1:], strongest[strongest != line])
        else:
            start = four_bounce_states(paths, strongest)
        score = log_likelihood(paths, direct, model, start)
        first = distinct_states(start, score, N_REFINED, _MAX_DEFICIT)
        refined, information, likelihood, square = refine_states(
            paths, direct, model, start[first], MAX_ITERATIONS
        )
        for k in range(len(first)):
            inlier[found] = square[k] <= gate
            if line >= 0:
                inlier[found, line] = True
            if np.sum(inlier[found]) < least or abs(refined[k, 3]) > prior.max_clock_m:
                continue
            evidence[found], covariance[found] = log_evidence(
                paths.range_m, power_dbm, line, paths.covariance[line], refined[k], information[k],
                likelihood[k], law, prior,
            )  # fmt: skip
            if evidence[found] > clutter:
                state[found], los[found] = refined[k], line
                found += 1
    # The same state with the line of sight as a single bounce is not a second mode.
    kept = distinct_states(state[:found], evidence[:found], N_RANKED, np.inf)
    return state[kept], covariance[kept], evidence[kept], inlier[kept], los[kept]


@cache
def _gate(probability: float) -> float:
    return float(chi_square_quantile(probability, 1))
