"""The statistical method written out in plain NumPy: oracle of its compiled functions."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from estimation.laws.plane import bounce_equation, los_jacobian_rx, predict_los, residual
from estimation.slam.config import Mixture
from estimation.slam.snapshot.path_table import WALL_ANGLE_STD_DEG
from estimation.slam.snapshot.problem import SnapshotProblem
from estimation.slam.snapshot.refine import bounce_terms
from scenes.pose import wrap_angle
from scenes.record import FloatArray

EARLY_SHARE = 0.05
NEAR_M = 3.0


def path_densities(problem: SnapshotProblem, state: FloatArray, mixture: Mixture) -> FloatArray:
    """Density (path,) of every path at a world state (4,), over that of clutter of unit share."""
    terms = bounce_terms(problem.tx, problem.measured, problem.covariance, state)
    std = np.sqrt(terms.variance_m2)
    share = 1 - mixture.clutter_share - mixture.double_share
    single = share * mixture.clutter_width_m * student.pdf(terms.value_m / std, mixture.degrees_of_freedom) / std
    length = problem.measured[:, 0] - state[3]
    single *= length**2 / (length**2 + NEAR_M**2)
    single[~terms.is_feasible | (np.abs(terms.value_m) > 20 * std)] = 0.0
    turn = state[2] + problem.measured[:, 2] - problem.departure_rad
    sine = np.sin(turn) * np.sign(np.cos(turn))  # of the angle to the nearer of 0 and 180 deg
    cov = problem.covariance
    spread = np.sqrt(cov[:, 1, 1] + cov[:, 2, 2] - 2 * cov[:, 1, 2] + np.deg2rad(WALL_ANGLE_STD_DEG) ** 2)
    # Half the double bounces reverse a ray, half keep its direction; clutter has any angle.
    double = mixture.double_share * 0.5 * 2 * np.pi * norm.pdf(sine / spread) / spread
    double[np.abs(sine) > 6 * spread] = 0.0
    distance = np.hypot(*(state[:2] - problem.tx.position_m[:2]))
    early = length + 3 * np.sqrt(cov[:, 0, 0]) < distance
    double[early] = 0.0
    return mixture.clutter_share * np.where(early, EARLY_SHARE, 1.0) + np.maximum(single, double)


def log_likelihood(problem: SnapshotProblem, los: int, state: FloatArray, mixture: Mixture) -> float:
    """Log-likelihood of a world state (4,); the line of sight's without its normalisation."""
    others = np.arange(len(problem)) != los
    total = float(np.sum(np.log(path_densities(problem, state, mixture)[others])))
    return total if los < 0 else total + los_exponent(problem, los, state)


def los_exponent(problem: SnapshotProblem, los: int, state: FloatArray) -> float:
    """Log density of the line of sight over its peak."""
    error = residual(problem.measured[los], predict_los(problem.tx, state))
    return -0.5 * float(error @ np.linalg.solve(problem.covariance[los], error))


def estimating_equation(problem: SnapshotProblem, los: int, state: FloatArray, mixture: Mixture) -> FloatArray:
    """Weighted sum (4,) of all residuals times their derivatives; zero where the mixture is most likely.

    Variances are held at the state, as the refinement does; double bounces must be off.
    """
    terms = bounce_terms(problem.tx, problem.measured, problem.covariance, state)
    share = 1 - mixture.clutter_share / path_densities(problem, state, mixture)
    nu = mixture.degrees_of_freedom
    pull = share * (nu + 1) * terms.value_m / (nu * terms.variance_m2 + terms.value_m**2)
    others = np.arange(len(problem)) != los
    result = terms.jacobian[others].T @ pull[others]
    if los >= 0:
        error = residual(problem.measured[los], predict_los(problem.tx, state))
        slope = los_jacobian_rx(problem.tx, state)
        result = result - slope.T @ np.linalg.solve(problem.covariance[los], error)
    return np.asarray(result)


def four_bounce_states(problem: SnapshotProblem) -> FloatArray:
    """States (hypothesis, 4), in the world frame, of all feasible four single bounces, sorted by heading."""
    found = []
    for four in combinations(range(len(problem)), 4):
        paths = problem.take(np.array(four))
        third = 2 * np.pi / 3
        d0, d1, d2 = (_determinant(paths, alpha) for alpha in (0.0, third, -third))
        mean, cosine, sine = (d0 + d1 + d2) / 3, (2 * d0 - d1 - d2) / 3, (d1 - d2) / np.sqrt(3)
        amplitude = np.hypot(cosine, sine)
        if abs(mean) > 1.3 * amplitude:
            continue
        half, centre = np.arccos(np.clip(-mean / amplitude, -1, 1)), np.arctan2(sine, cosine)
        for heading in {centre + half, centre - half} if abs(mean) < amplitude else {centre + half}:
            equation = bounce_equation(problem.tx, heading, paths.measured)
            z = np.linalg.lstsq(equation.row, equation.right_side, rcond=None)[0]
            state = np.array([z[0], z[1], wrap_angle(heading), z[2]])
            if bounce_terms(problem.tx, paths.measured, paths.covariance, state).is_feasible.all():
                found.append(state)
    states = np.reshape(found, (-1, 4))
    return states[np.argsort(states[:, 2])]


def _determinant(problem: SnapshotProblem, heading_rad: float) -> float:
    equation = bounce_equation(problem.tx, heading_rad, problem.measured)
    right_side = equation.right_side - equation.row[:, :2] @ problem.tx.position_m[:2]
    return float(np.linalg.det(np.column_stack([equation.row, -right_side])))
