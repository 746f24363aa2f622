"""Robust snapshot SLAM in space: position with height, heading and clock bias of one stop.

As the statistical method of the plane. Hypotheses come from few paths and are scored by the log-likelihood of all
paths as a mixture of single bounces and clutter. The best are refined by re-weighted least squares and ranked by
evidence.
"""

import numpy as np
from scipy.special import expit

from estimation.channel.record import ChannelEstimate
from estimation.distributions import chi_square_quantile
from estimation.inference.least_squares import Attempt, Schedule, damped_step, minimise, student_t_efficiency
from estimation.laws.space import N_STATE
from estimation.slam.config import SnapshotConfig
from estimation.slam.snapshot.evidence import log_clutter, power_law, prior_of
from estimation.slam.snapshot.likelihood import MAX_ITERATIONS
from estimation.slam.snapshot.problem import (
    MIN_LOS_INLIERS,
    MIN_NLOS_INLIERS,
    Fit,
    reject_uncertain,
    strongest_paths,
)
from estimation.slam.snapshot.solution import SnapshotSolution, failed_solution, solution_of
from estimation.slam.snapshot.statistical import N_RANKED, N_REFINED
from estimation.slam.space.hypotheses import bounce_states, los_states
from estimation.slam.space.problem import (
    BounceFit,
    SpatialProblem,
    bounce_fit,
    bounce_log_ratio,
    los_fit,
    spatial_problem,
)
from scenes.pose import Pose, wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

# Two states this close in position (m) and heading (rad) are one mode.
_MODE_DISTANCE_M = 0.3
_MODE_HEADING_RAD = np.deg2rad(5.0)
_MIN_BOUNCES = 4
_CONVERGED = 1e-10  # relative to 1 + the state, in m and rad: smaller steps end the refinement
_Evaluated = tuple[BounceFit, FloatArray, FloatArray, FloatArray]
_Refined = tuple[FloatArray, _Evaluated]


def solve_spatial(estimate: ChannelEstimate, tx_pose: Pose, config: SnapshotConfig) -> SnapshotSolution:
    """Solve one stop whose paths have elevations: with the first path as line of sight, and without one.

    The line of sight must have a credible power. The status is FAILED where no feasible mode has enough inliers,
    clutter alone explains the paths better, or the plan position of the best mode is uncertain. This is always the
    statistical method; the published one is planar, see `SnapshotConfig.solves_in_space`.
    """
    fits = ranked_spatial_modes(spatial_problem(estimate, tx_pose, config.noise), config)
    if not fits:
        return failed_solution(estimate, N_STATE, axes=3)
    return solution_of(estimate, tx_pose, fits, config, axes=3)


def ranked_spatial_modes(problem: SpatialProblem, config: SnapshotConfig) -> list[Fit]:
    """Distinct modes of one stop, best first, their states [x, y, z, heading, bias] in m, m, m, rad, m.

    Their evidence exceeds that of clutter alone. None where the plan position of the best one is uncertain.
    """
    fits = _with_los(problem, config) + _without_los(problem, config)
    if fits:
        clutter = _log_clutter(problem, config)
        fits = [fit for fit in fits if -fit.cost > clutter]
    state = np.array([fit.state for fit in fits]).reshape(-1, N_STATE)
    kept = distinct_states(state, np.array([-fit.cost for fit in fits]), N_RANKED)
    return reject_uncertain([fits[k] for k in kept], config)


