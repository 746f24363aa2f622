"""The reflection law of flat walls in the plane: every wall mirrors the TX.

A wall is the line [azimuth of its normal in rad, offset in m]: the points q with n' q = offset. Its tangent is the
normal turned by +90 deg; places along it start at the point nearest to the origin. TX, RX states and measurements
are those of `estimation.laws.plane`. Functions for arrays call the kernels for one path.
"""

import numpy as np

from estimation.execution import compiled, over_rows
from estimation.laws.plane import Prediction, tx_row, unit, wrapped
from scenes.pose import Pose
from scenes.record import FloatArray

_MIN_DEPTH_M = 1e-9  # lower limit of the sum of the depths of TX and RX in front of a wall


def predict_walls(tx: Pose | FloatArray, state: FloatArray, walls: FloatArray) -> Prediction:
    """Specular path off one or more walls.

    Parameters
    ----------
    walls
        (..., bounce, 2) in the order from TX to RX. `by_landmark` has 2 parameters per bounce, in this order.
    """
    return Prediction(*over_rows(_wall_paths, (tx_row(tx), 1), (state, 1), (walls, 2)))


def wall_places(
    wall: FloatArray, tx: Pose | FloatArray, rx_m: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Place (...) in m of each specular point along a wall (..., 2).

    Also its derivatives by the wall (..., 2) and by the RX position (..., 2).
    """
    place, by_wall, by_rx = over_rows(_places, (wall, 1), (tx_row(tx)[..., :2], 1), (rx_m, 1))
    return place, by_wall, by_rx


def wall_line(tx: Pose | FloatArray, state: FloatArray, point_m: FloatArray) -> FloatArray:
    """The wall (..., 2) that reflects at each IP (..., xy), its normal pointing from the TX to its mirror image.

    The image is on the ray from the receiver through the IP, at the length of the path.
    """
    source = tx_row(tx)
    leg = point_m - state[..., :2]
    to_tx = np.linalg.norm(point_m - source[..., :2], axis=-1, keepdims=True)
    image = point_m + leg / np.linalg.norm(leg, axis=-1, keepdims=True) * to_tx
    normal = image - source[..., :2]
    azimuth = np.arctan2(normal[..., 1], normal[..., 0])
    offset = point_m[..., 0] * np.cos(azimuth) + point_m[..., 1] * np.sin(azimuth)
    return np.stack([azimuth, offset], axis=-1)


@compiled
def mirror_point(x: float, y: float, wall: FloatArray) -> tuple[float, float]:
    """Mirror image of a point, p' = p + 2 (offset - n' p) n."""
    nx, ny = np.cos(wall[0]), np.sin(wall[0])
    gap = wall[1] - nx * x - ny * y
    return x + 2 * gap * nx, y + 2 * gap * ny


@compiled
def wall_place(wall: FloatArray, t: FloatArray, r: FloatArray) -> tuple[float, float, float, float]:
    """Place in m along a wall of the specular point between t and r, the depths of both, and their sum.

    A sum near zero is replaced by a small number.
    """
    nx, ny = np.cos(wall[0]), np.sin(wall[0])
    depth_t, depth_r = nx * t[0] + ny * t[1] - wall[1], nx * r[0] + ny * r[1] - wall[1]
    total = depth_t + depth_r
    if abs(total) < _MIN_DEPTH_M:
        total = _MIN_DEPTH_M
    place_t, place_r = nx * t[1] - ny * t[0], nx * r[1] - ny * r[0]
    return (place_r * depth_t + place_t * depth_r) / total, depth_t, depth_r, total


@compiled
def mirror_path(
    tx: FloatArray,
    state: FloatArray,
    wall: FloatArray,
    value: FloatArray,
    by_state: FloatArray,
    by_wall: FloatArray,
    point: FloatArray,
) -> None:
    """`wall_path` off one wall (2,): the ray to the image of the RX mirrors that from the RX to the TX's image."""
    nx, ny = np.cos(wall[0]), np.sin(wall[0])
    gap_t, gap_r = wall[1] - nx * tx[0] - ny * tx[1], wall[1] - nx * state[0] - ny * state[1]
    place_t, place_r = nx * tx[1] - ny * tx[0], nx * state[1] - ny * state[0]
    ux, uy, length = unit(tx[0] + 2 * gap_t * nx - state[0], tx[1] + 2 * gap_t * ny - state[1])
    along = 2 * (nx * ux + ny * uy)
    wx, wy = along * nx - ux, along * ny - uy
    rx, ry = -uy / length, ux / length  # gradient of the arrival's azimuth by the image of the TX
    qx, qy = -wy / length, wx / length  # of the departure's by the image of the RX
    value[0] = length + state[3]
    value[1] = np.arctan2(wy, wx) - tx[2]
    value[2] = np.arctan2(uy, ux) - state[2]
    by_state[:] = 0.0
    by_state[0, 0], by_state[0, 1], by_state[0, 3] = -ux, -uy, 1.0
    across = 2 * (qx * nx + qy * ny)
    by_state[1, 0], by_state[1, 1] = qx - across * nx, qy - across * ny
    by_state[2, 0], by_state[2, 1], by_state[2, 2] = -rx, -ry, -1.0
    ax, ay = 2 * (-gap_t * ny - place_t * nx), 2 * (gap_t * nx - place_t * ny)  # image of the TX by the azimuth
    bx, by = 2 * (-gap_r * ny - place_r * nx), 2 * (gap_r * nx - place_r * ny)  # image of the RX
    by_wall[0, 0], by_wall[0, 1] = ux * ax + uy * ay, along
    by_wall[1, 0], by_wall[1, 1] = qx * bx + qy * by, across
    by_wall[2, 0], by_wall[2, 1] = rx * ax + ry * ay, 2 * (rx * nx + ry * ny)
    total = -gap_t - gap_r
    if abs(total) < _MIN_DEPTH_M:
        total = _MIN_DEPTH_M
    place = -(place_r * gap_t + place_t * gap_r) / total
    point[0], point[1] = wall[1] * nx - place * ny, wall[1] * ny + place * nx


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
    """Path off walls (bounce, 2): measurement (3,), derivatives (3, 4) and (3, 2 bounce), IP (2,).

    The image of the TX in all walls gives range and arrival; the image of the RX in all walls, in reverse order,
    gives the departure. Azimuths are not wrapped. The IP is that of a single bounce off the last wall.
    """
    n = walls.shape[0]
    image_by, target_by = np.empty((n, 2, 2)), np.empty((n, 2, 2))
    turn = np.empty((2, 2))
    ix, iy = _images(tx[0], tx[1], walls, False, image_by, turn)
    jx, jy = _images(state[0], state[1], walls, True, target_by, turn)
    ux, uy, length = unit(ix - state[0], iy - state[1])
    wx, wy, reach = unit(jx - tx[0], jy - tx[1])
    rx, ry = -uy / length, ux / length  # gradient of the arrival's azimuth
    qx, qy = -wy / reach, wx / reach  # of the departure's
    value[0] = length + state[3]
    value[1] = np.arctan2(wy, wx) - tx[2]
    value[2] = np.arctan2(uy, ux) - state[2]
    by_state[:] = 0.0
    by_state[0, 0], by_state[0, 1], by_state[0, 3] = -ux, -uy, 1.0
    by_state[1, 0], by_state[1, 1] = qx * turn[0, 0] + qy * turn[1, 0], qx * turn[0, 1] + qy * turn[1, 1]
    by_state[2, 0], by_state[2, 1], by_state[2, 2] = -rx, -ry, -1.0
    for b in range(n):
        for p in range(2):
            by_wall[0, 2 * b + p] = ux * image_by[b, 0, p] + uy * image_by[b, 1, p]
            by_wall[1, 2 * b + p] = qx * target_by[b, 0, p] + qy * target_by[b, 1, p]
            by_wall[2, 2 * b + p] = rx * image_by[b, 0, p] + ry * image_by[b, 1, p]
    wall = walls[n - 1]
    nx, ny = np.cos(wall[0]), np.sin(wall[0])
    place, _, _, _ = wall_place(wall, tx, state)
    point[0], point[1] = wall[1] * nx - place * ny, wall[1] * ny + place * nx


