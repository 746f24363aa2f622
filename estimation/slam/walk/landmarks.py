"""Landmarks that many stops share: walls as lines with mirrored TX, compact objects as circles.

A line is [azimuth of the normal in rad, offset in m]: the points q with n' q = offset. A circle is [x, y, radius]
in m. All functions broadcast over leading axes and give the measurement of `estimation.laws.plane` with its
derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.execution import compiled
from estimation.slam.walk.landmark_kernels import circle_path, wall_cut, wall_path, wrapped
from scenes.pose import Pose
from scenes.record import FloatArray


@dataclass(frozen=True)
class Prediction:
    """A predicted measurement and its derivatives."""

    value: FloatArray  # (..., 3) in m, rad, rad
    by_state: FloatArray  # (..., 3, 4)
    by_landmark: FloatArray  # (..., 3, parameter)


def plane_pose(tx: Pose) -> FloatArray:
    """[x, y, heading] (3,) of a pose, as the compiled functions take it."""
    return np.array([tx.position_m[0], tx.position_m[1], tx.heading_rad], float)


def predict_walls(tx: Pose, state: FloatArray, walls: FloatArray) -> Prediction:
    """Specular path by way of one or more walls, in the order from TX to RX.

    Parameters
    ----------
    walls
        (..., bounce, 2) lines. `by_landmark` has 2 parameters per bounce, in order.
    """
    leading = np.broadcast_shapes(state.shape[:-1], walls.shape[:-2])
    states = _rows(state, leading, (4,))
    chains = _rows(walls, leading, walls.shape[-2:])
    return _shaped(_predict_walls(plane_pose(tx), states, chains), leading)


def predict_circle(tx: Pose, state: FloatArray, circle: FloatArray) -> Prediction:
    """Specular path by way of the lit side of a circle (..., 3)."""
    leading = np.broadcast_shapes(state.shape[:-1], circle.shape[:-1])
    return _shaped(
        _predict_circles(plane_pose(tx), _rows(state, leading, (4,)), _rows(circle, leading, (3,))), leading
    )


def wall_point(tx: Pose, position_m: FloatArray, wall: FloatArray) -> FloatArray:
    """Specular point (..., 2) on a wall (..., 2) for RX positions (..., 2)."""
    leading = np.broadcast_shapes(position_m.shape[:-1], wall.shape[:-1])
    points = _wall_points(plane_pose(tx), _rows(position_m, leading, (2,)), _rows(wall, leading, (2,)))
    return points.reshape(*leading, 2)


def _rows(value: FloatArray, leading: tuple[int, ...], shape: tuple[int, ...]) -> FloatArray:
    return np.ascontiguousarray(np.broadcast_to(value, (*leading, *shape)), dtype=float).reshape(-1, *shape)


def _shaped(parts: tuple[FloatArray, FloatArray, FloatArray], leading: tuple[int, ...]) -> Prediction:
    return Prediction(*(part.reshape(*leading, *part.shape[1:]) for part in parts))


@compiled
def _predict_walls(
    tx: FloatArray, state: FloatArray, walls: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    n, point = len(state), np.empty(2)
    value, by_state = np.empty((n, 3)), np.empty((n, 3, 4))
    by_wall = np.empty((n, 3, 2 * walls.shape[1]))
    for i in range(n):
        wall_path(tx, state[i], walls[i], value[i], by_state[i], by_wall[i], point)
        value[i, 1], value[i, 2] = wrapped(value[i, 1]), wrapped(value[i, 2])
    return value, by_state, by_wall


@compiled
def _predict_circles(
    tx: FloatArray, state: FloatArray, circle: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    n, point = len(state), np.empty(2)
    value, by_state, by_circle = np.empty((n, 3)), np.empty((n, 3, 4)), np.empty((n, 3, 3))
    for i in range(n):
        circle_path(tx, state[i], circle[i], value[i], by_state[i], by_circle[i], point)
        value[i, 1], value[i, 2] = wrapped(value[i, 1]), wrapped(value[i, 2])
    return value, by_state, by_circle


@compiled
def _wall_points(tx: FloatArray, position: FloatArray, wall: FloatArray) -> FloatArray:
    points = np.empty((len(position), 2))
    for i in range(len(position)):
        wall_cut(tx, position[i], wall[i], points[i])
    return points
