"""Robust snapshot SLAM: RX pose, clock bias and IPs of one stop from its channel estimate alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.config import MappingConfig, SnapshotConfig
from estimation.slam.mapping import map_stops
from estimation.slam.problem import Fit, SnapshotProblem, snapshot_problem
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.slam.reference import solve_reference
from estimation.slam.refine import refine_members
from estimation.slam.statistical import solve_statistical
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, FloatArray, Record, array


@dataclass(frozen=True)
class SnapshotSolution(Record):
    """RX state of one stop. NaN where the status is FAILED."""

    stop: int = array(dtype=int, doc="index of the receiver stop")
    status: int = array(dtype=int, doc="SolveStatus")
    position_m: FloatArray = array("xy", unit="m", doc="receiver position")
    heading_rad: float = array(unit="rad", doc="receiver heading, world frame")
    clock_bias_s: float = array(unit="s", doc="receiver clock bias")
    is_inlier: BoolArray = array("path", dtype=bool, doc="paths that agree with the solution, LOS included")
    is_los: BoolArray = array("path", dtype=bool, doc="the path taken as line of sight: at most one")
    cost: float = array(doc="cost of the chosen hypothesis; minus the log evidence for `statistical`")
    covariance: FloatArray = array(
        "state", "state2", doc="of [x, y, heading, bias] in (m, m, rad, s); NaN without refinement"
    )
    evidence_gap: float = array(
        doc="log evidence over the next distinct mode; below about 4 the stop is ambiguous; inf where unknown"
    )
    is_ambiguous: bool = array(dtype=bool, doc="two modes are near-equal: the gap is below `ambiguous_gap`")
    los_probability: float = array(doc="posterior probability that the earliest path is a line of sight")
    position_std_m: float = array(
        unit="m", doc="position standard deviation over all ranked modes by their probability; NaN if unknown"
    )
    mode_state: FloatArray = array(
        "mode",
        "state",
        doc="[x, y, heading, bias] in m, m, rad, s of the ranked modes; the first is the solution",
    )
    mode_covariance: FloatArray = array("mode", "state", "state2", doc="of the modes in (m, m, rad, s)")
    mode_log_evidence: FloatArray = array("mode", doc="log evidence of the modes, falling")
    mode_is_los: BoolArray = array(
        "mode", dtype=bool, doc="the mode takes the earliest path as line of sight"
    )


def solve_snapshot(estimate: ChannelEstimate, tx_pose: Pose, config: SnapshotConfig) -> SnapshotSolution:
    """Solve one stop: with the earliest path as line of sight if that is credible, else without.

    Kaltiokallio et al., arXiv 2404.10291; section II-C of the GP paper. The status is FAILED and the state NaN
    where nothing is feasible, nothing has a credible clock or, with the statistical method, clutter alone is the
    better explanation, or the best mode leaves the position free: nearly parallel paths, as along a corridor,
    leave clock and distance free together.
    """
    fits = ranked_modes(snapshot_problem(estimate, tx_pose, config.noise), config)
    if not fits or np.trace(fits[0].covariance[:2, :2]) > config.max_position_std_m**2:
        return _failed(estimate)
    return _solution(estimate, tx_pose, fits, config)


def ranked_modes(problem: SnapshotProblem, config: SnapshotConfig) -> list[Fit]:
    """The modes of one stop with a credible clock, best first: one at most for the reference method."""
    if config.method == "statistical":
        return solve_statistical(problem, config)
    fit = _line_of_sight_first(problem, config)
    return [] if fit is None or abs(fit.state[3]) > config.max_clock_bias_m else [fit]


def run_slam(
    estimates: Sequence[ChannelEstimate],
    tx_pose: Pose,
    config: SnapshotConfig,
    mapping_config: MappingConfig,
) -> tuple[PoseEstimates, IncidencePoints]:
    """Solve every stop on its own, then map the IPs of the stops that were solved.

    An IP is an inlier where SLAM took its path as a single bounce and mapping's own gate agrees. Where the
    state has a covariance, it is carried into the covariance of the IPs.
    """
    solutions = [solve_snapshot(estimate, tx_pose, config) for estimate in estimates]
    poses = collect_poses(solutions)
    points = map_stops(
        estimates,
        poses,
        tx_pose,
        mapping_config,
        is_los=[solution.is_los for solution in solutions],
        is_inlier=[solution.is_inlier for solution in solutions],
        state_covariance=[np.nan_to_num(solution.covariance) for solution in solutions],
    )
    return poses, points


def collect_poses(solutions: Sequence[SnapshotSolution]) -> PoseEstimates:
    """Receiver states of all stops as one record."""
    return PoseEstimates(
        stop=np.array([s.stop for s in solutions], dtype=int),
        position_m=np.array([s.position_m for s in solutions]).reshape(-1, 2),
        heading_rad=np.array([s.heading_rad for s in solutions]),
        clock_bias_s=np.array([s.clock_bias_s for s in solutions]),
        status=np.array([s.status for s in solutions], dtype=int),
        n_inliers=np.array([np.count_nonzero(s.is_inlier) for s in solutions], dtype=int),
        cost=np.array([s.cost for s in solutions]),
    )


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
    enough = np.count_nonzero(fit.is_inlier) >= config.min_los_inliers
    return bool(enough and config.path_loss.is_credible(problem.power_dbm[problem.earliest], distance))


def _refined(problem: SnapshotProblem, fit: Fit, config: SnapshotConfig) -> Fit:
    """The published solution refined by maximum likelihood on its inliers."""
    tx = np.array([*problem.tx.position_m[:2], 0.0, 0.0])
    los = int(np.argmax(fit.is_los[fit.is_inlier])) if fit.is_los.any() else -1
    state, covariance = refine_members(problem.take(fit.is_inlier), los, fit.state - tx, config)
    return replace(fit, state=state + tx, covariance=covariance)


def _solution(
    estimate: ChannelEstimate, tx_pose: Pose, fits: Sequence[Fit], config: SnapshotConfig
) -> SnapshotSolution:
    to_seconds = np.array([1.0, 1.0, 1.0, 1 / SPEED_OF_LIGHT_M_S])
    state = np.array([fit.state for fit in fits])
    considered = config.consider.covariance(state[:, :2] - tx_pose.position_m[:2])
    covariance = (np.array([f.covariance for f in fits]) + considered) * np.outer(to_seconds, to_seconds)
    evidence = np.array([-fit.cost for fit in fits])
    mode_is_los = np.array([bool(fit.is_los.any()) for fit in fits])
    share = np.exp(evidence - evidence.max())
    best, gap = fits[0], float(evidence[0] - evidence[1]) if len(fits) > 1 else np.inf
    return SnapshotSolution(
        stop=estimate.stop,
        status=SolveStatus.LOS if mode_is_los[0] else SolveStatus.NLOS,
        position_m=best.state[:2],
        heading_rad=best.state[2],
        clock_bias_s=best.state[3] / SPEED_OF_LIGHT_M_S,
        is_inlier=best.is_inlier,
        is_los=best.is_los,
        cost=best.cost,
        covariance=covariance[0],
        evidence_gap=gap,
        is_ambiguous=gap < config.ambiguous_gap,
        los_probability=float(share[mode_is_los].sum() / share.sum()),
        position_std_m=_spread(state, covariance, share / share.sum()),
        mode_state=state * to_seconds,
        mode_covariance=covariance,
        mode_log_evidence=evidence,
        mode_is_los=mode_is_los,
    )


def _spread(state: FloatArray, covariance: FloatArray, probability: FloatArray) -> float:
    """Root mean square distance in m from the first mode's position, over modes and within them."""
    between = np.sum((state[:, :2] - state[0, :2]) ** 2, axis=1)
    within = covariance[:, 0, 0] + covariance[:, 1, 1]
    return float(np.sqrt(probability @ (between + within)))


def _failed(estimate: ChannelEstimate) -> SnapshotSolution:
    nobody = np.zeros(len(estimate), bool)
    return SnapshotSolution(
        stop=estimate.stop,
        status=SolveStatus.FAILED,
        position_m=np.full(2, np.nan),
        heading_rad=np.nan,
        clock_bias_s=np.nan,
        is_inlier=nobody,
        is_los=nobody,
        cost=np.nan,
        covariance=np.full((4, 4), np.nan),
        evidence_gap=np.inf,
        is_ambiguous=False,
        los_probability=np.nan,
        position_std_m=np.nan,
        mode_state=np.empty((0, 4)),
        mode_covariance=np.empty((0, 4, 4)),
        mode_log_evidence=np.empty(0),
        mode_is_los=np.empty(0, bool),
    )
