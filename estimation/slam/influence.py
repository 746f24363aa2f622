"""How far the state of a stop moves when one of its paths is left out, in closed form."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.config import SnapshotConfig, TrajectoryConfig
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.slam.snapshot.problem import snapshot_problem
from estimation.slam.snapshot.solution import SnapshotSolution
from estimation.slam.transmitters import AnyTx
from estimation.slam.walk.linearise import Linearised, linearise
from estimation.slam.walk.residuals import Association, Observations, PathClass, TrajectoryState, observations
from estimation.slam.walk.smoother import system_at
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray, IntArray

_SMALLEST = 1e-14  # of the variances of a state in unit scale: rounding alone could make less
_KNOWN_DEG = 1e-6  # of the heading of a TX: a stop alone takes it as given


def shifts_without(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> FloatArray:
    """Change (path, state) of the state of its stop without a path; NaN for paths not in use.

    States are x, y, heading and clock biases in m, m, rad, m. Everything is solved again without the path,
    linearised at the solution, with the weights that the other paths have there. With C the covariance of all
    unknowns, and J, v, w the slopes, residuals and weight of the path, its removal moves them by
    C J' (1 / w - J C J')^-1 v (Woodbury).
    """
    paths, n_state = linearise(seen, link, now, config), now.state.shape[1]
    weight = paths.weight(config.degrees_of_freedom)
    covariance = system_at(paths, now, config).covariance()
    used = np.flatnonzero(weight)
    order = used[np.argsort(paths.row[used], kind="stable")]
    shift = np.full((len(seen.row), n_state), np.nan)
    for own in np.split(order, np.flatnonzero(np.diff(paths.row[order])) + 1) if len(order) else ():
        stop, shared = paths.row[own[0]], np.unique(paths.shared[own])
        shared = shared[shared >= 0]
        across = covariance.across[stop][:, shared]
        among = covariance.shared[np.ix_(shared, shared)]
        joint = np.block([[covariance.states[stop], across], [across.T, among]])
        slope = _slopes(paths, own, shared, n_state)
        through = slope @ joint
        free = np.eye(3) / weight[own, None, None] - through @ np.swapaxes(slope, 1, 2)
        pull = np.linalg.solve(free, paths.value[own, :, None])
        shift[own] = np.einsum("pdu,pd->pu", through[:, :, :n_state], pull[..., 0])
    return shift


def widened(covariance: FloatArray, shift: FloatArray, row: IntArray) -> FloatArray:
    """Covariances (stop, state, state), in every direction at least those of the jackknife.

    These sum the squares of the `shift` (path, state) without each of the paths, at the stops `row` (path,): what
    paths actually disagree, whatever they state (HC3 of MacKinnon and White, 1985).
    """
    known = np.flatnonzero(np.isfinite(shift).all(axis=1))
    own = shift[known]
    jackknife = np.zeros_like(covariance)
    np.add.at(jackknife, row[known], own[:, :, None] * own[:, None])
    scale = np.sqrt(np.einsum("nii->ni", covariance))[:, :, None]
    square, rotation = np.linalg.eigh(covariance / (scale * np.swapaxes(scale, 1, 2)))
    std = np.sqrt(np.maximum(square, _SMALLEST))[:, None]
    to_white = np.swapaxes(rotation / std / scale, 1, 2)
    value, vector = np.linalg.eigh(to_white @ jackknife @ np.swapaxes(to_white, 1, 2))
    axes = (scale * rotation * std) @ vector
    wide: FloatArray = (axes * np.maximum(value, 1.0)[:, None]) @ np.swapaxes(axes, 1, 2)
    is_wider = np.any(value > 1.0, axis=1)
    return np.where(is_wider[:, None, None], wide, covariance)


def stop_influence(
    estimate: ChannelEstimate, tx_pose: AnyTx, solution: SnapshotSolution, config: SnapshotConfig
) -> FloatArray:
    """Distance (path,) in m by which a stop that was solved alone in the plane moves without a path.

    NaN for paths not in use, and for all where the stop failed.
    """
    if solution.status == SolveStatus.FAILED:
        return np.full(len(estimate), np.nan)
    seen = observations([snapshot_problem(estimate, tx_pose, config.noise)], tx_pose, np.zeros((3, 3)))
    kind = np.select([solution.is_los, solution.is_inlier], [PathClass.LOS, PathClass.BOUNCE], PathClass.UNUSED)
    state = solution.mode_state[:1].copy()
    state[:, 3:] *= SPEED_OF_LIGHT_M_S
    headings, none = np.zeros(state.shape[1] - 3), np.empty((0, 3))
    now = TrajectoryState(state, headings, none[:, :2], none, np.zeros(1, int), 0, none[:, :2])
    link = Association(kind, np.full((len(kind), 2), -1))
    alone = TrajectoryConfig(degrees_of_freedom=config.mixture.degrees_of_freedom, offset_std_deg=_KNOWN_DEG)
    return np.asarray(np.hypot(*shifts_without(seen, link, now, alone)[:, :2].T))


def _slopes(paths: Linearised, own: IntArray, shared: IntArray, n_state: int) -> FloatArray:
    """Derivatives (path, 3, unknown) of the residuals of `own` paths by the state and the `shared` unknowns."""
    slope, each = np.zeros((len(own), 3, n_state + len(shared))), np.arange(len(own))
    for a, column in enumerate(paths.columns[own].T):
        slope[each, :, column] = paths.by_state[own, :, a]
    for a, column in enumerate(np.searchsorted(shared, paths.shared[own]).T):
        slope[each, :, n_state + column] += paths.by_shared[own, :, a]  # zero where there is no such unknown
    return slope


def with_influence(
    poses: PoseEstimates, points: IncidencePoints, estimates: Sequence[ChannelEstimate], influence_m: FloatArray
) -> tuple[PoseEstimates, IncidencePoints]:
    """Poses with their most influential path, and points with the influence of theirs.

    `influence_m` (path,) is that of all paths of the estimates, one stop after the other; NaN where unknown.
    """
    ends = np.cumsum([len(estimate) for estimate in estimates], dtype=int)
    of_stop = dict(zip(poses.stop.tolist(), np.split(influence_m, ends[:-1]), strict=False))
    most, largest = np.full(len(poses.stop), -1), np.full(len(poses.stop), np.nan)
    for k, own in enumerate(of_stop.values()):
        if np.isfinite(own).any():
            most[k] = np.nanargmax(own)
            largest[k] = own[most[k]]
    own_m = [of_stop[stop][path] for stop, path in zip(points.stop.tolist(), points.path.tolist(), strict=True)]
    poses = replace(poses, most_influential_path=most, path_influence_m=largest)
    return poses, replace(points, influence_m=np.array(own_m, float))
