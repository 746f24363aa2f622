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
from estimation.slam.refine import refine
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


def solve_snapshot(estimate: ChannelEstimate, tx_pose: Pose, config: SnapshotConfig) -> SnapshotSolution:
    """Solve one stop: with the earliest path as line of sight if that is credible, else without.

    Kaltiokallio et al., arXiv 2404.10291; section II-C of the GP paper. Where nothing is feasible the status
    is FAILED and the state NaN.
    """
    problem = snapshot_problem(estimate, tx_pose, config.noise)
    if config.method == "statistical":
        fit = _by_evidence(problem, config)
    else:
        fit = _line_of_sight_first(problem, config)
    return _failed(estimate) if fit is None else _solution(estimate, fit)


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


def _by_evidence(problem: SnapshotProblem, config: SnapshotConfig) -> Fit | None:
    """The more evident of a credible line of sight and single bounces alone."""
    with_los = solve_statistical(problem, config, True) if len(problem) > 1 else None
    without = solve_statistical(problem, config, False) if len(problem) >= 4 else None
    if with_los is not None and not _is_credible_los(problem, with_los, config):
        with_los = None
    fits = [fit for fit in (with_los, without) if fit is not None]
    return min(fits, key=lambda fit: fit.cost, default=None)


def _is_credible_los(problem: SnapshotProblem, fit: Fit, config: SnapshotConfig) -> bool:
    distance = float(np.hypot(*(fit.state[:2] - problem.tx.position_m[:2])))
    enough = np.count_nonzero(fit.is_inlier) >= config.min_los_inliers
    return bool(enough and config.path_loss.is_credible(problem.power_dbm[problem.earliest], distance))


def _refined(problem: SnapshotProblem, fit: Fit, config: SnapshotConfig) -> Fit:
    state = fit.state[None]
    refined = refine(problem, state, fit.is_los, config.mixture, config.max_iterations, fit.is_inlier)
    return replace(fit, state=refined.state[0], covariance=refined.covariance[0])


def _solution(estimate: ChannelEstimate, fit: Fit) -> SnapshotSolution:
    to_seconds = np.array([1.0, 1.0, 1.0, 1 / SPEED_OF_LIGHT_M_S])
    return SnapshotSolution(
        stop=estimate.stop,
        status=SolveStatus.LOS if fit.is_los.any() else SolveStatus.NLOS,
        position_m=fit.state[:2],
        heading_rad=fit.state[2],
        clock_bias_s=fit.state[3] / SPEED_OF_LIGHT_M_S,
        is_inlier=fit.is_inlier,
        is_los=fit.is_los,
        cost=fit.cost,
        covariance=fit.covariance * np.outer(to_seconds, to_seconds),
        evidence_gap=fit.evidence_gap,
    )


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
    )
