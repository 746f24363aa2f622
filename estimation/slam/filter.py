"""SLAM stop by stop: a filter over the ranked modes of each stop, for use while the walk goes on.

Several hypotheses are kept, each a Gaussian over the state of the last stop and its displacement. Every stop adds
one branch per mode and one for none of them; a branch is weighed by the mode's evidence and by how well its state
was foreseen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.config import SnapshotConfig, TrajectoryConfig
from estimation.slam.problem import Fit, snapshot_problem
from estimation.slam.record import PoseEstimates, SolveStatus
from estimation.slam.snapshot import ranked_modes
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle
from scenes.record import FloatArray

_NONE_COST = 12.0  # log evidence a stop loses when it is in none of its modes
_START_STEP_M = 2.0
# The next state from [x, y, heading, bias, dx, dy]: the last displacement again.
_MOVE = np.eye(6) + np.eye(6, k=4)
_MOVE[2:4, 4:] = 0.0


@dataclass(frozen=True)
class Hypothesis:
    """A Gaussian over [x, y, heading, bias, dx, dy], its log weight and the mode last taken."""

    mean: FloatArray  # (6,)
    covariance: FloatArray  # (6, 6)
    log_weight: float
    mode: Fit | None


def run_filter(
    estimates: Sequence[ChannelEstimate], tx_pose: Pose, snapshot: SnapshotConfig, config: TrajectoryConfig
) -> PoseEstimates:
    """State of every stop from that stop and those before it; NaN and FAILED until the first solved stop."""
    ranked = snapshot.model_copy(update={"method": "statistical", "n_ranked": config.n_modes})
    hypotheses: list[Hypothesis] = []
    best: list[Hypothesis | None] = []
    for estimate in estimates:
        modes = ranked_modes(snapshot_problem(estimate, tx_pose, ranked.noise), ranked)
        hypotheses = advance(hypotheses, modes, config)
        best.append(hypotheses[0] if hypotheses else None)
    return _poses(estimates, best)


def advance(
    hypotheses: Sequence[Hypothesis], modes: Sequence[Fit], config: TrajectoryConfig
) -> list[Hypothesis]:
    """Hypotheses after one more stop with the modes given, best first."""
    if not hypotheses:
        return _normalised([_started(mode) for mode in modes], config)
    evidence = np.array([-mode.cost for mode in modes])
    relative = evidence - evidence.max(initial=-np.inf) if len(evidence) else evidence
    branches = []
    for before in hypotheses:
        foreseen = predicted(before, config)
        lost = _NONE_COST if modes else 0.0
        branches.append(Hypothesis(foreseen.mean, foreseen.covariance, before.log_weight - lost, None))
        branches += [updated(foreseen, mode, float(gain)) for mode, gain in zip(modes, relative, strict=True)]
    return _normalised(branches, config)


def predicted(before: Hypothesis, config: TrajectoryConfig) -> Hypothesis:
    """One stop ahead at the last displacement, with the motion prior's scatter."""
    scatter = max(config.cross_track_std_m, config.along_track_std_m) ** 2
    noise = np.diag([scatter, scatter, config.heading_step_rad**2, config.clock_step_m**2, scatter, scatter])
    noise[[0, 1], [4, 5]] = noise[[4, 5], [0, 1]] = 0.999 * scatter
    covariance = _MOVE @ before.covariance @ _MOVE.T + noise
    return Hypothesis(_MOVE @ before.mean, covariance, before.log_weight, None)


def updated(foreseen: Hypothesis, mode: Fit, log_evidence: float) -> Hypothesis:
    """Kalman update with a mode's state and covariance; its weight grows by the predictive log density."""
    innovation = mode.state - foreseen.mean[:4]
    innovation[2] = wrap_angle(innovation[2])
    spread = foreseen.covariance[:4, :4] + mode.covariance
    gain = np.linalg.solve(spread, foreseen.covariance[:4]).T
    mean = foreseen.mean + gain @ innovation
    covariance = foreseen.covariance - gain @ foreseen.covariance[:4]
    square = float(innovation @ np.linalg.solve(spread, innovation))
    # The evidence already integrates over a wide prior of the state; Student-t with 4 degrees of freedom.
    density = -4.0 * np.log1p(square / 4.0) - 0.5 * float(np.linalg.slogdet(spread)[1])
    weight = foreseen.log_weight + log_evidence + density
    return Hypothesis(mean, (covariance + covariance.T) / 2, weight, mode)


def _started(mode: Fit) -> Hypothesis:
    covariance = np.zeros((6, 6))
    covariance[:4, :4] = mode.covariance
    covariance[4:, 4:] = np.eye(2) * _START_STEP_M**2
    return Hypothesis(np.concatenate([mode.state, np.zeros(2)]), covariance, -mode.cost, mode)


def _normalised(hypotheses: list[Hypothesis], config: TrajectoryConfig) -> list[Hypothesis]:
    """The best hypotheses, the best at log weight 0; the number kept is twice that of the modes."""
    kept = sorted(hypotheses, key=lambda h: -h.log_weight)[: 2 * config.n_modes]
    top = kept[0].log_weight if kept else 0.0
    return [Hypothesis(h.mean, h.covariance, h.log_weight - top, h.mode) for h in kept]


def _poses(estimates: Sequence[ChannelEstimate], best: Sequence[Hypothesis | None]) -> PoseEstimates:
    state = np.array([np.full(4, np.nan) if h is None else h.mean[:4] for h in best]).reshape(-1, 4)
    status, inliers = [], []
    for h in best:
        mode = None if h is None else h.mode
        solved = SolveStatus.NLOS if mode is None or not mode.is_los.any() else SolveStatus.LOS
        status.append(SolveStatus.FAILED if mode is None else solved)
        inliers.append(0 if mode is None else int(np.count_nonzero(mode.is_inlier)))
    return PoseEstimates(
        stop=np.array([estimate.stop for estimate in estimates], dtype=int),
        position_m=state[:, :2],
        heading_rad=wrap_angle(state[:, 2]),
        clock_bias_s=state[:, 3] / SPEED_OF_LIGHT_M_S,
        status=np.array(status, dtype=int),
        n_inliers=np.array(inliers, dtype=int),
        cost=np.array([np.nan if h is None else -h.log_weight for h in best]),
    )
