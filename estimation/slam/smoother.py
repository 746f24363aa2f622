"""The trajectory smoother: robust least squares over all stops, session offsets and shared landmarks.

Unknown are the RX states, one offset of the TX heading per session and the landmarks. Residuals, in units of
their standard deviations: of the line of sight (3), of a single bounce with its IP eliminated (1), of a path by
way of a shared landmark (3), and the second difference of the position as motion prior (2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.slam.arrow import ArrowSystem
from estimation.slam.config import TrajectoryConfig
from estimation.slam.residuals import Association, Block, Observations, TrajectoryState, residual_blocks
from scenes.pose import wrap_angle
from scenes.record import FloatArray

_WEAK_STD = np.array([50.0, 50.0, np.pi, 50.0])


def optimise(
    seen: Observations, link: Association, start: TrajectoryState, config: TrajectoryConfig
) -> TrajectoryState:
    """Levenberg-Marquardt on the robust cost, re-weighting at every step."""
    now, damping = replace(start, course=course_of(start.state)), 1e-4
    blocks = residual_blocks(seen, link, now, config)
    cost = _cost(blocks, now, config)
    for _ in range(config.max_iterations):
        system = _system(seen, blocks, now, config)
        step, shared = system.damped(damping).solve()
        trial = now.moved(step, shared)
        trial_blocks = residual_blocks(seen, link, trial, config)
        trial_cost = _cost(trial_blocks, trial, config)
        if not trial_cost <= cost:
            damping *= 10
            if damping > 1e6:
                break
            continue
        settled = cost - trial_cost <= config.relative_tolerance * (1 + abs(cost))
        now, blocks, cost, damping = trial, trial_blocks, trial_cost, max(damping / 10, 1e-9)
        if settled:
            break
    return now


def robust_cost(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> float:
    """Minus the log-likelihood under Student-t residuals and the motion prior, up to a constant."""
    return _cost(residual_blocks(seen, link, now, config), now, config)


def _cost(blocks: Sequence[Block], now: TrajectoryState, config: TrajectoryConfig) -> float:
    total = 0.0
    for block in blocks:
        square = np.sum(block.value**2, axis=1)
        freedom = config.degrees_of_freedom
        total += float(np.sum((freedom + block.value.shape[1]) / 2 * np.log1p(square / freedom)))
    bend, freedom = _bend(now, config), config.motion_degrees_of_freedom
    total += float(np.sum((freedom + 2) / 2 * np.log1p(np.sum(bend**2, axis=1) / freedom)))
    total += 1.5 * float(np.sum(np.log1p(_drift(now.state, config) ** 2 / 2.0)))
    radius = (now.objects[:, 2] - config.object_radius_m) / config.object_radius_std_m
    return total + 0.5 * float(np.sum(radius**2) + np.sum((now.offset_rad / config.offset_std_rad) ** 2))


def normal_equations(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> ArrowSystem:
    """Information and gradient of the re-weighted problem at the present unknowns."""
    return _system(seen, residual_blocks(seen, link, now, config), now, config)


def _system(
    seen: Observations, blocks: Sequence[Block], now: TrajectoryState, config: TrajectoryConfig
) -> ArrowSystem:
    n, m = seen.n_stops, now.n_shared
    diagonal = np.tile(np.diag(_WEAK_STD**-2.0), (n, 1, 1))
    border, corner = np.zeros((n, 4, m)), np.zeros((m, m))
    gradient, shared_gradient = np.zeros((n, 4)), np.zeros(m)
    for block in blocks:
        row = seen.row[block.path]
        freedom = config.degrees_of_freedom
        square = np.sum(block.value**2, axis=1)
        weight = ((freedom + block.value.shape[1]) / (freedom + square))[:, None, None]
        by_state, by_shared = np.swapaxes(block.by_state, 1, 2) * weight, block.by_shared
        np.add.at(diagonal, row, by_state @ block.by_state)
        np.add.at(gradient, row, (by_state @ block.value[..., None])[..., 0])
        columns = block.shared
        cross = by_state @ by_shared
        np.add.at(border, (row[:, None, None], np.arange(4)[:, None], columns[:, None, :]), cross)
        own = np.swapaxes(by_shared, 1, 2) * weight
        np.add.at(corner, (columns[:, :, None], columns[:, None, :]), own @ by_shared)
        np.add.at(shared_gradient, columns, (own @ block.value[..., None])[..., 0])
    next1, next2 = _add_motion(diagonal, gradient, now, config)
    _add_shared_priors(corner, shared_gradient, border, now, config)
    return ArrowSystem(diagonal, next1, next2, border, corner, gradient, shared_gradient)


def course_of(state: FloatArray) -> FloatArray:
    """Unit vectors (stop - 2, 2) from the stop before to the stop after; zero where these coincide."""
    step = state[2:, :2] - state[:-2, :2]
    return np.asarray(step / np.maximum(np.hypot(*step.T), 1e-9)[:, None])


def _whitening(course: FloatArray, config: TrajectoryConfig) -> FloatArray:
    """Matrix (stop - 2, 2, 2) from a second difference to its parts along and across, over their scales."""
    across = np.stack([-course[:, 1], course[:, 0]], axis=1)
    scale = np.array([config.along_track_std_m, config.cross_track_std_m])
    return np.asarray(np.stack([course, across], axis=1) / scale[:, None])


def _bend(now: TrajectoryState, config: TrajectoryConfig) -> FloatArray:
    """Second differences (stop - 2, 2) of the position, whitened along and across the course."""
    difference = np.diff(now.state[:, :2], n=2, axis=0)
    return np.asarray(np.einsum("kij,kj->ki", _whitening(now.course, config), difference))


def _drift(state: FloatArray, config: TrajectoryConfig) -> FloatArray:
    """Steps (stop - 1, 2) of heading and clock bias between stops over their scales."""
    step = np.diff(state[:, 2:], axis=0)
    step[:, 0] = wrap_angle(step[:, 0])
    return np.asarray(step / [config.heading_step_rad, config.clock_step_m])


def _add_motion(
    diagonal: FloatArray, gradient: FloatArray, now: TrajectoryState, config: TrajectoryConfig
) -> tuple[FloatArray, FloatArray]:
    """Add the motion prior in place; returns the coupling blocks to the next and second next stops."""
    n = len(now.state)
    next1, next2 = np.zeros((max(n - 1, 0), 4, 4)), np.zeros((max(n - 2, 0), 4, 4))
    drift = _drift(now.state, config)
    for axis, scale in ((2, config.heading_step_rad), (3, config.clock_step_m)):
        value = drift[:, axis - 2]
        weight = 3.0 / (2.0 + value**2)
        diagonal[:-1, axis, axis] += weight / scale**2
        diagonal[1:, axis, axis] += weight / scale**2
        next1[:, axis, axis] -= weight / scale**2
        gradient[:-1, axis] -= weight * value / scale
        gradient[1:, axis] += weight * value / scale
    if n < 3:
        return next1, next2
    bend, freedom = _bend(now, config), config.motion_degrees_of_freedom
    weight = (freedom + 2) / (freedom + np.sum(bend**2, axis=1))
    whitening = _whitening(now.course, config)
    weighted = np.swapaxes(whitening, 1, 2) * weight[:, None, None]
    information, pull = weighted @ whitening, (weighted @ bend[..., None])[..., 0]
    for i, ci in enumerate((1.0, -2.0, 1.0)):
        gradient[i : n - 2 + i, :2] += ci * pull
        for j, cj in enumerate((1.0, -2.0, 1.0)[i:], start=i):
            target = (diagonal[i : n - 2 + i], next1[i : n - 2 + i], next2)[j - i]
            target[:, :2, :2] += ci * cj * information
    return next1, next2


def _add_shared_priors(
    corner: FloatArray,
    gradient: FloatArray,
    border: FloatArray,
    now: TrajectoryState,
    config: TrajectoryConfig,
) -> None:
    """Priors on offsets and radii, in place; the anchor session's offset is taken out of the problem."""
    sessions = np.arange(len(now.offset_rad))
    corner[sessions, sessions] += config.offset_std_rad**-2.0
    gradient[sessions] += now.offset_rad * config.offset_std_rad**-2.0
    first = len(sessions) + now.walls.size
    radii = first + 3 * np.arange(len(now.objects)) + 2
    corner[radii, radii] += config.object_radius_std_m**-2.0
    gradient[radii] += (now.objects[:, 2] - config.object_radius_m) * config.object_radius_std_m**-2.0
    shared = np.arange(len(sessions), len(corner))
    corner[shared, shared] += 1e-6
    corner[now.anchor], corner[:, now.anchor], border[:, :, now.anchor] = 0.0, 0.0, 0.0
    corner[now.anchor, now.anchor], gradient[now.anchor] = 1e12, 0.0
