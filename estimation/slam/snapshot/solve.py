"""Robust snapshot SLAM: RX pose and clock bias of one stop from its channel estimate alone."""

from dataclasses import replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.config import SnapshotConfig
from estimation.slam.snapshot.joint import joint_modes
from estimation.slam.snapshot.problem import (
    MIN_LOS_INLIERS,
    Fit,
    SnapshotProblem,
    reject_uncertain,
    snapshot_problem,
)
from estimation.slam.snapshot.reference import solve_reference
from estimation.slam.snapshot.refine import refine_members
from estimation.slam.snapshot.solution import SnapshotSolution, failed_solution, solution_of
from estimation.slam.snapshot.statistical import solve_statistical
from estimation.slam.transmitters import AnyTx


def solve_snapshot(estimate: ChannelEstimate, tx_pose: AnyTx, config: SnapshotConfig) -> SnapshotSolution:
    """Solve one stop: with the earliest path as line of sight if that is credible, else without.

    Kaltiokallio et al., arXiv 2404.10291; section II-C of the GP paper. The status is FAILED and the state NaN
    where no mode is feasible with a credible clock, where clutter alone explains the paths better (statistical
    method), or where the position of the best mode is uncertain: nearly parallel paths, as along a corridor, do
    not separate clock bias and distance.
    """
    problem = snapshot_problem(estimate, tx_pose, config.noise)
    fits = ranked_modes(problem, config)
    if not fits:
        return failed_solution(estimate, 3 + len(problem.every_tx))
    return solution_of(estimate, tx_pose, fits, config)


def ranked_modes(problem: SnapshotProblem, config: SnapshotConfig) -> list[Fit]:
    """The modes of one stop with a credible clock, best first: at most one for the reference method.

    None where the position of the best one is uncertain.
    """
    if len(problem.every_tx) > 1:
        return reject_uncertain(joint_modes(problem, config), config)
    if config.method == "statistical":
        return reject_uncertain(solve_statistical(problem, config), config)
    fit = _line_of_sight_first(problem, config)
    return reject_uncertain([] if fit is None or abs(fit.state[3]) > config.max_clock_bias_m else [fit], config)


def _line_of_sight_first(problem: SnapshotProblem, config: SnapshotConfig) -> Fit | None:
    """The published order: the line of sight where it is credible, else single bounces alone."""
    fit = solve_reference(problem, config, True) if len(problem) > 1 else None
    if fit is None or not _is_credible_los(problem, fit, config):
        fit = solve_reference(problem, config, False) if len(problem) >= 4 else None
    if fit is not None and config.refine:
        return _refined(problem, fit, config)
    return fit


def _is_credible_los(problem: SnapshotProblem, fit: Fit, config: SnapshotConfig) -> bool:
    distance = float(np.hypot(*(fit.state[:2] - problem.tx.position_m[:2])))
    enough = np.count_nonzero(fit.is_inlier) >= MIN_LOS_INLIERS
    return bool(enough and config.path_loss.is_credible(problem.power_dbm[problem.earliest], distance))


def _refined(problem: SnapshotProblem, fit: Fit, config: SnapshotConfig) -> Fit:
    """The published solution refined by maximum likelihood on its inliers."""
    tx = np.array([*problem.tx.position_m[:2], 0.0, 0.0])
    los = int(np.argmax(fit.is_los[fit.is_inlier])) if fit.is_los.any() else -1
    state, covariance = refine_members(problem.take(fit.is_inlier), los, fit.state - tx, config)
    return replace(fit, state=state + tx, covariance=covariance)
