"""Residuals and Jacobians of the reflection law in plain numpy: the work beside which the fits are timed.

All paths at once, the formulas of `estimation.laws`: a circle with Newton steps to its specular point, a wall as a
mirror of the TX, the line of sight. A circle is [x, y, log R], a wall [azimuth of its normal, offset].
"""

from collections.abc import Callable, Sequence

import numpy as np

from estimation.shape.reflection.reflections import Reflections
from scenes.pose import wrap_angle
from scenes.record import FloatArray

_NEWTON_STEPS = 5  # from the bisector at the centre: enough for 1e-12 rad
# Residual (path, 3), Jacobians (path, 3, parameter) and (path, 3, 4) by the RX state
Terms = tuple[FloatArray, FloatArray, FloatArray]
Evaluation = Callable[[Reflections, FloatArray], Terms]


def circle_terms(data: Reflections, circle: FloatArray) -> Terms:
    """Residuals and Jacobians by the circle and by the RX state."""
    radius, center = np.exp(circle[2]), circle[:2]
    normal = _units(data.tx[:, :2] - center)[0] + _units(data.rx_state[:, :2] - center)[0]
    for _ in range(_NEWTON_STEPS):
        normal = _units(normal)[0]
        tangent = _turned(normal)
        a, at = _units(data.tx[:, :2] - center - radius * normal)
        b, br = _units(data.rx_state[:, :2] - center - radius * normal)
        along_a, along_b = _dot(normal, a), _dot(normal, b)
        fall = along_a + along_b + radius * (along_a**2 / at + along_b**2 / br)
        normal = normal + (_dot(tangent, a + b) / fall)[:, None] * tangent
    normal = _units(normal)[0]
    tangent, point = _turned(normal), center + radius * normal
    value, by_state, by_point = _bounce(data, point)
    a, at = _units(data.tx[:, :2] - point)
    b, br = _units(data.rx_state[:, :2] - point)
    by_rx = (tangent - _dot(tangent, b)[:, None] * b) / br[:, None]
    by_place = -by_rx - (tangent - _dot(tangent, a)[:, None] * a) / at[:, None]
    fall = radius * _dot(by_place, tangent) - _dot(normal, a + b)
    moved = np.concatenate([np.tile(np.eye(2), (len(data), 1, 1)), radius * normal[:, :, None]], axis=2)
    turn = -np.einsum("ni,nij->nj", by_place, moved) / fall[:, None] * radius
    by_circle = by_point @ (moved + tangent[:, :, None] * turn[:, None, :])
    by_state[:, :, :2] -= (by_point @ tangent[:, :, None]) * (radius / fall[:, None] * by_rx)[:, None, :]
    return _residual(data, value), by_circle, by_state


def wall_terms(data: Reflections, wall: FloatArray) -> Terms:
    """Residuals and Jacobians by the wall and by the RX state."""
    normal = np.array([np.cos(wall[0]), np.sin(wall[0])])
    mirror, slope = np.eye(2) - 2 * np.outer(normal, normal), _turned(normal[None])[0]
    t, r = data.tx[:, :2], data.rx_state[:, :2]
    by_wall = []
    for place in (t, r):  # derivatives of the image by azimuth and offset
        gap = wall[1] - place @ normal
        by_azimuth = 2 * (gap[:, None] * slope - (place @ slope)[:, None] * normal)
        by_wall.append(np.stack([by_azimuth, np.tile(2 * normal, (len(data), 1))], axis=2))
    u, length = _units(t @ mirror + 2 * wall[1] * normal - r)
    w = -u @ mirror
    value = _measured(data, length + data.rx_state[:, 3], w, u)
    rise, departure = _turned(u) / length[:, None], _turned(w) / length[:, None]
    by_state, by_own = np.zeros((len(data), 3, 4)), np.empty((len(data), 3, 2))
    by_state[:, 0, :2], by_state[:, 0, 3] = -u, 1.0
    by_state[:, 1, :2] = departure @ mirror
    by_state[:, 2, :2], by_state[:, 2, 2] = -rise, -1.0
    for a, (direction, images) in enumerate(((u, by_wall[0]), (departure, by_wall[1]), (rise, by_wall[0]))):
        by_own[:, a] = np.einsum("ni,nij->nj", direction, images)
    return _residual(data, value), by_own, by_state


def los_terms(data: Reflections, _: FloatArray) -> Terms:
    """Residuals and the Jacobian by the RX state of lines of sight."""
    u, length = _units(data.rx_state[:, :2] - data.tx[:, :2])
    by_state = np.zeros((len(data), 3, 4))
    by_state[:, 0, :2], by_state[:, 0, 3] = u, 1.0
    by_state[:, 1, :2] = by_state[:, 2, :2] = _turned(u) / length[:, None]
    by_state[:, 2, 2] = -1.0
    value = _measured(data, length + data.rx_state[:, 3], u, -u)
    return _residual(data, value), np.empty((len(data), 3, 0)), by_state


def evaluated(sets: Sequence[tuple[Evaluation, Reflections, FloatArray]], times: int) -> None:
    """Evaluate the terms of all sets of paths, at their parameters, so many times."""
    for _ in range(times):
        for terms, data, parameter in sets:
            terms(data, parameter)


def _bounce(data: Reflections, point: FloatArray) -> Terms:
    u, from_tx = _units(point - data.tx[:, :2])
    v, from_rx = _units(point - data.rx_state[:, :2])
    value = _measured(data, from_tx + from_rx + data.rx_state[:, 3], u, v)
    by_state, by_point = np.zeros((len(data), 3, 4)), np.empty((len(data), 3, 2))
    by_point[:, 0], by_point[:, 1] = u + v, _turned(u) / from_tx[:, None]
    by_point[:, 2] = _turned(v) / from_rx[:, None]
    by_state[:, 0, :2], by_state[:, 0, 3] = -v, 1.0
    by_state[:, 2, :2], by_state[:, 2, 2] = -by_point[:, 2], -1.0
    return value, by_state, by_point


def _measured(data: Reflections, length: FloatArray, departure: FloatArray, arrival: FloatArray) -> FloatArray:
    azimuths = [np.arctan2(each[:, 1], each[:, 0]) for each in (departure, arrival)]
    return np.column_stack([length, azimuths[0] - data.tx[:, 2], azimuths[1] - data.rx_state[:, 2]])


def _residual(data: Reflections, value: FloatArray) -> FloatArray:
    difference = data.measured - value
    difference[:, 1:] = wrap_angle(difference[:, 1:])
    return difference


def _units(vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    length = np.sqrt(_dot(vector, vector))
    return vector / length[:, None], length


def _dot(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(one[:, 0] * other[:, 0] + one[:, 1] * other[:, 1])


def _turned(vector: FloatArray) -> FloatArray:
    return np.column_stack([-vector[:, 1], vector[:, 0]])
