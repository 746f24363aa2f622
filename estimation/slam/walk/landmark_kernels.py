"""The reflection law of one path at a time, compiled: line of sight, walls, circles, and their derivatives.

`tx` is [x, y, heading]; the state [x, y, heading, bias], a wall [azimuth of its normal, offset] and a circle
[x, y, radius] are those of `estimation.slam.walk.landmarks`, which holds the same functions for whole arrays.
Results are written into the arrays given, so that a loop over paths allocates nothing.
"""

from __future__ import annotations

import numpy as np

from estimation.execution import compiled
from scenes.record import FloatArray

_MIN_LENGTH_M = 1e-6
_MAX_ROUNDS = 30
_MAX_TURN_RAD = 0.5


@compiled
def wrapped(angle: float) -> float:
    """An angle brought into [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


@compiled
def _length(x: float, y: float) -> float:
    return float(max(np.sqrt(x * x + y * y), _MIN_LENGTH_M))


@compiled
def los_path(tx: FloatArray, state: FloatArray, value: FloatArray, by_state: FloatArray) -> None:
    """Measurement (3,) of the line of sight and its derivative (3, 4)."""
    dx, dy = state[0] - tx[0], state[1] - tx[1]
    length = _length(dx, dy)
    azimuth = np.arctan2(dy, dx)
    value[0] = length + state[3]
    value[1] = azimuth - tx[2]
    value[2] = azimuth + np.pi - state[2]
    by_state[:] = 0.0
    by_state[0, 0], by_state[0, 1], by_state[0, 3] = dx / length, dy / length, 1.0
    for a in (1, 2):
        by_state[a, 0], by_state[a, 1] = -dy / length**2, dx / length**2
    by_state[2, 2] = -1.0


@compiled
def wall_path(
    tx: FloatArray,
    state: FloatArray,
    walls: FloatArray,
    value: FloatArray,
    by_state: FloatArray,
    by_wall: FloatArray,
    point: FloatArray,
) -> None:
    """Path by way of walls (bounce, 2): measurement (3,), derivatives (3, 4) and (3, 2 bounce), last IP (2,).

    The image of the TX in all walls, p' = p + 2 (offset - n' p) n, gives range and arrival; the image of the RX in
    all walls, in reverse order, gives the departure.
    """
    n = walls.shape[0]
    image_by, target_by = np.empty((n, 2, 2)), np.empty((n, 2, 2))
    turn = np.empty((2, 2))
    ix, iy = _mirrored(tx[0], tx[1], walls, False, image_by, turn)
    jx, jy = _mirrored(state[0], state[1], walls, True, target_by, turn)
    ax, ay, dx, dy = ix - state[0], iy - state[1], jx - tx[0], jy - tx[1]
    length, reach = _length(ax, ay), _length(dx, dy)
    ux, uy = ax / length, ay / length
    rx, ry = -uy / length, ux / length  # gradient of the arrival's azimuth
    qx, qy = -dy / reach**2, dx / reach**2  # of the departure's
    value[0] = length + state[3]
    value[1] = np.arctan2(dy, dx) - tx[2]
    value[2] = np.arctan2(ay, ax) - state[2]
    by_state[:] = 0.0
    by_state[0, 0], by_state[0, 1], by_state[0, 3] = -ux, -uy, 1.0
    by_state[1, 0], by_state[1, 1] = qx * turn[0, 0] + qy * turn[1, 0], qx * turn[0, 1] + qy * turn[1, 1]
    by_state[2, 0], by_state[2, 1], by_state[2, 2] = -rx, -ry, -1.0
    for b in range(n):
        for p in range(2):
            by_wall[0, 2 * b + p] = ux * image_by[b, 0, p] + uy * image_by[b, 1, p]
            by_wall[1, 2 * b + p] = qx * target_by[b, 0, p] + qy * target_by[b, 1, p]
            by_wall[2, 2 * b + p] = rx * image_by[b, 0, p] + ry * image_by[b, 1, p]
    wall_cut(tx, state, walls[n - 1], point)


@compiled
def wall_cut(tx: FloatArray, state: FloatArray, wall: FloatArray, point: FloatArray) -> None:
    """Specular point (2,) of a path by way of one wall."""
    nx, ny = np.cos(wall[0]), np.sin(wall[0])
    gap = wall[1] - nx * tx[0] - ny * tx[1]
    ix, iy = tx[0] + 2 * gap * nx, tx[1] + 2 * gap * ny
    before, after = wall[1] - nx * ix - ny * iy, wall[1] - nx * state[0] - ny * state[1]
    total = before - after
    share = before / (total if abs(total) >= 1e-9 else 1e-9)
    point[0], point[1] = ix + share * (state[0] - ix), iy + share * (state[1] - iy)


@compiled
def _mirrored(
    x: float, y: float, walls: FloatArray, backwards: bool, by_wall: FloatArray, turn: FloatArray
) -> tuple[float, float]:
    """Image of a point in walls (bounce, 2), one after the other, from the last to the first where `backwards`.

    Also its derivatives (bounce, 2, 2) by every wall's azimuth and offset and (2, 2) by the point.
    """
    n = walls.shape[0]
    turn[0, 0], turn[0, 1], turn[1, 0], turn[1, 1] = 1.0, 0.0, 0.0, 1.0
    for step in range(n):
        b = n - 1 - step if backwards else step
        nx, ny = np.cos(walls[b, 0]), np.sin(walls[b, 0])
        gap = walls[b, 1] - nx * x - ny * y
        across = -ny * x + nx * y
        for before in range(step):
            c = n - 1 - before if backwards else before
            for p in range(2):
                _reflect(by_wall[c], p, nx, ny)
        for p in range(2):
            _reflect(turn, p, nx, ny)
        by_wall[b, 0, 0], by_wall[b, 1, 0] = 2 * (-gap * ny - across * nx), 2 * (gap * nx - across * ny)
        by_wall[b, 0, 1], by_wall[b, 1, 1] = 2 * nx, 2 * ny
        x, y = x + 2 * gap * nx, y + 2 * gap * ny
    return x, y


@compiled
def _reflect(matrix: FloatArray, column: int, nx: float, ny: float) -> None:
    along = 2 * (nx * matrix[0, column] + ny * matrix[1, column])
    matrix[0, column] -= along * nx
    matrix[1, column] -= along * ny


@compiled
def circle_path(
    tx: FloatArray,
    state: FloatArray,
    circle: FloatArray,
    value: FloatArray,
    by_state: FloatArray,
    by_circle: FloatArray,
    point: FloatArray,
) -> None:
    """Path by way of the lit side of a circle: measurement (3,), derivatives (3, 4) and (3, 3), IP (2,).

    The IP q = c + radius m is where the tangent is perpendicular to the sum of the unit vectors from both devices;
    its derivatives follow from that condition.
    """
    mx, my = _lit_normal(tx, state, circle)
    radius = circle[2]
    point[0], point[1] = circle[0] + radius * mx, circle[1] + radius * my
    by_point = np.empty((3, 2))
    ux, uy, vx, vy, from_tx, from_rx = bounce_path(tx, state, point, value, by_state, by_point)
    ex, ey = -my, mx  # tangent
    # It times the derivative of both unit vectors, (I - u u') / length.
    along_u, along_v = ex * ux + ey * uy, ex * vx + ey * vy
    sx, sy = (ex - along_u * ux) / from_tx, (ey - along_u * uy) / from_tx
    wx, wy = (ex - along_v * vx) / from_rx, (ey - along_v * vy) / from_rx
    bx, by = sx + wx, sy + wy
    slope = -(mx * (ux + vx) + my * (uy + vy)) + radius * (bx * ex + by * ey)
    for a in range(3):
        swept = radius * (by_point[a, 0] * ex + by_point[a, 1] * ey) / slope
        by_state[a, 0] += swept * wx
        by_state[a, 1] += swept * wy
        by_circle[a, 0] = by_point[a, 0] - swept * bx
        by_circle[a, 1] = by_point[a, 1] - swept * by
        by_circle[a, 2] = by_point[a, 0] * mx + by_point[a, 1] * my - swept * (bx * mx + by * my)


@compiled
def _lit_normal(tx: FloatArray, state: FloatArray, circle: FloatArray) -> tuple[float, float]:
    """Outward normal where a circle reflects: Newton steps on the angle, from the bisector at the centre.

    The tangential part of the sum of both unit vectors from the IP falls with the angle all over the lit side.
    """
    ax, ay, bx, by = tx[0] - circle[0], tx[1] - circle[1], state[0] - circle[0], state[1] - circle[1]
    a, b = _length(ax, ay), _length(bx, by)
    mx, my = ax / a + bx / b, ay / a + by / b
    length = _length(mx, my)
    mx, my = mx / length, my / length
    for _ in range(_MAX_ROUNDS):
        x, y = circle[0] + circle[2] * mx, circle[1] + circle[2] * my
        ax, ay, bx, by = tx[0] - x, tx[1] - y, state[0] - x, state[1] - y
        a, b = _length(ax, ay), _length(bx, by)
        across_a, across_b = (mx * ay - my * ax) / a, (mx * by - my * bx) / b
        along = (mx * ax + my * ay) / a + (mx * bx + my * by) / b
        slope = -along - circle[2] * ((1 - across_a**2) / a + (1 - across_b**2) / b)
        turn = -(across_a + across_b) / (slope if slope < 0 else -1.0)
        turn = min(max(turn, -_MAX_TURN_RAD), _MAX_TURN_RAD)
        mx, my = mx - turn * my, my + turn * mx
        length = _length(mx, my)
        mx, my = mx / length, my / length
        if abs(turn) < 1e-13:
            break
    return mx, my


@compiled
def bounce_path(
    tx: FloatArray,
    state: FloatArray,
    point: FloatArray,
    value: FloatArray,
    by_state: FloatArray,
    by_point: FloatArray,
) -> tuple[float, float, float, float, float, float]:
    """Single bounce at an IP (2,): measurement (3,), derivatives (3, 4) and (3, 2).

    Returns the unit vectors from TX and RX to the IP and the two distances.
    """
    ax, ay, bx, by = point[0] - tx[0], point[1] - tx[1], point[0] - state[0], point[1] - state[1]
    from_tx, from_rx = _length(ax, ay), _length(bx, by)
    ux, uy, vx, vy = ax / from_tx, ay / from_tx, bx / from_rx, by / from_rx
    value[0] = from_tx + from_rx + state[3]
    value[1] = np.arctan2(ay, ax) - tx[2]
    value[2] = np.arctan2(by, bx) - state[2]
    by_point[0, 0], by_point[0, 1] = ux + vx, uy + vy
    by_point[1, 0], by_point[1, 1] = -uy / from_tx, ux / from_tx
    by_point[2, 0], by_point[2, 1] = -vy / from_rx, vx / from_rx
    by_state[:] = 0.0
    by_state[0, 0], by_state[0, 1], by_state[0, 3] = -vx, -vy, 1.0
    by_state[2, 0], by_state[2, 1], by_state[2, 2] = vy / from_rx, -vx / from_rx, -1.0
    return ux, uy, vx, vy, from_tx, from_rx


@compiled
def cholesky3(matrix: FloatArray) -> None:
    """Lower Cholesky factor of a matrix (3, 3), in place; what stands above the diagonal is left alone."""
    for j in range(3):
        for i in range(j, 3):
            for k in range(j):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
            if i == j:
                matrix[j, j] = np.sqrt(matrix[j, j])
            else:
                matrix[i, j] /= matrix[j, j]
