"""Trajectory SLAM: all stops together, with a motion prior, shared landmarks and session offsets.

`run_trajectory` chooses among the ranked modes of every stop (Viterbi). Then it alternates between the
association of paths (walls, compact objects, other single bounces, double bounces) and robust least squares over
all unknowns. Sessions are split where the TX heading offset jumps.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.laws.raised import PathHeights
from estimation.slam.config import MappingConfig, SnapshotConfig, TrajectoryConfig
from estimation.slam.influence import shifts_without, widened, with_influence
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.slam.snapshot.evidence import power_law
from estimation.slam.snapshot.problem import Fit, SnapshotProblem, snapshot_problem
from estimation.slam.snapshot.solve import ranked_modes
from estimation.slam.transmitters import AnyTx, map_each_tx, transmitters_of
from estimation.slam.walk.alternation import smooth_walk
from estimation.slam.walk.modes import Rivals, choose_modes, rival_modes, with_places
from estimation.slam.walk.motion import course_of, leaps
from estimation.slam.walk.neighbours import interpolated
from estimation.slam.walk.relocate import LEAST_EVIDENCE, DoubtfulStops, Powers
from estimation.slam.walk.residuals import (
    LEAST_SPARE,
    SINGLE_BOUNCES,
    Association,
    Observations,
    PathClass,
    TrajectoryState,
    observations,
    spare_equations,
)
from estimation.slam.walk.smoother import robust_cost, solution_covariance
from estimation.steps import steps
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray, Record, array


@dataclass(frozen=True)
class TrajectoryDetails(Record):
    """Results of the smoother beside poses and incidence points.

    Walls are lines n' q = offset with n = [cos, sin] of the azimuth. Session offsets are relative to the
    `anchor` session: a common offset turns everything about the TX and is unobservable.
    """

    mode: IntArray = array("stop", dtype=int, doc="rank of the mode chosen; -1 where the stop is in none")
    session: IntArray = array("stop", dtype=int, doc="session of every stop")
    tx_offset_rad: FloatArray = array(
        "offset", unit="rad", doc="offset of the TX heading in every session; of every TX, session after session"
    )
    tx_offset_std_rad: FloatArray = array("offset", unit="rad", doc="its standard deviation; 0 for the anchor")
    walls: FloatArray = array("wall", "line", doc="azimuth of the normal in rad, offset in m")
    wall_covariance: FloatArray = array("wall", "line", "line2", doc="of the walls")
    objects: FloatArray = array("object", "circle", unit="m", doc="x, y and radius of compact objects")
    object_covariance: FloatArray = array("object", "circle", "circle2", unit="m^2", doc="of the objects")
    path_stop: IntArray = array("path", dtype=int, doc="stop of every path, in the order of the estimates")
    path_kind: IntArray = array("path", dtype=int, doc="PathClass: kind of the path")
    path_influence_m: FloatArray = array(
        "path", unit="m", doc="by which its stop moves without it; NaN if not used"
    )


def run_trajectory(
    estimates: Sequence[ChannelEstimate],
    tx_pose: AnyTx,
    snapshot: SnapshotConfig,
    config: TrajectoryConfig,
    mapping_config: MappingConfig,
    heights: Sequence[PathHeights] | None = None,
) -> tuple[PoseEstimates, IncidencePoints, TrajectoryDetails]:
    """Poses, incidence points and shared landmarks of a whole campaign; stops in the order of the walk.

    Stops in no snapshot mode that no landmark places either have status FAILED and the state smoothed from their
    neighbours. IPs are mapped for solved stops. With the `heights` of the paths of every stop, points that are
    higher or lower than the devices are landmarks too.
    """
    problems = [snapshot_problem(estimate, tx_pose, snapshot.noise) for estimate in estimates]
    ranked = snapshot.model_copy(update={"method": "statistical"})
    modes = [ranked_modes(problem, ranked) for problem in steps(problems, "stop")]
    chosen = choose_modes(modes, config)
    seen = observations(problems, tx_pose, snapshot.noise.floor)
    if heights is not None:
        seen = replace(seen, heights=PathHeights(*(np.concatenate(each) for each in zip(*heights, strict=True))))
    is_los = _lines_of_sight(problems, modes, chosen)
    if np.all(chosen < 0):
        return _unsolved(estimates, seen, tx_pose, mapping_config)
    start = initial_state(modes, chosen, seen)
    rivals = rival_modes(modes, chosen, config)
    doubtful = _doubtful(problems, modes, rivals, is_los, snapshot) if seen.n_tx == 1 else None
    walk = smooth_walk(seen, is_los, start, config, doubtful)
    now, link, (seen, config), is_los, places = walk
    is_known = chosen >= 0
    for stop, place in places.items():
        is_known[stop] |= place.evidence > LEAST_EVIDENCE and place.position_std_m < snapshot.max_position_std_m
    covariance, shared_covariance = solution_covariance(seen, link, now, config)
    shift = shifts_without(seen, link, now, config)
    covariance = widened(covariance, shift, seen.row)
    cost = robust_cost(seen, link, now, config) / seen.n_stops
    poses = _poses(estimates, now, link, seen, is_known, is_los, cost)
    from_tx = now.state[:, :2] - transmitters_of(tx_pose).rows[0, :2]
    covariance[:, :4, :4] += snapshot.consider.covariance(from_tx)
    is_sure = (spare_equations(seen, link) >= LEAST_SPARE) & ~leaps(now.state)
    poses = _with_covariance(poses, covariance, with_places(rivals, places), is_sure, snapshot)
    details = _details(now, link, seen, chosen, shared_covariance, np.hypot(*shift[:, :2].T))
    shifted, joint = turn_departures(estimates, details), list(poses.covariance)
    flags = flags_by_stop(estimates, details)
    points = map_each_tx(map_stops, shifted, poses, tx_pose, mapping_config, **flags, state_covariance=joint)
    return *with_influence(poses, points, estimates, details.path_influence_m), details


def turn_departures(estimates: Sequence[ChannelEstimate], details: TrajectoryDetails) -> list[ChannelEstimate]:
    """The channel estimates with their departures turned by the TX heading offset of their session and TX."""
    offset = details.tx_offset_rad.reshape(int(details.session.max(initial=0)) + 1, -1)[details.session]
    return [
        replace(e, aod_azimuth_rad=e.aod_azimuth_rad + shift[e.tx % len(shift)])
        for e, shift in zip(estimates, offset, strict=True)
    ]


def flags_by_stop(estimates: Sequence[ChannelEstimate], details: TrajectoryDetails) -> dict[str, list[BoolArray]]:
    """`is_los` and `is_inlier` (path,) of every stop for mapping: lines of sight and single bounces."""
    kinds = np.split(details.path_kind, np.cumsum([len(e) for e in estimates])[:-1])
    return {
        "is_los": [k == PathClass.LOS for k in kinds],
        "is_inlier": [np.isin(k, SINGLE_BOUNCES) for k in kinds],
    }


def initial_state(modes: Sequence[Sequence[Fit]], chosen: IntArray, seen: Observations) -> TrajectoryState:
    """The chosen modes; stops in none are interpolated from their neighbours.

    So is the clock bias against a TX of which the mode has no path.
    """
    n = len(modes)
    solved = np.flatnonzero(chosen >= 0)
    fits = [modes[k][chosen[k]] for k in solved.tolist()]
    states = np.array([fit.state for fit in fits])
    filled = interpolated(states, solved, np.arange(n))
    for tx in range(seen.n_tx if seen.n_tx > 1 else 0):
        own = [seen.link[seen.row == k] == tx for k in solved]
        known = [bool(fit.is_inlier[mine].any()) for fit, mine in zip(fits, own, strict=True)]
        if any(known):
            filled[:, 3 + tx] = np.interp(np.arange(n), solved[known], states[known, 3 + tx])
    return TrajectoryState(
        state=filled,
        offset_rad=np.zeros(seen.n_tx),
        walls=np.empty((0, 2)),
        objects=np.empty((0, 3)),
        session=np.zeros(n, dtype=np.int64),
        anchor=0,
        course=course_of(filled),
    )


def _lines_of_sight(
    problems: Sequence[SnapshotProblem], modes: Sequence[Sequence[Fit]], chosen: IntArray
) -> BoolArray:
    parts = [
        fits[m].is_los if m >= 0 else np.zeros(len(problem), bool)
        for problem, fits, m in zip(problems, modes, chosen, strict=True)
    ]
    return np.concatenate([np.empty(0, bool), *parts])


def _doubtful(
    problems: Sequence[SnapshotProblem],
    modes: Sequence[Sequence[Fit]],
    rivals: Rivals,
    is_los: BoolArray,
    snapshot: SnapshotConfig,
) -> DoubtfulStops:
    """Stops in no mode, with a near rival, or without a line of sight."""
    ends = np.cumsum([len(problem) for problem in problems])
    has_los = np.array([part.any() for part in np.split(is_los, ends[:-1])])
    is_doubtful = ~has_los | ~(rivals.gap >= snapshot.ambiguous_gap)
    starts = [np.reshape([fit.state for fit in fits], (-1, 4)) for fits in modes]
    powers = [Powers(problem.power_dbm, power_law(snapshot.path_loss)) for problem in problems]
    return DoubtfulStops(np.asarray(is_doubtful), starts, powers, snapshot.max_clock_bias_m)


def _poses(
    estimates: Sequence[ChannelEstimate],
    now: TrajectoryState,
    link: Association,
    seen: Observations,
    is_known: BoolArray,
    is_los: BoolArray,
    cost: float,
) -> PoseEstimates:
    n = seen.n_stops
    has_los = np.bincount(seen.row[is_los], minlength=n) > 0
    status = np.where(has_los, SolveStatus.LOS, np.where(is_known, SolveStatus.NLOS, SolveStatus.FAILED))
    return PoseEstimates(
        stop=np.array([estimate.stop for estimate in estimates], dtype=int),
        position_m=now.state[:, :2],
        heading_rad=wrap_angle(now.state[:, 2]),
        clock_bias_s=now.state[:, 3] / SPEED_OF_LIGHT_M_S,
        tx_clock_bias_s=now.state[:, 3:] / SPEED_OF_LIGHT_M_S,
        status=status,
        n_inliers=np.bincount(seen.row[link.kind != PathClass.UNUSED], minlength=n),
        cost=np.full(n, cost),
        is_of_walk=np.ones(n, bool),
    )


def _with_covariance(
    poses: PoseEstimates, covariance: FloatArray, rivals: Rivals, is_sure: BoolArray, snapshot: SnapshotConfig
) -> PoseEstimates:
    """Poses with covariances (stop, state, state) in m and rad, and the evidence of the chosen modes.

    A stop is ambiguous where a rival mode is near, or where it is not sure: few equations beyond the unknowns of
    its state, or a leap of the walk.
    """
    scale = np.append(np.ones(3), np.full(poses.n_tx, 1 / SPEED_OF_LIGHT_M_S))
    return replace(
        poses,
        covariance=covariance * np.outer(scale, scale),
        evidence_gap=rivals.gap,
        is_ambiguous=(rivals.gap < snapshot.ambiguous_gap) | ~is_sure,
        alternative=rivals.state * scale,
        los_probability=rivals.los_probability,
        position_std_m=np.sqrt(covariance[:, 0, 0] + covariance[:, 1, 1] + rivals.square_m2),
    )


def _details(
    now: TrajectoryState,
    link: Association,
    seen: Observations,
    chosen: IntArray,
    shared: FloatArray,
    influence_m: FloatArray,
) -> TrajectoryDetails:
    sessions, walls = len(now.offset_rad), len(now.walls)
    offset_std = np.sqrt(np.diag(shared)[:sessions])
    if now.n_tx == 1:
        offset_std[now.anchor] = 0.0
    return TrajectoryDetails(
        mode=chosen,
        session=now.session,
        tx_offset_rad=now.offset_rad,
        tx_offset_std_rad=offset_std,
        walls=now.walls,
        wall_covariance=_blocks(shared, sessions, walls, 2),
        objects=now.objects,
        object_covariance=_blocks(shared, sessions + 2 * walls, len(now.objects), 3),
        path_stop=seen.row,
        path_kind=link.kind,
        path_influence_m=influence_m,
    )


def _unsolved(
    estimates: Sequence[ChannelEstimate], seen: Observations, tx_pose: AnyTx, config: MappingConfig
) -> tuple[PoseEstimates, IncidencePoints, TrajectoryDetails]:
    """The result where no stop has a mode."""
    n, m = seen.n_stops, len(seen.row)
    chosen, session = np.full(n, -1), np.zeros(n, dtype=np.int64)
    walls, objects, course = np.empty((0, 2)), np.empty((0, 3)), np.empty((0, 2))
    state, offset = np.full((n, 3 + seen.n_tx), np.nan), np.zeros(seen.n_tx)
    now = TrajectoryState(state, offset, walls, objects, session, 0, course)
    link = Association(np.full(m, PathClass.UNUSED), np.full((m, 2), -1))
    poses = _poses(estimates, now, link, seen, chosen >= 0, np.zeros(m, bool), np.nan)
    details = _details(now, link, seen, chosen, np.zeros((seen.n_tx, seen.n_tx)), np.full(m, np.nan))
    return poses, map_each_tx(map_stops, estimates, poses, tx_pose, config), details


def _blocks(matrix: FloatArray, first: int, n: int, size: int) -> FloatArray:
    index = first + size * np.arange(n)[:, None] + np.arange(size)
    return np.asarray(matrix[index[:, :, None], index[:, None, :]])
