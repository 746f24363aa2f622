"""Trajectory SLAM in space: all stops of a walk with elevations together.

A walk in space is solved in two steps. Upright surfaces, floors and ceilings keep the absolute elevation of a
ray. Seen from above, a path is therefore a path of the plane, shorter by the cosine of the elevation. So all
paths are projected on the plane, and the smoother of the plane shares walls and objects between stops. The
projection needs the clock biases, first those of the stops alone: both are done in turns. Heights follow stop by
stop.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.inference.least_squares import student_t_efficiency
from estimation.laws.space import bounce_equations
from estimation.slam.config import MappingConfig, SnapshotConfig, TrajectoryConfig
from estimation.slam.influence import with_influence
from estimation.slam.level import interpolated
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.slam.snapshot.solution import PLANE_OF_SPACE, SnapshotSolution
from estimation.slam.space.mapping import map_stops_spatial
from estimation.slam.space.problem import SpatialProblem, bounce_fit, los_fit, spatial_problem
from estimation.slam.space.snapshot import solve_spatial
from estimation.slam.walk.residuals import SINGLE_BOUNCES, PathClass
from estimation.slam.walk.trajectory import TrajectoryDetails, flags_by_stop, run_trajectory, turn_departures
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, FloatArray, IntArray

_HEIGHT_ROUNDS = 10
_WEAK_HEIGHT_M = 3.0  # standard deviation of a height that no path shows: that of its neighbours
_MAX_TURNS = 4  # of projection and walk
_SETTLED_M = 1e-3  # change of the clock biases that ends the turns


def run_spatial_trajectory(
    estimates: Sequence[ChannelEstimate],
    tx_pose: Pose,
    snapshot: SnapshotConfig,
    config: TrajectoryConfig,
    mapping_config: MappingConfig,
) -> tuple[PoseEstimates, IncidencePoints, TrajectoryDetails]:
    """Poses, incidence points and shared landmarks of a walk with elevations; stops in the order of the walk."""
    alone = [solve_spatial(estimate, tx_pose, snapshot) for estimate in estimates]
    # The floors are those of the plane: the walk may lower them.
    no_floors = {"floor_delay_std_ns": 0.0, "floor_angle_std_deg": 0.0}
    own = snapshot.noise.model_copy(update=no_floors)
    problems = [spatial_problem(estimate, tx_pose, own) for estimate in estimates]
    in_plane_noise = snapshot.noise if snapshot.noise.source == "estimate" else own
    in_plane = snapshot.model_copy(update={"noise": in_plane_noise.model_copy(update={"source": "estimate"})})
    solutions = alone
    for _ in range(_MAX_TURNS):
        flat = project_on_plane(estimates, problems, solutions)
        poses, _, details = run_trajectory(flat, tx_pose, in_plane, config, mapping_config)
        kinds = np.split(details.path_kind, np.cumsum([len(e) for e in estimates])[:-1])
        before, solutions = solutions, _walked(alone, poses, kinds)
        moved_s = np.abs([one.clock_bias_s - two.clock_bias_s for one, two in zip(before, solutions, strict=True)])
        if SPEED_OF_LIGHT_M_S * np.max(moved_s, initial=0.0) < _SETTLED_M:
            break
    shifted = turn_departures(estimates, details)
    problems = [spatial_problem(estimate, tx_pose, snapshot.noise) for estimate in shifted]
    guess = interpolated(np.array([s.position_m[2] for s in alone]), tx_pose.position_m[2])
    joint = np.array(
        [
            _with_height(problem, kind, _state(poses, k, guess[k]), poses.covariance[k], snapshot)
            for k, (problem, kind) in enumerate(zip(problems, kinds, strict=True))
        ]
    ).reshape(-1, 26)
    covariance = joint[:, 1:].reshape(-1, 5, 5)
    poses = replace(
        poses,
        height_m=joint[:, 0],
        height_std_m=np.sqrt(covariance[:, 2, 2]),
        height_covariance=covariance[:, 2, PLANE_OF_SPACE],
    )
    flags, known = flags_by_stop(estimates, details), list(np.nan_to_num(covariance))
    points = map_stops_spatial(shifted, poses, tx_pose, mapping_config, **flags, state_covariance=known)
    return *with_influence(poses, points, estimates, details.path_influence_m), details


def _walked(
    alone: Sequence[SnapshotSolution], poses: PoseEstimates, kinds: Sequence[IntArray]
) -> list[SnapshotSolution]:
    """The stops where the walk has them, at the heights that they have alone."""
    height_m = interpolated(np.array([solution.position_m[2] for solution in alone]), 0.0)
    return [
        replace(
            solution,
            status=SolveStatus(int(poses.status[k])),
            position_m=np.array([*poses.position_m[k], height_m[k]]),
            heading_rad=float(poses.heading_rad[k]),
            clock_bias_s=float(poses.clock_bias_s[k]),
            is_los=kinds[k] == PathClass.LOS,
        )
        for k, solution in enumerate(alone)
    ]


def project_on_plane(
    estimates: Sequence[ChannelEstimate], problems: Sequence[SpatialProblem], solutions: Sequence[SnapshotSolution]
) -> list[ChannelEstimate]:
    """The paths of all stops as paths of the plane: lengths less the clock bias, times the elevation's cosine.

    Each leg counts with its share of the length. The bias is that of the solution, interpolated where that failed:
    an error b of it changes a length by b (1 - cosine) only. Covariances are propagated.
    """
    bias = interpolated(np.array([SPEED_OF_LIGHT_M_S * s.clock_bias_s for s in solutions]), 0.0)
    return [
        _project(estimate, problem, solution, float(bias[k]))
        for k, (estimate, problem, solution) in enumerate(zip(estimates, problems, solutions, strict=True))
    ]


def _project(
    estimate: ChannelEstimate, problem: SpatialProblem, solution: SnapshotSolution, bias_m: float
) -> ChannelEstimate:
    elevations = problem.measured[:, 3:].copy()
    known = np.isfinite(np.column_stack([estimate.aod_elevation_rad, estimate.aoa_elevation_rad]))
    # Specular surfaces keep the absolute elevation: an unknown end has that of the other.
    elevations = np.where(known, elevations, elevations[:, ::-1])
    share = np.full(len(estimate), 0.5)
    if solution.status != SolveStatus.FAILED:
        state = np.array([*solution.position_m, solution.heading_rad, SPEED_OF_LIGHT_M_S * solution.clock_bias_s])
        fraction = bounce_equations(problem.tx, state, problem.measured).fraction
        share = np.clip(np.where(solution.is_los, 0.5, np.nan_to_num(fraction, nan=0.5)), 0.0, 1.0)
    shares = np.column_stack([share, 1 - share])
    cosine = np.sum(shares * np.cos(elevations), axis=1)
    length = problem.measured[:, 0] - bias_m
    jacobian = np.zeros((len(estimate), 3, 5))
    jacobian[:, 0, 0], jacobian[:, 1, 1], jacobian[:, 2, 2] = cosine, 1.0, 1.0
    jacobian[:, 0, 3:] = -length[:, None] * shares * np.sin(elevations) * known
    covariance = jacobian @ problem.covariance @ np.swapaxes(jacobian, 1, 2)
    to_seconds = np.array([1 / SPEED_OF_LIGHT_M_S, 1.0, 1.0])
    return replace(
        estimate,
        delay_s=(bias_m + length * cosine) / SPEED_OF_LIGHT_M_S,
        covariance=covariance * np.outer(to_seconds, to_seconds),
        aod_elevation_rad=np.full(len(estimate), np.nan),
        aoa_elevation_rad=np.full(len(estimate), np.nan),
    )


def _with_height(
    problem: SpatialProblem,
    kind: IntArray,
    state: FloatArray,
    plane_covariance: FloatArray,
    snapshot: SnapshotConfig,
) -> FloatArray:
    """Height of one stop and the covariance of its state in space, flat (26,): height, then 5 x 5.

    Robust least squares in the height alone; the uncertainty of the plane's state is propagated to it.
    """
    used = np.isin(kind, SINGLE_BOUNCES)
    los = np.flatnonzero(kind == PathClass.LOS)
    if not np.isfinite(state).all():
        return np.full(26, np.nan)
    freedom = snapshot.mixture.degrees_of_freedom
    state = state.copy()
    for _ in range(_HEIGHT_ROUNDS):
        value, slope, weight = _residuals(problem, state, used, los, freedom)
        step = float(np.sum(weight * slope[:, 2] * value) / max(np.sum(weight * slope[:, 2] ** 2), 1e-12))
        state[2] -= step
        if abs(step) < 1e-9:
            break
    value, slope, weight = _residuals(problem, state, used, los, freedom)
    weight = np.full(len(value), student_t_efficiency(freedom, 1))
    information = float(np.sum(weight * slope[:, 2] ** 2)) + _WEAK_HEIGHT_M**-2
    lean = -np.sum((weight * slope[:, 2])[:, None] * slope[:, PLANE_OF_SPACE], axis=0) / information
    to_metres = np.array([1.0, 1.0, 1.0, SPEED_OF_LIGHT_M_S])
    plane = plane_covariance * np.outer(to_metres, to_metres)
    covariance = np.zeros((5, 5))
    covariance[np.ix_(PLANE_OF_SPACE, PLANE_OF_SPACE)] = plane
    covariance[2, PLANE_OF_SPACE] = covariance[PLANE_OF_SPACE, 2] = plane @ lean
    covariance[2, 2] = 1 / information + lean @ plane @ lean
    to_seconds = np.array([1.0, 1.0, 1.0, 1.0, 1 / SPEED_OF_LIGHT_M_S])
    return np.concatenate([[state[2]], (covariance * np.outer(to_seconds, to_seconds)).ravel()])


def _residuals(
    problem: SpatialProblem, state: FloatArray, used: BoolArray, los: IntArray, freedom: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Whitened residuals (n,), derivatives (n, 5) and weights (n,): bounces first, then the line of sight."""
    fit = bounce_fit(problem, state[None])
    value, slope = fit.white[0, used].ravel(), fit.jacobian[0, used].reshape(-1, 5)
    if len(los):
        direct, by_state = los_fit(problem, state[None], int(los[0]))
        value, slope = np.concatenate([value, direct[0]]), np.concatenate([slope, by_state[0]])
    return value, slope, (freedom + 1) / (freedom + value**2)


def _state(poses: PoseEstimates, k: int, height_m: float) -> FloatArray:
    bias = SPEED_OF_LIGHT_M_S * poses.clock_bias_s[k]
    return np.array([*poses.position_m[k], height_m, poses.heading_rad[k], bias])