def refine_spatial(
    problem: SpatialProblem, start: FloatArray, los: int, config: SnapshotConfig
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Refine states (state, 5) by damped Gauss-Newton steps, re-weighted by each path's odds of a bounce.

    `los` is the index of the line of sight, -1 for none. Returns the states, their information (state, 5, 5) under
    Gaussian errors, and their log-likelihoods.
    """
    others = np.arange(len(problem)) != los
    weak = np.diag(_prior(config) ** -2.0)

    def attempt(at: _Refined, damping: FloatArray) -> Attempt[_Refined] | None:
        """One damped step of all states with the weights of their errors; None where every state has converged."""
        state, (fit, _, direct, slope) = at
        weight = _weights(fit, others, config)
        jacobian = fit.jacobian * weight[..., None]
        information = np.einsum("spia,spib->sab", jacobian, fit.jacobian) + np.swapaxes(slope, 1, 2) @ slope
        gradient = np.einsum("spia,spi->sa", jacobian, fit.white) + np.einsum("sia,si->sa", slope, direct)
        step = damped_step(information + weak, gradient, damping)
        if np.all(np.abs(step) <= _CONVERGED * (1 + np.abs(state))):
            return None
        trial = _evaluate(problem, state + step, los, others, config)
        # The gradient is that of this cost, with weights and variances of the present state.
        held = (fit.whitening @ trial[0].value_m[..., None])[..., 0]
        before = np.sum(weight * fit.white**2, axis=(1, 2)) + np.sum(direct**2, axis=1)
        after = np.sum(weight * held**2, axis=(1, 2)) + np.sum(trial[2] ** 2, axis=1)
        return Attempt((state + step, trial), before * (1 + 1e-12), after)

    begun = start.copy(), _evaluate(problem, start, los, others, config)
    schedule = Schedule(MAX_ITERATIONS, first=1e-6, largest=1e9)
    state, (fit, score, _, slope) = minimise(begun, attempt, schedule)
    share = expit(bounce_log_ratio(fit, config.mixture)) * others
    kept = student_t_efficiency(config.mixture.degrees_of_freedom, 1)
    information = np.einsum("sp,spia,spib->sab", kept * share, fit.jacobian, fit.jacobian)
    return state, information + np.swapaxes(slope, 1, 2) @ slope, score


def distinct_states(state: FloatArray, score: FloatArray, n: int) -> IntArray:
    """Indices of up to n states (state, 5) of the highest score that differ in position or heading."""
    remaining = score.copy()
    chosen: list[int] = []
    while len(chosen) < n and np.any(remaining > -np.inf):
        best = int(np.argmax(remaining))
        chosen.append(best)
        near = np.linalg.norm(state[:, :3] - state[best, :3], axis=1) < _MODE_DISTANCE_M
        near &= np.abs(wrap_angle(state[:, 3] - state[best, 3])) < _MODE_HEADING_RAD
        remaining[near | (np.arange(len(remaining)) == best)] = -np.inf
    return np.array(chosen, dtype=np.int64)


def _with_los(problem: SpatialProblem, config: SnapshotConfig) -> list[Fit]:
    if len(problem) < MIN_LOS_INLIERS:
        return []
    return _modes(problem, los_states(problem, strongest_paths(problem.power_dbm)), problem.direct, config)


def _without_los(problem: SpatialProblem, config: SnapshotConfig) -> list[Fit]:
    if len(problem) < _MIN_BOUNCES:
        return []
    return _modes(problem, bounce_states(problem, strongest_paths(problem.power_dbm)), -1, config)


def _modes(problem: SpatialProblem, state: FloatArray, los: int, config: SnapshotConfig) -> list[Fit]:
    """Distinct refined modes of the best hypotheses, with minus their log evidence as cost."""
    if not len(state):
        return []
    others = np.arange(len(problem)) != los
    score = _evaluate(problem, state, los, others, config)[1]
    start = state[distinct_states(state, score, N_REFINED)]
    state, information, score = refine_spatial(problem, start, los, config)
    evidence, covariances = _log_evidence(problem, los, state, information, score, config)
    fit = bounce_fit(problem, state)
    inlier = others & fit.is_feasible & (fit.square <= chi_square_quantile(config.gate_probability, 2))
    if los >= 0:
        inlier[:, los] = True
    enough = inlier.sum(axis=1) >= (MIN_LOS_INLIERS if los >= 0 else MIN_NLOS_INLIERS)
    credible = np.abs(state[:, 4]) <= config.max_clock_bias_m
    if los >= 0:
        reach = np.linalg.norm(state[:, :3] - problem.tx.position_m, axis=1)
        level = [config.path_loss.is_credible(float(problem.power_dbm[los]), float(r)) for r in reach]
        credible = credible & np.array(level)
    is_los = np.arange(len(problem)) == los
    state[:, 3] = wrap_angle(state[:, 3])
    return [
        Fit(state[k], inlier[k], is_los, float(-evidence[k]), covariances[k])
        for k in np.flatnonzero(enough & credible & np.isfinite(evidence))
    ]


def _log_evidence(
    problem: SpatialProblem,
    los: int,
    state: FloatArray,
    information: FloatArray,
    log_likelihood: FloatArray,
    config: SnapshotConfig,
) -> tuple[FloatArray, FloatArray]:
    """Laplace approximation of the log evidence (mode,) and its covariances (mode, 5, 5).

    As `evidence.log_evidence` in the plane; the Gaussian prior about the TX has three dimensions.
    """
    full = information + np.diag(_prior(config) ** -2.0)
    evidence = log_likelihood - 0.5 * np.linalg.slogdet(full)[1] + _log_power(problem, los, state, config)
    distance = np.linalg.norm(state[:, :3] - problem.tx.position_m, axis=1)
    evidence = evidence - 0.5 * (distance / config.reach_m) ** 2
    evidence = evidence - np.log(2 * config.reach_m**3 * config.max_clock_bias_m)
    if los >= 0:
        covariance = problem.covariance[los]
        # The density of clutter: any direction of both ends, range over its width.
        clutter = np.log((4 * np.pi) ** 2 * config.mixture.clutter_width_m)
        evidence = evidence - 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1] + clutter
    return evidence, np.asarray(np.linalg.inv(full))


def _log_clutter(problem: SpatialProblem, config: SnapshotConfig) -> float:
    """Log evidence of all paths being clutter: from lengths and powers, as in the plane."""
    share = config.mixture.clutter_share + config.mixture.double_share
    prior = prior_of(config)._replace(clutter_share=share)
    return log_clutter(problem.measured[:, 0], problem.power_dbm, power_law(config.path_loss), prior)


def _evaluate(
    problem: SpatialProblem, state: FloatArray, los: int, others: BoolArray, config: SnapshotConfig
) -> _Evaluated:
    """Bounces, log-likelihood (state,), and whitened line of sight (state, 5 or 0) with its derivative."""
    fit = bounce_fit(problem, state)
    share = config.mixture.clutter_share + config.mixture.double_share
    gain = np.logaddexp(0.0, bounce_log_ratio(fit, config.mixture)) + np.log(share)
    score = gain[:, others].sum(axis=1)
    if los < 0:
        return fit, score, np.zeros((len(state), 0)), np.zeros((len(state), 0, 5))
    direct, slope = los_fit(problem, state, los)
    return fit, score - 0.5 * np.sum(direct**2, axis=1), direct, slope


def _weights(fit: BounceFit, others: BoolArray, config: SnapshotConfig) -> FloatArray:
    """Weight (state, path, 2) of every whitened equation: Student-t, times the probability of a bounce."""
    freedom = config.mixture.degrees_of_freedom
    share = expit(bounce_log_ratio(fit, config.mixture)) * others
    return np.asarray(share[..., None] * (freedom + 1) / (freedom + fit.white**2))


def _log_power(problem: SpatialProblem, los: int, state: FloatArray, config: SnapshotConfig) -> FloatArray:
    """Log density (mode,) of the powers of all paths at their lengths without the clock bias."""
    others = np.arange(len(problem)) != los
    length = np.maximum(problem.measured[others, 0] - state[:, 4, None], 0.1)
    density = config.path_loss.log_density_of_others(problem.power_dbm[others], length)
    if los < 0:
        return density
    reach = np.linalg.norm(state[:, :3] - problem.tx.position_m, axis=1)
    return density + config.path_loss.log_density(problem.power_dbm[los], reach)


def _prior(config: SnapshotConfig) -> FloatArray:
    """Standard deviations (5,) of the weak prior: those of the plane, with `reach_m` for the height too."""
    return np.insert(config.prior_std, 2, config.reach_m)
