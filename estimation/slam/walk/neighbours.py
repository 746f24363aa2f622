"""What the known stops of a walk say of another one: between them a walk is taken as straight and even."""

import numpy as np

from estimation.slam.config import TrajectoryConfig
from estimation.slam.walk.motion import course_of, motion_cost
from scenes.record import BoolArray, FloatArray, IntArray

_WINDOW = 2  # known stops on each side that the motion about a stop depends on


def between_known(state: FloatArray, is_known: BoolArray) -> FloatArray:
    """States (stop, state) with those that are not known interpolated; the same where no stop is known."""
    known = np.flatnonzero(is_known)
    return interpolated(state[known], known, np.arange(len(state))) if len(known) else state


def motion_about(
    state: FloatArray, is_known: BoolArray, stop: int, candidates: FloatArray, config: TrajectoryConfig
) -> FloatArray:
    """Cost (candidate,) of the walk about a stop in each of some states (candidate, state).

    Stops near it that are not known are taken where the candidate and the known ones put them: a guess about a
    neighbour says nothing.
    """
    near = np.flatnonzero(is_known | (np.arange(len(state)) == stop))
    at = int(np.searchsorted(near, stop))
    near = near[max(at - _WINDOW, 0) : at + _WINDOW + 1]
    every, part = np.arange(near[0], near[-1] + 1), state.copy()
    costs = np.empty(len(candidates))
    for k, candidate in enumerate(candidates):
        part[stop] = candidate
        walk = interpolated(part[near], near, every)
        costs[k] = motion_cost(walk, course_of(walk), config)
    return costs


def neighbour_states(now: FloatArray, stop: int) -> FloatArray:
    """The states (3, state) of the nearest stops and between them; none where there is one stop."""
    n = len(now)
    if n < 2:
        return np.empty((0, now.shape[1]))
    near = now[[max(stop - 1, 0) if stop else 1, stop + 1 if stop + 1 < n else n - 2]].copy()
    near[:, 3] = near[:, 3].mean()
    return np.concatenate([near, near.mean(axis=0, keepdims=True)])


def interpolated(known_state: FloatArray, known: IntArray, stop: IntArray) -> FloatArray:
    """States (stop, state) at some stops, on straight lines between those of the known ones (known, state)."""
    there = known_state.copy()
    there[:, 2] = np.unwrap(there[:, 2])
    return np.column_stack([np.interp(stop, known, column) for column in there.T])
