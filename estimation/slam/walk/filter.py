"""SLAM stop by stop: an online filter over the ranked modes of each stop.

Several hypotheses are kept, each a Gaussian over the state of the last stop and its displacement. Every stop
adds one branch per mode and one without a mode. A branch is weighted by the evidence of the mode and by the
predictive density of its state. States are [x, y, heading, bias] in the plane and [x, y, z, heading, bias] in
space, in m and rad.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.config import MappingConfig, SnapshotConfig, TrajectoryConfig
from estimation.slam.mapped_solutions import collect_and_map
from estimation.slam.record import IncidencePoints, PoseEstimates
from estimation.slam.snapshot.problem import Fit, snapshot_problem
from estimation.slam.snapshot.solution import SnapshotSolution, failed_solution, solution_of
from estimation.slam.snapshot.solve import ranked_modes
from estimation.slam.snapshot.statistical import N_RANKED
from estimation.slam.space.problem import is_spatial, spatial_problem
from estimation.slam.space.snapshot import ranked_spatial_modes
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle
from scenes.record import FloatArray

_NONE_COST = 12.0  # penalty in log evidence of a stop that is in none of its modes
_START_STEP_M = 2.0
_SAME_M, _SAME_RAD = 0.3, np.deg2rad(5.0)  # hypotheses of one mode


@dataclass(frozen=True)
class Hypothesis:
    """A Gaussian over the state and the displacement [dx, dy] since the last stop; the mode last taken."""

    mean: FloatArray  # (state + 2,)
    covariance: FloatArray  # (state + 2, state + 2)
    log_weight: float
    mode: Fit | None

    @property
    def n_state(self) -> int:
        """Components of the state."""
        return len(self.mean) - 2


def run_filter(
    estimates: Sequence[ChannelEstimate],
    tx_pose: Pose,
    snapshot: SnapshotConfig,
    config: TrajectoryConfig,
    mapping_config: MappingConfig,
) -> tuple[PoseEstimates, IncidencePoints]:
    """State of every stop from that stop and those before it, and the incidence points mapped from it.

    The status is FAILED until the first solved stop, and at stops in none of their modes, which have the predicted
    state. The best hypothesis gives the status; the others give the gap, the alternative and the probability of a
    line of sight. The modes are those of the statistical method, in space where elevations were estimated and
    `snapshot.solves_in_space`.
    """
    spatial = is_spatial(estimates, use_elevation=snapshot.solves_in_space)
    ranked = snapshot.model_copy(update={"method": "statistical"})
    hypotheses: list[Hypothesis] = []
    solutions: list[SnapshotSolution] = []
    for estimate in estimates:
        if spatial:
            modes = ranked_spatial_modes(spatial_problem(estimate, tx_pose, ranked.noise), ranked)
        else:
            modes = ranked_modes(snapshot_problem(estimate, tx_pose, ranked.noise), ranked)
        hypotheses = advance_hypotheses(hypotheses, modes, config)
        solutions.append(_solution(estimate, tx_pose, hypotheses, snapshot, 5 if spatial else 4))
    return collect_and_map(estimates, solutions, tx_pose, mapping_config, spatial=spatial)


def advance_hypotheses(
    hypotheses: Sequence[Hypothesis], modes: Sequence[Fit], config: TrajectoryConfig
) -> list[Hypothesis]:
    """Hypotheses after one more stop with these modes, best first."""
    if not hypotheses:
        return _normalised([_initial(mode) for mode in modes])
    evidence = np.array([-mode.cost for mode in modes])
    relative = evidence - evidence.max(initial=-np.inf) if len(evidence) else evidence
    branches = []
    for before in hypotheses:
        ahead = predict_hypothesis(before, config)
        lost = _NONE_COST if modes else 0.0
        branches.append(Hypothesis(ahead.mean, ahead.covariance, before.log_weight - lost, None))
        branches += [
            update_hypothesis(ahead, mode, float(gain)) for mode, gain in zip(modes, relative, strict=True)
        ]
    return _normalised(branches)


def predict_hypothesis(before: Hypothesis, config: TrajectoryConfig) -> Hypothesis:
    """One stop ahead at the last displacement, with the scatter of the motion prior."""
    n = before.n_state
    move = np.eye(n + 2)
    move[[0, 1], [n, n + 1]] = 1.0
    scatter = max(config.cross_track_std_m, config.along_track_std_m) ** 2
    level = [config.cross_track_std_m**2] * (n - 4)
    noise = np.diag(
        [scatter, scatter, *level, config.heading_step_rad**2, config.clock_step_m**2, scatter, scatter]
    )
    noise[[0, 1], [n, n + 1]] = noise[[n, n + 1], [0, 1]] = 0.999 * scatter
    covariance = move @ before.covariance @ move.T + noise
    return Hypothesis(move @ before.mean, covariance, before.log_weight, None)


def update_hypothesis(ahead: Hypothesis, mode: Fit, log_evidence: float) -> Hypothesis:
    """Kalman update with the state and covariance of a mode; the weight gains the predictive log density."""
    n = ahead.n_state
    innovation = mode.state - ahead.mean[:n]
    innovation[n - 2] = wrap_angle(innovation[n - 2])
    spread = ahead.covariance[:n, :n] + mode.covariance
    gain = np.linalg.solve(spread, ahead.covariance[:n]).T
    mean = ahead.mean + gain @ innovation
    covariance = ahead.covariance - gain @ ahead.covariance[:n]
    square = float(innovation @ np.linalg.solve(spread, innovation))
    # The evidence already integrates over a wide prior of the state; Student-t with 4 degrees of freedom.
    density = -(4.0 + n) / 2 * np.log1p(square / 4.0) - 0.5 * float(np.linalg.slogdet(spread)[1])
    weight = ahead.log_weight + log_evidence + density
    return Hypothesis(mean, (covariance + covariance.T) / 2, weight, mode)


def _initial(mode: Fit) -> Hypothesis:
    n = len(mode.state)
    covariance = np.zeros((n + 2, n + 2))
    covariance[:n, :n] = mode.covariance
    covariance[n:, n:] = np.eye(2) * _START_STEP_M**2
    return Hypothesis(np.concatenate([mode.state, np.zeros(2)]), covariance, -mode.cost, mode)


def _normalised(hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """The best hypotheses, twice as many as modes, with log weights relative to the best."""
    kept = sorted(hypotheses, key=lambda h: -h.log_weight)[: 2 * N_RANKED]
    top = kept[0].log_weight if kept else 0.0
    return [Hypothesis(h.mean, h.covariance, h.log_weight - top, h.mode) for h in kept]


def _solution(
    estimate: ChannelEstimate,
    tx_pose: Pose,
    hypotheses: Sequence[Hypothesis],
    config: SnapshotConfig,
    n_state: int,
) -> SnapshotSolution:
    """The best hypothesis as the solution of a stop; the best ones at other positions are its further modes."""
    if not hypotheses:
        return failed_solution(estimate, n_state, n_state - 2)
    if hypotheses[0].mode is None:
        return _predicted_solution(estimate, tx_pose, hypotheses[0], config)
    fits: list[Fit] = []
    for h in hypotheses:
        if h.mode is None:
            continue
        state = h.mean[:n_state].copy()
        state[n_state - 2] = wrap_angle(state[n_state - 2])
        if all(_differ(state, fit.state) for fit in fits):
            fits.append(
                Fit(state, h.mode.is_inlier, h.mode.is_los, -h.log_weight, h.covariance[:n_state, :n_state])
            )
    return solution_of(estimate, tx_pose, fits, config, n_state - 2)


def _predicted_solution(
    estimate: ChannelEstimate, tx_pose: Pose, best: Hypothesis, config: SnapshotConfig
) -> SnapshotSolution:
    """The predicted state of a stop in none of its modes, with status FAILED."""
    n = best.n_state
    scale = np.append(np.ones(n - 1), 1 / SPEED_OF_LIGHT_M_S)
    offset = best.mean[: n - 2] - tx_pose.position_m[: n - 2]
    covariance = best.covariance[:n, :n] + config.consider.covariance(offset)
    state = best.mean[:n] * scale
    return replace(
        failed_solution(estimate, n, n - 2),
        position_m=state[: n - 2],
        heading_rad=float(wrap_angle(state[n - 2])),
        clock_bias_s=state[n - 1],
        covariance=covariance * np.outer(scale, scale),
    )


def _differ(a: FloatArray, b: FloatArray) -> bool:
    turn = abs(wrap_angle(a[-2] - b[-2]))
    return bool(np.linalg.norm(a[:-2] - b[:-2]) > _SAME_M or turn > _SAME_RAD)