@compiled
def _images(
    x: float, y: float, walls: FloatArray, backwards: bool, by_wall: FloatArray, turn: FloatArray
) -> tuple[float, float]:
    """Image of a point in walls (bounce, 2), in their order or `backwards`.

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
def _wall_paths(tx: FloatArray, state: FloatArray, walls: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    n, point = len(state), np.empty(2)
    value, by_state = np.empty((n, 3)), np.empty((n, 3, 4))
    by_wall = np.empty((n, 3, 2 * walls.shape[1]))
    for i in range(n):
        wall_path(tx[i], state[i], walls[i], value[i], by_state[i], by_wall[i], point)
        value[i, 1], value[i, 2] = wrapped(value[i, 1]), wrapped(value[i, 2])
    return value, by_state, by_wall


@compiled
def _places(wall: FloatArray, t: FloatArray, r: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    n = len(wall)
    place, by_wall, by_rx = np.empty(n), np.empty((n, 2)), np.empty((n, 2))
    for i in range(n):
        nx, ny = np.cos(wall[i, 0]), np.sin(wall[i, 0])
        place_t, place_r = nx * t[i, 1] - ny * t[i, 0], nx * r[i, 1] - ny * r[i, 0]
        at, depth_t, depth_r, total = wall_place(wall[i], t[i], r[i])
        turned = 2 * place_t * place_r - (depth_r + wall[i, 1]) * depth_t - (depth_t + wall[i, 1]) * depth_r
        place[i] = at
        by_wall[i, 0] = (turned - at * (place_t + place_r)) / total
        by_wall[i, 1] = (2 * at - place_t - place_r) / total
        by_rx[i, 0] = (-depth_t * ny + (place_t - at) * nx) / total
        by_rx[i, 1] = (depth_t * nx + (place_t - at) * ny) / total
    return place, by_wall, by_rx
