"""Walls of two planes: a window or a panel stands a few centimetres before its wall, or behind it.

Within wide noise its paths are those of the wall. They shift the line of the wall; or, where few stops see the
panel, they shift these stops, against all their other paths. So every stop is fitted again with a plane of its own
for the paths of a TX off each of its walls. Where every stop has few paths, none contradicts itself: it moves and
turns to where a wall of one plane agrees. But all stops share the wall. So the offset of every stretch is judged
as well, with all other unknowns of the walk free.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimation.inference.arrow import ArrowSystem
from estimation.laws.wall import wall_places
from estimation.slam.config import TrajectoryConfig
from estimation.slam.walk.linearise import Linearised, linearise
from estimation.slam.walk.mirrors import TOLERANCE_M
from estimation.slam.walk.relocate import LEAST_EVIDENCE, path_gains, stepped
from estimation.slam.walk.residuals import (
    LEAST_SPARE,
    Association,
    Observations,
    PathClass,
    TrajectoryState,
    spare_equations,
)
from estimation.slam.walk.smoother import normal_equations
from scenes.pose import wrap_angle
from scenes.record import FloatArray, IntArray

_PARALLEL_RAD = np.deg2rad(2.0)  # between planes that one wall may have
_TURNS = 3  # of steps of the states and of the offsets
_LEAST_PATHS = 3  # on each of the two planes: one more than a line has unknowns
_MOST_PARTS = 128  # of a wall: stretches are made of them
_OFFSET = np.array([2, 4])  # of the first and the second wall of a path among its shared parameters


class _Split(NamedTuple):
    """A wall of which some paths are to have a plane of their own."""

    wall: int
    path: IntArray
    shift_m: float  # of their plane
    start: TrajectoryState


def split_wall(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> tuple[TrajectoryState, Association]:
    """The walk with a second plane for the wall that gains most by it; the same walk where none gains.

    The plane is parallel to the wall; where another wall is nearer to it than its own, it is that one.
    """
    split = _of_one_stop(seen, link, now, config) or _of_all_stops(seen, link, now, config)
    if split is None:
        return now, link
    start = split.start
    plane = start.walls[split.wall] + [0.0, split.shift_m]
    apart = np.abs(start.walls[:, 1] - plane[1])
    apart[np.abs(wrap_angle(start.walls[:, 0] - plane[0])) > _PARALLEL_RAD] = np.inf
    nearest = int(np.argmin(apart))
    if nearest == split.wall:
        nearest, start = len(now.walls), replace(start, walls=np.concatenate([start.walls, plane[None]]))
    landmark = link.landmark.copy()
    landmark[split.path] = np.where(landmark[split.path] == split.wall, nearest, landmark[split.path])
    return start, replace(link, landmark=landmark)


def _of_all_stops(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> _Split | None:
    """The stretch that all stops together show, where it gains enough."""
    best = best_stretch(seen, link, now, config)
    if best is None or best.gain < LEAST_EVIDENCE or abs(best.shift_m) > TOLERANCE_M:
        return None
    return _Split(best.wall, best.path, best.shift_m, now.moved(*best.step))


def _of_one_stop(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> _Split | None:
    """The paths of a stop and TX off one wall that gain most by a plane of their own, where they gain enough.

    The stop moves to where its other paths put it.
    """
    is_off = np.isin(link.kind, [PathClass.WALL, PathClass.DOUBLE])
    path, leg = np.nonzero(is_off[:, None] & (link.landmark >= 0))
    named = seen.row[path], link.landmark[path, leg], seen.tx_of_path[path]
    stop, wall, tx = np.unique(np.column_stack(named), axis=0).T
    if not len(stop):
        return None
    copies, index = seen.copies(stop)
    first = len(now.walls)
    is_mine = is_off[index] & (copies.tx_of_path == tx[copies.row])
    is_plane = is_mine[:, None] & (link.landmark[index] == wall[copies.row, None])
    landmark = np.where(is_plane, first + copies.row[:, None], link.landmark[index])
    rough = np.broadcast_to(link.rough, link.kind.shape)[index]
    trial = Association(link.kind[index], landmark, rough)
    others = replace(trial, kind=np.where(is_plane.any(axis=1), PathClass.UNUSED, trial.kind))
    point = replace(now.apart(now.state[stop], stop), walls=np.concatenate([now.walls, now.walls[wall]]))
    point = stepped(copies, others, point, config)
    for _ in range(_TURNS):
        point, information = _shifted(copies, trial, point, first, config)
        point = stepped(copies, trial, point, config)
    gain = np.bincount(copies.row, path_gains(copies, trial, point, config), len(stop))
    gain -= np.bincount(seen.row, path_gains(seen, link, now, config), seen.n_stops)[stop]
    gain -= 0.5 * np.log(np.maximum(information * TOLERANCE_M**2, 1.0)) + np.log(1 + np.bincount(stop)[stop])
    shift = point.walls[first:, 1] - now.walls[wall, 1]
    is_able = (spare_equations(copies, others) >= LEAST_SPARE) & (np.abs(shift) < TOLERANCE_M)
    best = int(np.argmax(np.where(is_able, gain, -np.inf)))
    if not (is_able[best] and gain[best] > LEAST_EVIDENCE):
        return None
    state = now.state.copy()
    state[stop[best]] = point.state[best]
    chosen = index[(copies.row == best) & is_plane.any(axis=1)]
    return _Split(int(wall[best]), chosen, float(shift[best]), replace(now, state=state))


def _shifted(
    copies: Observations, trial: Association, point: TrajectoryState, first: int, config: TrajectoryConfig
) -> tuple[TrajectoryState, FloatArray]:
    """The planes from `first` on where their paths put them, the states held, and their information (plane,)."""
    lin = linearise(copies, trial, point, config)
    weight = lin.weight(config.degrees_of_freedom)
    is_off = np.isin(trial.kind, [PathClass.WALL, PathClass.DOUBLE])
    path, leg = np.nonzero(is_off[:, None] & (trial.landmark >= first))
    slope = lin.by_shared[path, :, _OFFSET[leg]]
    plane, n = trial.landmark[path, leg] - first, len(point.walls) - first
    information = np.bincount(plane, weight[path] * np.sum(slope**2, axis=1), n)
    pull = np.bincount(plane, weight[path] * np.sum(slope * lin.value[path], axis=1), n)
    walls = point.walls.copy()
    walls[first:, 1] -= pull / np.maximum(information, 1e-300)
    return replace(point, walls=walls), np.asarray(information, float)


class Stretch(NamedTuple):
    """Paths off a stretch of a wall that agree on another offset than the rest."""

    gain: float  # in log likelihood, all other unknowns free, less the logarithm of the stretches tried
    wall: int
    path: IntArray
    shift_m: float  # of their offset
    step: tuple[FloatArray, FloatArray]  # of the states (stop, state) and the shared unknowns


def best_stretch(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> Stretch | None:
    """The stretch of a wall that gains most by an offset of its own; None where no wall can have one."""
    lin = linearise(seen, link, now, config)
    weight = lin.weight(config.degrees_of_freedom)
    system = normal_equations(seen, link, now, config)
    found: list[Stretch] = []
    n_tried = 0
    for wall in range(len(now.walls)):
        path = np.flatnonzero((link.kind == PathClass.WALL) & (link.landmark[:, 0] == wall))
        place, _, _ = wall_places(now.walls[wall], seen.tx_rows[path], now.state[seen.row[path], :2])
        path = path[np.argsort(place, kind="stable")]
        first, last = _stretches(len(path))
        n_tried += len(first)
        if len(first):
            found.append(_best_of(wall, path, first, last, lin, weight, system))
    best = max(found, key=lambda one: one.gain, default=None)
    return None if best is None else best._replace(gain=best.gain - float(np.log(n_tried)))


def _stretches(n: int) -> tuple[IntArray, IntArray]:
    """First and last (stretch,) of all stretches of n paths along a wall; many paths are taken some at a time."""
    ends = np.unique(np.linspace(0, n, min(n, _MOST_PARTS) + 1).astype(int))
    first, last = (ends[k] for k in np.triu_indices(len(ends), 1))
    is_able = (last - first >= _LEAST_PATHS) & (n - (last - first) >= _LEAST_PATHS)
    return first[is_able], last[is_able]


def _best_of(
    wall: int,
    path: IntArray,
    first: IntArray,
    last: IntArray,
    lin: Linearised,
    weight: FloatArray,
    system: ArrowSystem,
) -> Stretch:
    """The stretch of paths (path,), sorted along the wall, whose own offset explains most.

    A score test: the gain is g^2 / (2 I) with the gradient g of the cost by the offset, and the information I that
    is left when all other unknowns follow.
    """
    ends = np.unique(np.concatenate([first, last]))
    a, b = np.searchsorted(ends, first), np.searchsorted(ends, last)
    of_part = np.searchsorted(ends, np.arange(len(path)), side="right") - 1
    slope = lin.by_shared[path, :, 2]
    pulled = weight[path, None] * slope
    states, shared = _coupling(path, of_part, len(ends), pulled, lin, system)
    through = system.solve_for(states, shared)
    own = np.diag(np.bincount(of_part, np.sum(pulled * slope, axis=1), len(ends)))
    left = np.zeros((len(ends) + 1, len(ends) + 1))
    left[1:, 1:] = np.cumsum(np.cumsum(own - states.T @ through[0] - shared.T @ through[1], axis=0), axis=1)
    gradient = np.cumsum(np.append(0.0, np.bincount(of_part, np.sum(pulled * lin.value[path], axis=1), len(ends))))
    information = left[b, b] - left[a, b] - left[b, a] + left[a, a]
    score = gradient[b] - gradient[a]
    is_able = information > 1e-9 * np.trace(own)
    gain = np.where(is_able, score**2 / (2 * np.where(is_able, information, 1.0)), 0.0)
    best = int(np.argmax(gain))
    shift = -float(score[best] / information[best]) if is_able[best] else 0.0
    of_states, of_shared = (-shift * each[:, a[best] : b[best]].sum(axis=1) for each in through)
    step = of_states.reshape(-1, system.diagonal.shape[-1]), of_shared
    return Stretch(float(gain[best]), wall, path[first[best] : last[best]], shift, step)


def _coupling(
    path: IntArray, of_part: IntArray, n_parts: int, pulled: FloatArray, lin: Linearised, system: ArrowSystem
) -> tuple[FloatArray, FloatArray]:
    """Coupling of the offset of every part of the paths to the states (state, part) and shared (unknown, part)."""
    size = system.diagonal.shape[-1]
    states, shared = np.zeros((system.gradient.size, n_parts)), np.zeros((len(system.corner), n_parts))
    by_state = np.einsum("pd,pda->pa", pulled, lin.by_state[path])
    np.add.at(states, (lin.row[path, None] * size + lin.columns[path], of_part[:, None]), by_state)
    by_shared = np.einsum("pd,pds->ps", pulled, lin.by_shared[path])
    rows, kept = np.nonzero(lin.shared[path] >= 0)
    np.add.at(shared, (lin.shared[path][rows, kept], of_part[rows]), by_shared[rows, kept])
    return states, shared
