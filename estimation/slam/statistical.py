"""Snapshot SLAM with closed-form headings and modes ranked by evidence.

Where the reference searches headings on a grid, gates by distance and weighs by power, here four single bounces
give the heading in closed form, hypotheses are refined under the covariances of all paths, and the modes they
lead to are ranked by their evidence: with every credible path as line of sight, and without one.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.stats import chi2

from estimation.slam.config import SnapshotConfig
from estimation.slam.evidence import log_clutter, log_evidence
from estimation.slam.hypotheses import distinct, four_bounce_states, line_of_sight_states
from estimation.slam.likelihood import log_likelihood
from estimation.slam.path_table import PathTable, line_of_sight, path_model, path_table
from estimation.slam.problem import Fit, SnapshotProblem
from estimation.slam.refine import refine
from scenes.pose import wrap_angle
from scenes.record import FloatArray, IntArray

_SAME_DELAY_STDS = 3.0
# A hypothesis this much less likely than the best one does not refine to a mode that counts.
_MAX_DEFICIT = 15.0


def solve_statistical(problem: SnapshotProblem, config: SnapshotConfig) -> list[Fit]:
    """Distinct modes by falling evidence; none where no hypothesis gathers enough inliers.

    `cost` of a mode is minus its log evidence.
    """
    table = path_table(problem, config.mixture)
    clutter = log_clutter(problem, config)
    fits: list[Fit] = []
    for los in (*los_candidates(problem).tolist(), -1):
        fits += _modes(problem, table, los, clutter, config)
    states, evidence = np.array([fit.state for fit in fits]).reshape(-1, 4), np.array([-f.cost for f in fits])
    # A line of sight explains the same state once more as a bounce: that is no second mode.
    return [fits[k] for k in distinct(states, evidence, config.n_ranked, np.inf)]


def los_candidates(problem: SnapshotProblem) -> IntArray:
    """Paths that may be the line of sight: all that come as early as the first within errors, and the strongest.

    A bounce close to the line of sight may come first by chance, a false path well before it.
    """
    if len(problem) < 2:
        return np.empty(0, np.int64)
    variance, first = problem.covariance[:, 0, 0], problem.earliest
    later = problem.measured[:, 0] - problem.measured[first, 0]
    credible = later <= _SAME_DELAY_STDS * np.sqrt(variance + variance[first])
    credible[np.argmax(problem.power_dbm)] = True
    return np.flatnonzero(credible)


def _modes(
    problem: SnapshotProblem, table: PathTable, los: int, clutter: float, config: SnapshotConfig
) -> list[Fit]:
    """Refined modes with the path `los` as line of sight, -1 for none, that enough paths agree with.

    Clutter alone, of log evidence `clutter`, must be a worse explanation.
    """
    start = _hypotheses(problem, table, los, config)
    if not len(start):
        return []
    model, direct = path_model(config.mixture), line_of_sight(problem, los)
    score = log_likelihood(table, direct, model, start)
    first = distinct(start, score, config.n_modes, _MAX_DEFICIT)
    refined = refine(problem, table, los, start[first], config)
    is_los = np.arange(len(problem)) == los
    inlier = is_los | (refined.square <= _gate(config.gate_probability))
    least = config.min_los_inliers if los >= 0 else config.min_nlos_inliers
    enough = np.count_nonzero(inlier, axis=1) >= least
    if not enough.any():
        return []
    evidence, covariance = log_evidence(problem, los, refined, config)
    state = refined.state
    state[:, :2] += problem.tx.position_m[:2]
    state[:, 2] = wrap_angle(state[:, 2])
    return [
        Fit(state[k], inlier[k], is_los, float(-evidence[k]), covariance[k])
        for k in np.flatnonzero(enough & (evidence > clutter))
    ]


@cache
def _gate(probability: float) -> float:
    return float(chi2.ppf(probability, 1))


def _hypotheses(problem: SnapshotProblem, table: PathTable, los: int, config: SnapshotConfig) -> FloatArray:
    """States (hypothesis, 4), from the TX, of every minimal set of the strongest paths."""
    candidates = problem.strongest(config.max_hypothesis_paths)
    if los < 0:
        return four_bounce_states(table, candidates)
    angles = np.array([problem.departure_rad[los], problem.measured[los, 2]])
    return line_of_sight_states(table, los, angles, candidates[candidates != los])
