"""Snapshot SLAM with closed-form headings and statistical gates.

Where the reference searches headings on a grid, gates by distance and weighs by power, here four single bounces
give the heading in closed form, and hypotheses are ranked by the evidence of all paths under their covariances.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from estimation.geometry import bounce_equation
from estimation.slam.config import SnapshotConfig
from estimation.slam.problem import Fit, SnapshotProblem, packed_normal, solve_packed, subsets
from estimation.slam.reference import los_equations, los_heading
from estimation.slam.refine import bounce_residual, log_likelihood, refine
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

# Two states this close in position (m) and heading (rad) are one mode.
_MODE_DISTANCE_M = 0.3
_MODE_HEADING_RAD = np.deg2rad(5.0)


def solve_statistical(problem: SnapshotProblem, config: SnapshotConfig, with_los: bool) -> list[Fit]:
    """Distinct modes by falling evidence; none where no hypothesis gathers enough inliers.

    `cost` of a mode is minus its log evidence; `evidence_gap` is left infinite.
    """
    is_los = np.zeros(len(problem), bool)
    is_los[problem.earliest] = with_los
    states = los_hypotheses(problem, config) if with_los else nlos_hypotheses(problem, config)
    if not len(states):
        return []
    score = log_likelihood(problem, states, is_los, config.mixture)
    modes = states[distinct(states, score, config.n_modes)]
    refined = refine(problem, modes, is_los, config.mixture, config.max_iterations)
    inlier = is_los | _gated(problem, refined.state, config)
    enough = config.min_los_inliers if with_los else config.min_nlos_inliers
    evidence = np.where(inlier.sum(axis=1) >= enough, refined.log_evidence, -np.inf)
    return [
        Fit(
            state=np.array([*refined.state[k, :2], wrap_angle(refined.state[k, 2]), refined.state[k, 3]]),
            is_inlier=inlier[k],
            is_los=is_los,
            cost=float(-evidence[k]),
            covariance=refined.covariance[k],
            evidence_gap=np.inf,
        )
        for k in distinct(refined.state, evidence, config.n_ranked)
    ]


def los_hypotheses(problem: SnapshotProblem, config: SnapshotConfig) -> FloatArray:
    """States (hypothesis, 4) from the line of sight and one single bounce each."""
    first = problem.earliest
    candidates = problem.strongest(config.max_hypothesis_paths)
    others = candidates[candidates != first]
    heading = los_heading(problem)
    equation = bounce_equation(problem.tx, heading, problem.measured[others])
    both = packed_normal(*los_equations(problem, heading)).sum(axis=0)
    z = solve_packed(both + packed_normal(equation.row, equation.right_side))
    return _states(problem, z, np.full(len(z), heading))


def nlos_hypotheses(problem: SnapshotProblem, config: SnapshotConfig) -> FloatArray:
    """States (hypothesis, 4) from every four single bounces, at most two each."""
    sets = subsets(problem.strongest(config.max_hypothesis_paths), 4)
    index, heading = four_path_headings(problem, sets)
    equation = bounce_equation(problem.tx, heading[:, None], problem.measured[sets[index]])
    z = solve_packed(packed_normal(equation.row, equation.right_side).sum(axis=1))
    return _states(problem, z, heading)


def four_path_headings(problem: SnapshotProblem, sets: IntArray) -> tuple[IntArray, FloatArray]:
    """RX headings at which four paths (set, 4) are consistent single bounces.

    The four equations have a solution [x, y, bias, 1] where the determinant of [row, -right side] vanishes. In
    the heading alpha it is exactly A + C cos alpha + S sin alpha; A, C, S follow from three samples. Where noise
    keeps it just from vanishing (|A| up to 1.3 of the amplitude), the heading of its extremum is kept.

    Returns
    -------
    index, heading_rad
        Set of every heading found, and the heading.
    """
    third = 2 * np.pi / 3
    d0, d1, d2 = (_determinant(problem, sets, alpha) for alpha in (0.0, third, -third))
    mean, cosine, sine = (d0 + d1 + d2) / 3, (2 * d0 - d1 - d2) / 3, (d1 - d2) / np.sqrt(3)
    amplitude = np.hypot(cosine, sine)
    index = np.flatnonzero((amplitude > 1e-12) & (np.abs(mean) <= 1.3 * amplitude))
    half = np.arccos(np.clip(-mean[index] / amplitude[index], -1.0, 1.0))
    centre = np.arctan2(sine[index], cosine[index])
    single = half * (np.pi - half) == 0
    return (
        np.concatenate([index, index[~single]]),
        wrap_angle(np.concatenate([centre + half, (centre - half)[~single]])),
    )


def _determinant(problem: SnapshotProblem, sets: IntArray, heading_rad: float) -> FloatArray:
    equation = bounce_equation(problem.tx, heading_rad, problem.measured)
    # Relative to the TX, so that the entries stay small.
    right_side = equation.right_side - equation.row[:, :2] @ problem.tx.position_m[:2]
    matrix = np.column_stack([equation.row, -right_side])
    return np.asarray(np.linalg.det(matrix[sets]))


def _states(problem: SnapshotProblem, z: FloatArray, heading_rad: FloatArray) -> FloatArray:
    """States of the solutions that are finite and leave every path a length."""
    valid = np.asarray(problem.measured[:, 0].min(initial=np.inf) > z[:, 2])
    return np.asarray(np.column_stack([z[:, :2], heading_rad, z[:, 2]])[valid])


def _gated(problem: SnapshotProblem, state: FloatArray, config: SnapshotConfig) -> BoolArray:
    bounce = bounce_residual(problem, state)
    gate = chi2.ppf(config.gate_probability, 1)
    return np.asarray(bounce.is_feasible & (bounce.value_m**2 <= gate * bounce.variance_m2))


def distinct(state: FloatArray, score: FloatArray, n: int) -> IntArray:
    """Indices of up to n states of the highest score that differ; scores of -inf are left out."""
    left = np.where(np.isfinite(score), score, -np.inf)
    chosen: list[int] = []
    while len(chosen) < n and np.any(left > -np.inf):
        best = int(np.argmax(left))
        chosen.append(best)
        near = np.hypot(*(state[:, :2] - state[best, :2]).T) < _MODE_DISTANCE_M
        near &= np.abs(wrap_angle(state[:, 2] - state[best, 2])) < _MODE_HEADING_RAD
        left[near] = -np.inf
        left[best] = -np.inf
    return np.array(chosen, dtype=np.int64)
