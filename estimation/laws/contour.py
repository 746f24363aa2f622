"""The path that a contour, TX and RX determine: specular point, delay, angles and all their derivatives.

At the specular point of a smooth contour the tangent e fulfils e . (a + b) = 0, a and b unit vectors to TX
and RX. A closed convex contour (`estimation.laws.support`) has one such point on its lit side, found by
safeguarded Newton from the bisector at its centre. A wall is the line n . x = d and reflects as the mirror
image of the TX; an edge point sends every ray through itself. The implicit function theorem on e . (a + b)
gives the derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.execution import compiled
from estimation.laws.support import support_terms
from scenes.record import BoolArray, FloatArray

EDGE, WALL = 4, 5
_MAX_ROUNDS = 60
_MIN_LENGTH_M = 1e-6


@dataclass(frozen=True)
class SpecularPaths:
    """What a contour predicts for each pair of TX and RX."""

    measured: FloatArray  # (path, 3) range in m with the clock bias, azimuths in the device frames in rad
    by_parameter: FloatArray  # (path, 3, parameter)
    by_rx: FloatArray  # (path, 3, 4) by x, y, heading, bias in m, m, rad, m
    point_m: FloatArray  # (path, xy) the specular points
    normal_rad: FloatArray  # (path,) azimuth of the outward normal there
    is_lit: BoolArray  # (path,) TX and RX on the outer side of the tangent


def predict(family: int, parameter: FloatArray, tx: FloatArray, rx_state: FloatArray) -> SpecularPaths:
    """Paths by one reflection.

    Parameters
    ----------
    family
        One of the closed families of `estimation.laws.support`, `EDGE` or `WALL`.
    parameter
        (parameter,) of the contour; edge [x, y] in m; wall [azimuth of the normal in rad, offset in m].
    tx
        (path, 3) x and y in m and heading in rad of the TX of each path.
    rx_state
        (path, 4) x and y in m, heading in rad, clock bias in m of the RX of each path.
    """
    n, m = len(tx), len(parameter)
    measured, by_parameter, by_rx = np.empty((n, 3)), np.empty((n, 3, m)), np.empty((n, 3, 4))
    point, normal, lit = np.empty((n, 2)), np.empty(n), np.empty(n, dtype=np.bool_)
    _predict_paths(family, parameter, tx, rx_state, measured, by_parameter, by_rx, point, normal, lit)
    return SpecularPaths(measured, by_parameter, by_rx, point, normal, lit)


@compiled
def _predict_paths(
    family: int,
    parameter: FloatArray,
    tx: FloatArray,
    rx_state: FloatArray,
    measured: FloatArray,
    by_parameter: FloatArray,
    by_rx: FloatArray,
    point: FloatArray,
    normal: FloatArray,
    lit: BoolArray,
) -> None:
    m = len(parameter)
    value, slope = np.zeros(3), np.zeros((2, m))
    by_point, move, move_rx = np.zeros((2, m)), np.zeros((2, m)), np.zeros((2, 2))
    for i in range(len(tx)):
        t, r = tx[i, :2], rx_state[i, :2]
        if family == EDGE:
            psi, curvature_m = _bisector(parameter[0], parameter[1], t, r), 0.0
            point[i] = parameter[:2]
            by_point[:] = 0.0
            by_point[0, 0], by_point[1, 1] = 1.0, 1.0
        elif family == WALL:
            psi, curvature_m = parameter[0], 1.0
            point[i] = _mirror_point(parameter, t, r)
            _wall_slope(parameter, point[i], by_point)
        else:
            psi = specular_normal(family, parameter, t, r, value, slope)
            curvature_m = value[0] + value[2]
            _closed_point(parameter, psi, value, slope, point[i], by_point)
        normal[i] = psi
        lit[i] = _slide(family, psi, curvature_m, point[i], t, r, by_point, move, move_rx)
        _path(tx[i], rx_state[i], point[i], by_point, move, move_rx, measured[i], by_parameter[i], by_rx[i])


@compiled
def specular_normal(
    family: int, parameter: FloatArray, t: FloatArray, r: FloatArray, value: FloatArray, slope: FloatArray
) -> float:
    """Azimuth of the outward normal at the lit specular point of a closed contour; `value` and `slope` are its.

    e . (a + b) falls with psi over the lit side, so a root is kept between brackets a quarter turn either
    side of the bisector and Newton steps that leave them are halved.
    """
    psi = _bisector(parameter[0], parameter[1], t, r)
    low, high = psi - np.pi / 2, psi + np.pi / 2
    for _ in range(_MAX_ROUNDS):
        support_terms(family, parameter, psi, value, slope)
        nx, ny = np.cos(psi), np.sin(psi)
        x = parameter[0] + value[0] * nx - value[1] * ny
        y = parameter[1] + value[0] * ny + value[1] * nx
        ax, ay, at = _unit(t[0] - x, t[1] - y)
        bx, by, br = _unit(r[0] - x, r[1] - y)
        tilt_a, tilt_b = nx * ay - ny * ax, nx * by - ny * bx
        tilt = tilt_a + tilt_b
        if tilt > 0:
            low = psi
        else:
            high = psi
        fall = -(nx * (ax + bx) + ny * (ay + by)) - (value[0] + value[2]) * (
            (1 - tilt_a**2) / at + (1 - tilt_b**2) / br
        )
        step = -tilt / fall if fall < 0 else np.inf
        if not low <= psi + step <= high:
            step = (low + high) / 2 - psi
        psi += step
        if abs(step) < 1e-14:
            break
    support_terms(family, parameter, psi, value, slope)
    return float(psi)


@compiled
def _closed_point(
    parameter: FloatArray,
    psi: float,
    value: FloatArray,
    slope: FloatArray,
    point: FloatArray,
    by_point: FloatArray,
) -> None:
    """Point of the contour with normal psi, and its derivative (2, parameter) with psi held."""
    nx, ny = np.cos(psi), np.sin(psi)
    point[0] = parameter[0] + value[0] * nx - value[1] * ny
    point[1] = parameter[1] + value[0] * ny + value[1] * nx
    by_point[0, 0], by_point[0, 1], by_point[1, 0], by_point[1, 1] = 1.0, 0.0, 0.0, 1.0
    for j in range(2, len(parameter)):
        by_point[0, j] = nx * slope[0, j] - ny * slope[1, j]
        by_point[1, j] = ny * slope[0, j] + nx * slope[1, j]


@compiled
def _mirror_point(wall: FloatArray, t: FloatArray, r: FloatArray) -> FloatArray:
    """Where the straight line from the RX to the mirror image of the TX crosses the wall."""
    nx, ny = np.cos(wall[0]), np.sin(wall[0])
    depth_t, depth_r = nx * t[0] + ny * t[1] - wall[1], nx * r[0] + ny * r[1] - wall[1]
    total = depth_t + depth_r
    if abs(total) < _MIN_LENGTH_M:
        total = _MIN_LENGTH_M
    share = depth_r / total
    foot = np.empty(2)
    foot[0] = r[0] + share * (t[0] - 2 * depth_t * nx - r[0])
    foot[1] = r[1] + share * (t[1] - 2 * depth_t * ny - r[1])
    return foot


@compiled
def _wall_slope(wall: FloatArray, point: FloatArray, by_point: FloatArray) -> None:
    """Derivative (2, 2) of d n + s e by azimuth and offset, s held."""
    nx, ny = np.cos(wall[0]), np.sin(wall[0])
    along = nx * point[1] - ny * point[0]
    by_point[0, 0], by_point[1, 0] = -wall[1] * ny - along * nx, wall[1] * nx - along * ny
    by_point[0, 1], by_point[1, 1] = nx, ny


@compiled
def _slide(
    family: int,
    psi: float,
    curvature_m: float,
    point: FloatArray,
    t: FloatArray,
    r: FloatArray,
    by_point: FloatArray,
    move: FloatArray,
    move_rx: FloatArray,
) -> bool:
    """Derivatives of the specular point by parameters and RX: along the tangent as e . (a + b) = 0 demands.

    `curvature_m` is the speed of the point along its running parameter: the radius of curvature against psi,
    1 along a wall. Returns whether TX and RX are on the outer side.
    """
    move[:], move_rx[:] = by_point, 0.0
    nx, ny = np.cos(psi), np.sin(psi)
    ax, ay, at = _unit(t[0] - point[0], t[1] - point[1])
    bx, by, br = _unit(r[0] - point[0], r[1] - point[1])
    front_a, front_b = nx * ax + ny * ay, nx * bx + ny * by
    tilt_a, tilt_b = nx * ay - ny * ax, nx * by - ny * bx
    if family == EDGE:
        return True
    # Derivative of e . (a + b) by the point is -(e - tilt a) / |a| - (e - tilt b) / |b|.
    fx = -(-ny - tilt_a * ax) / at - (-ny - tilt_b * bx) / br
    fy = -(nx - tilt_a * ay) / at - (nx - tilt_b * by) / br
    turn = 0.0 if family == WALL else 1.0
    fall = curvature_m * (-fx * ny + fy * nx) - turn * (front_a + front_b)
    for j in range(by_point.shape[1]):
        change = fx * by_point[0, j] + fy * by_point[1, j]
        if family == WALL and j == 0:
            change -= front_a + front_b
        run = -change / fall * curvature_m
        move[0, j] -= run * ny
        move[1, j] += run * nx
    rx, ry = (-ny - tilt_b * bx) / br, (nx - tilt_b * by) / br
    move_rx[0, 0], move_rx[0, 1] = rx * ny * curvature_m / fall, ry * ny * curvature_m / fall
    move_rx[1, 0], move_rx[1, 1] = -rx * nx * curvature_m / fall, -ry * nx * curvature_m / fall
    return bool(front_a > 0 and front_b > 0)


@compiled
def _path(
    tx: FloatArray,
    rx: FloatArray,
    point: FloatArray,
    by_point: FloatArray,
    move: FloatArray,
    move_rx: FloatArray,
    measured: FloatArray,
    by_parameter: FloatArray,
    by_rx: FloatArray,
) -> None:
    """Delay and angles of the path over the point. The delay is stationary along the tangent (Fermat)."""
    ax, ay, at = _unit(tx[0] - point[0], tx[1] - point[1])
    bx, by, br = _unit(rx[0] - point[0], rx[1] - point[1])
    measured[0] = at + br + rx[3]
    measured[1] = np.arctan2(-ay, -ax) - tx[2]
    measured[2] = np.arctan2(-by, -bx) - rx[2]
    # Azimuth of (point - device), device at distance |a|: derivative by the point is (a_y, -a_x) / |a|.
    for j in range(by_point.shape[1]):
        by_parameter[0, j] = -(ax + bx) * by_point[0, j] - (ay + by) * by_point[1, j]
        by_parameter[1, j] = (ay * move[0, j] - ax * move[1, j]) / at
        by_parameter[2, j] = (by * move[0, j] - bx * move[1, j]) / br
    for j in range(2):
        by_rx[1, j] = (ay * move_rx[0, j] - ax * move_rx[1, j]) / at
        by_rx[2, j] = (by * move_rx[0, j] - bx * move_rx[1, j]) / br
    by_rx[0, 0], by_rx[0, 1], by_rx[0, 2], by_rx[0, 3] = bx, by, 0.0, 1.0
    by_rx[1, 2], by_rx[1, 3] = 0.0, 0.0
    by_rx[2, 0] -= by / br
    by_rx[2, 1] += bx / br
    by_rx[2, 2], by_rx[2, 3] = -1.0, 0.0


@compiled
def _bisector(x: float, y: float, t: FloatArray, r: FloatArray) -> float:
    ax, ay, _ = _unit(t[0] - x, t[1] - y)
    bx, by, _ = _unit(r[0] - x, r[1] - y)
    return float(np.arctan2(ay + by, ax + bx))


@compiled
def _unit(x: float, y: float) -> tuple[float, float, float]:
    length = max(np.sqrt(x * x + y * y), _MIN_LENGTH_M)
    return x / length, y / length, length
