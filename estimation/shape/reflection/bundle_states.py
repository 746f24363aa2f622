"""The RX states of the bundle: what was given of them, lines of sight to them, and paths at those found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.laws.plane import los_jacobian_rx, predict_los
from estimation.shape.reflection.reflections import Reflections
from scenes.pose import Pose
from scenes.record import FloatArray, IntArray

EXACT_STD = 1e-6  # of a state given as exact, in m and rad


def at_solution(paths: Reflections, stop: IntArray, state: FloatArray, covariance: FloatArray) -> Reflections:
    """Paths at the states (stop, 4) solved for."""
    row = np.searchsorted(stop, paths.stop)
    return replace(paths, rx_state=state[row], rx_covariance=covariance[row])


def prior_states(sets: Sequence[Reflections]) -> tuple[IntArray, FloatArray, FloatArray]:
    """Stops, the states (stop, 4) given for them, and the inverse (stop, 4, 4) of their covariances."""
    stop, first = np.unique(np.concatenate([data.stop for data in sets]), return_index=True)
    state = np.concatenate([data.rx_state for data in sets])[first]
    covariance = np.concatenate([data.rx_covariance for data in sets])[first]
    return stop, state, np.asarray(np.linalg.inv(covariance + EXACT_STD**2 * np.eye(4)))


def line_of_sight(tx: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lines of sight (path, 3) and their derivatives (path, 3, 4) for TX rows (path, 3)."""
    measured, by_rx = np.zeros((len(tx), 3)), np.zeros((len(tx), 3, 4))
    for row in np.unique(tx, axis=0):
        mine = np.all(tx == row, axis=1)
        pose = Pose(np.array([*row[:2], 0.0]), float(row[2]))
        measured[mine], by_rx[mine] = predict_los(pose, state[mine]), los_jacobian_rx(pose, state[mine])
    return measured, by_rx
