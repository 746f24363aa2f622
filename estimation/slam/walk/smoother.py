"""The trajectory smoother: robust least squares over all stops, session offsets and shared landmarks.

Unknowns are the RX states, one offset of the TX heading per session and the landmarks. Whitened residuals are
those of the line of sight (3), of a single bounce with its IP eliminated (1), of a path off a shared landmark
(3), and of the second difference of the position, the motion prior (2).
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimation.inference.arrow import ArrowSystem
from estimation.inference.least_squares import Attempt, Schedule, minimise
from estimation.laws.raised import RAISED_STD_M
from estimation.slam.config import TrajectoryConfig
from estimation.slam.walk.linearise import Linearised, accumulate, linearise
from estimation.slam.walk.motion import add_motion, course_of, motion_cost
from estimation.slam.walk.residuals import Association, Observations, TrajectoryState
from scenes.record import FloatArray

_TOLERANCE = 1e-5  # of the cost, and of log-likelihood: a step that gains less changes no association
_MAX_ITERATIONS = 20
LANDMARK_INFORMATION = 1e-6  # of the prior of a landmark, in m^-2 and rad^-2
_WEAK_STD = (50.0, 50.0, np.pi, 50.0)  # of a state; the last is of every clock bias


def minimise_robust_cost(
    seen: Observations,
    link: Association,
    start: TrajectoryState,
    config: TrajectoryConfig,
    max_iterations: int = _MAX_ITERATIONS,
) -> TrajectoryState:
    """Levenberg-Marquardt on the robust cost, re-weighting at every step."""

    def point(now: TrajectoryState) -> _WalkPoint:
        residuals = linearise(seen, link, now, config)
        return _WalkPoint(now, residuals, _cost(residuals, now, config))

    def attempt(at: _WalkPoint, damping: float) -> Attempt[_WalkPoint]:
        step = system_at(at.residuals, at.now, config).damped(damping).solve()
        trial = point(at.now.moved(*step))
        return Attempt(trial, at.cost, trial.cost)

    schedule = Schedule(max_iterations, first=1e-4, largest=1e5, absolute=_TOLERANCE, relative=_TOLERANCE)
    return minimise(point(replace(start, course=course_of(start.state))), attempt, schedule).now


class _WalkPoint(NamedTuple):
    now: TrajectoryState
    residuals: Linearised
    cost: float


def robust_cost(seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig) -> float:
    """Minus the log-likelihood under Student-t residuals and the motion prior, up to a constant."""
    return _cost(linearise(seen, link, now, config), now, config)


def _cost(residuals: Linearised, now: TrajectoryState, config: TrajectoryConfig) -> float:
    total = residuals.cost(config.degrees_of_freedom)
    total += motion_cost(now.state, now.course, config)
    radius = (now.objects[:, 2] - config.object_radius_m) / config.object_radius_std_m
    total += 0.5 * float(np.sum(radius**2) + np.sum((now.offset_rad / config.offset_std_rad) ** 2))
    total += 0.5 * float(np.sum((now.raised[:, 2] / RAISED_STD_M) ** 2))
    if residuals.clock_information.any():
        clock_m = now.state[:, 3:]
        total += 0.5 * float(np.sum((clock_m @ residuals.clock_information) * clock_m))
    return total


def normal_equations(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> ArrowSystem:
    """Information and gradient of the re-weighted problem at the present unknowns."""
    return system_at(linearise(seen, link, now, config), now, config)


def state_equations(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> tuple[FloatArray, FloatArray]:
    """Information (stop, 4, 4) and gradient (stop, 4) of the states from the paths, all else held."""
    residuals = linearise(seen, link, now, config)
    held = replace(residuals, shared=np.full_like(residuals.shared, -1))
    terms = _path_terms(held, now, 0, config)
    return terms.diagonal, terms.gradient


def solution_covariance(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> tuple[FloatArray, FloatArray]:
    """Covariances (stop, state, state) of the states and (shared, shared) of the shared unknowns at the solution.

    Paths have their mean weight under Gaussian errors, not that of their actual errors, and steps of the walk no
    more than the mean weight of their law.
    """
    residuals = linearise(seen, link, now, config)
    weight = residuals.efficient_weight(config.degrees_of_freedom)
    states, shared, _ = system_at(residuals, now, config, weight).covariance()
    return states, shared


class _PathTerms(NamedTuple):
    """What the paths add to an `ArrowSystem`, with a weak prior of the states."""

    diagonal: FloatArray
    border: FloatArray
    corner: FloatArray
    gradient: FloatArray
    shared_gradient: FloatArray


def _path_terms(
    residuals: Linearised, now: TrajectoryState, m: int, config: TrajectoryConfig, weight: FloatArray | None = None
) -> _PathTerms:
    """The terms of `m` shared unknowns: all of them, or none where they are held."""
    n, size = now.state.shape
    weak = np.tile(np.diag(now.per_unknown(_WEAK_STD) ** -2.0), (n, 1, 1))
    terms = _PathTerms(weak, np.zeros((n, size, m)), np.zeros((m, m)), np.zeros((n, size)), np.zeros(m))
    accumulate(
        residuals.row,
        residuals.size,
        residuals.weight(config.degrees_of_freedom) if weight is None else weight,
        residuals.value,
        residuals.by_state,
        residuals.columns,
        residuals.by_shared,
        residuals.shared,
        *terms,
    )
    terms.diagonal[:, 3:, 3:] += residuals.clock_information
    terms.gradient[:, 3:] += now.state[:, 3:] @ residuals.clock_information
    return terms


def system_at(
    residuals: Linearised, now: TrajectoryState, config: TrajectoryConfig, weight: FloatArray | None = None
) -> ArrowSystem:
    """As `normal_equations`, of linearised paths; with a `weight` (path,) in place of that of their residuals."""
    diagonal, border, corner, gradient, shared_gradient = _path_terms(residuals, now, now.n_shared, config, weight)
    is_expected = weight is not None
    next1, next2 = add_motion(now.state, now.course, config, diagonal, gradient, as_expected=is_expected)
    _add_shared_priors(corner, shared_gradient, border, now, config)
    return ArrowSystem(diagonal, next1, next2, border, corner, gradient, shared_gradient)


def _add_shared_priors(
    corner: FloatArray, gradient: FloatArray, border: FloatArray, now: TrajectoryState, config: TrajectoryConfig
) -> None:
    """Priors on offsets and radii, in place; with one TX the offset of the anchor session is fixed."""
    sessions = np.arange(len(now.offset_rad))
    corner[sessions, sessions] += config.offset_std_rad**-2.0
    gradient[sessions] += now.offset_rad * config.offset_std_rad**-2.0
    first = len(sessions) + now.walls.size
    radii = first + 3 * np.arange(len(now.objects)) + 2
    corner[radii, radii] += config.object_radius_std_m**-2.0
    gradient[radii] += (now.objects[:, 2] - config.object_radius_m) * config.object_radius_std_m**-2.0
    up = first + now.objects.size + 3 * np.arange(len(now.raised)) + 2
    corner[up, up] += RAISED_STD_M**-2.0
    gradient[up] += now.raised[:, 2] * RAISED_STD_M**-2.0
    shared = np.arange(len(sessions), len(corner))
    corner[shared, shared] += LANDMARK_INFORMATION
    if now.n_tx > 1:
        return
    corner[now.anchor], corner[:, now.anchor], border[:, :, now.anchor] = 0.0, 0.0, 0.0
    corner[now.anchor, now.anchor], gradient[now.anchor] = 1e12, 0.0
