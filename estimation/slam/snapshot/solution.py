"""The solution of one stop from its ranked modes, in the plane and in space, and those of all stops as poses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.config import SnapshotConfig
from estimation.slam.record import PoseEstimates, SolveStatus
from estimation.slam.snapshot.problem import Fit
from estimation.slam.transmitters import AnyTx, transmitters_of
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import BoolArray, FloatArray, Record, array

PLANE_OF_SPACE = np.array([0, 1, 3, 4])  # x, y, heading and bias of [x, y, z, heading, bias]


@dataclass(frozen=True)
class SnapshotSolution(Record):
    """RX state of one stop. NaN where the status is FAILED.

    A state is [x, y, heading, bias] in the plane and [x, y, z, heading, bias] in space, with a bias for every TX.
    """

    stop: int = array(dtype=int, doc="index of the receiver stop")
    status: int = array(dtype=int, doc="SolveStatus")
    position_m: FloatArray = array("coordinate", unit="m", doc="receiver position, 2 or 3 coordinates")
    heading_rad: float = array(unit="rad", doc="receiver heading, world frame")
    clock_bias_s: float = array(unit="s", doc="receiver clock bias, against the first TX of several")
    is_inlier: BoolArray = array("path", dtype=bool, doc="paths that agree with the solution, LOS included")
    is_los: BoolArray = array("path", dtype=bool, doc="the path taken as line of sight: at most one")
    cost: float = array(doc="cost of the chosen hypothesis; minus the log evidence for `statistical`")
    covariance: FloatArray = array("state", "state2", doc="of the state in (m, rad, s); NaN without refinement")
    evidence_gap: float = array(
        doc="log evidence over the next distinct mode; below about 4 the stop is ambiguous; inf where unknown"
    )
    is_ambiguous: bool = array(dtype=bool, doc="two modes are near-equal: the gap is below `ambiguous_gap`")
    los_probability: float = array(doc="posterior probability that one of the paths is a line of sight")
    position_std_m: float = array(
        unit="m", doc="plan position standard deviation over all ranked modes by their probability; NaN if unknown"
    )
    mode_state: FloatArray = array(
        "mode", "state", doc="states of the ranked modes in (m, rad, s); the first is the solution"
    )
    mode_covariance: FloatArray = array("mode", "state", "state2", doc="of the modes")
    mode_log_evidence: FloatArray = array("mode", doc="log evidence of the modes, falling")
    mode_is_los: BoolArray = array("mode", dtype=bool, doc="the mode takes a path as line of sight")


def solution_of(
    estimate: ChannelEstimate, tx: AnyTx, fits: Sequence[Fit], config: SnapshotConfig, axes: int = 2
) -> SnapshotSolution:
    """The solution of a stop from its modes `fits`, at least one, in order of falling evidence.

    `axes` is the number of coordinates of a position: 2 in the plane, 3 in space.
    """
    state = np.array([fit.state for fit in fits])
    scale = np.append(np.ones(axes + 1), np.full(state.shape[1] - axes - 1, 1 / SPEED_OF_LIGHT_M_S))
    considered = config.consider.covariance(state[:, :axes] - transmitters_of(tx).poses[0].position_m[:axes])
    covariance = np.array([fit.covariance for fit in fits])
    covariance[:, : axes + 2, : axes + 2] += considered
    covariance *= np.outer(scale, scale)
    evidence = np.array([-fit.cost for fit in fits])
    mode_is_los = np.array([bool(fit.is_los.any()) for fit in fits])
    share = np.exp(evidence - evidence.max())
    best, gap = fits[0], float(evidence[0] - evidence[1]) if len(fits) > 1 else np.inf
    return SnapshotSolution(
        stop=estimate.stop,
        status=SolveStatus.LOS if mode_is_los[0] else SolveStatus.NLOS,
        position_m=best.state[:axes],
        heading_rad=best.state[axes],
        clock_bias_s=best.state[axes + 1] / SPEED_OF_LIGHT_M_S,
        is_inlier=best.is_inlier,
        is_los=best.is_los,
        cost=best.cost,
        covariance=covariance[0],
        evidence_gap=gap,
        is_ambiguous=gap < config.ambiguous_gap,
        los_probability=float(share[mode_is_los].sum() / share.sum()),
        position_std_m=_spread(state, covariance, share / share.sum()),
        mode_state=state * scale,
        mode_covariance=covariance,
        mode_log_evidence=evidence,
        mode_is_los=mode_is_los,
    )


def failed_solution(estimate: ChannelEstimate, n_state: int, axes: int = 2) -> SnapshotSolution:
    """The solution of a failed stop, for states of `n_state` components with positions of `axes` coordinates."""
    none = np.zeros(len(estimate), bool)
    return SnapshotSolution(
        stop=estimate.stop,
        status=SolveStatus.FAILED,
        position_m=np.full(axes, np.nan),
        heading_rad=np.nan,
        clock_bias_s=np.nan,
        is_inlier=none,
        is_los=none,
        cost=np.nan,
        covariance=np.full((n_state, n_state), np.nan),
        evidence_gap=np.inf,
        is_ambiguous=False,
        los_probability=np.nan,
        position_std_m=np.nan,
        mode_state=np.empty((0, n_state)),
        mode_covariance=np.empty((0, n_state, n_state)),
        mode_log_evidence=np.empty(0),
        mode_is_los=np.empty(0, bool),
    )


def collect_poses(solutions: Sequence[SnapshotSolution]) -> PoseEstimates:
    """Receiver states of all stops, in the plane or all in space, as one record."""
    n_state = len(solutions[0].covariance) if solutions else 4
    axes = solutions[0].size("coordinate") if solutions else 2
    in_plane = PLANE_OF_SPACE if axes > 2 else np.arange(n_state)
    covariance = np.array([s.covariance for s in solutions]).reshape(-1, n_state, n_state)
    modes = [np.vstack([s.mode_state, np.full((2, n_state), np.nan)]) for s in solutions]
    position = np.array([s.position_m for s in solutions]).reshape(-1, axes)
    heights = {}
    if axes > 2:
        heights = {
            "height_m": position[:, 2],
            "height_std_m": np.sqrt(covariance[:, 2, 2]),
            "height_covariance": covariance[:, 2, in_plane],
        }
    return PoseEstimates(
        stop=np.array([s.stop for s in solutions], dtype=int),
        position_m=position[:, :2],
        heading_rad=np.array([s.heading_rad for s in solutions]),
        clock_bias_s=np.array([s.clock_bias_s for s in solutions]),
        tx_clock_bias_s=np.array([mode[0, axes + 1 :] for mode in modes]).reshape(-1, n_state - axes - 1),
        status=np.array([s.status for s in solutions], dtype=int),
        n_inliers=np.array([np.count_nonzero(s.is_inlier) for s in solutions], dtype=int),
        cost=np.array([s.cost for s in solutions]),
        covariance=covariance[:, in_plane[:, None], in_plane],
        position_std_m=np.array([s.position_std_m for s in solutions]),
        is_ambiguous=np.array([s.is_ambiguous for s in solutions], dtype=bool),
        evidence_gap=np.array([s.evidence_gap if np.isfinite(s.evidence_gap) else np.nan for s in solutions]),
        alternative=np.array([mode[1, in_plane] for mode in modes]).reshape(-1, len(in_plane)),
        los_probability=np.array([s.los_probability for s in solutions]),
        **heights,
    )


def _spread(state: FloatArray, covariance: FloatArray, probability: FloatArray) -> float:
    """Root mean square distance in m from the first mode's position, over modes and within them."""
    between = np.sum((state[:, :2] - state[0, :2]) ** 2, axis=1)
    within = covariance[:, 0, 0] + covariance[:, 1, 1]
    return float(np.sqrt(probability @ (between + within)))
