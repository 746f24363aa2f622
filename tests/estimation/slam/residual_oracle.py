"""Residuals of a campaign in plain array operations: the slow, obvious form of the compiled ones.

The functions have the names and the meaning of those in `estimation.laws` and `estimation.slam.walk.linearise`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.laws.plane import Prediction, bounce_equation, residual
from estimation.slam.config import TrajectoryConfig
from estimation.slam.walk.residuals import (
    Association,
    Observations,
    PathClass,
    TrajectoryState,
    without_heading_offsets,
)
from scenes.pose import Pose, wrap_angle
from scenes.record import FloatArray, IntArray


@dataclass(frozen=True)
class Block:
    """Whitened residuals (path, d) of some paths with their derivatives."""

    path: IntArray  # (path,)
    value: FloatArray  # (path, d)
    by_state: FloatArray  # (path, d, 4)
    by_shared: FloatArray  # (path, d, p)
    shared: IntArray  # (path, p) columns of the shared parameters


def residual_blocks(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> list[Block]:
    """Whitened residuals of all paths in use, one block per kind of path."""
    blocks = []
    for kind in (PathClass.LOS, PathClass.BOUNCE, PathClass.WALL, PathClass.OBJECT, PathClass.DOUBLE):
        path = np.flatnonzero(link.kind == kind)
        if len(path):
            build = _bounce_block if kind is PathClass.BOUNCE else _direct_block
            blocks.append(build(seen, link, now, config, path))
    return blocks


def landmark_residual(
    tx: Pose, state: FloatArray, measured: FloatArray, covariance: FloatArray, walls: FloatArray, rough_m: float
) -> tuple[FloatArray, FloatArray, Prediction]:
    """Residual (..., 3), its covariance and the prediction of paths off walls (..., bounce, 2)."""
    prediction = predict_walls(tx, state, walls)
    point = wall_point(tx, state[..., :2], walls[..., -1, :])
    return _with_roughness(tx, state, measured, covariance, point, prediction, rough_m)


def object_residual(
    tx: Pose, state: FloatArray, measured: FloatArray, covariance: FloatArray, circle: FloatArray, rough_m: float
) -> tuple[FloatArray, FloatArray, Prediction]:
    """The same for paths off circles (..., 3)."""
    prediction = predict_circle(tx, state, circle)
    point = circle[..., :2]
    return _with_roughness(tx, state, measured, covariance, point, prediction, rough_m)


def _bounce_block(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig, path: IntArray
) -> Block:
    row = seen.row[path]
    measured, state, covariance = without_heading_offsets(seen, now, path), now.state[row], seen.covariance[path]
    equation = bounce_equation(seen.tx, state[:, 2], measured)
    away = state[:, :2] - seen.tx.position_m[:2]
    along = away[:, 0] * equation.row[:, 1] - away[:, 1] * equation.row[:, 0]
    reach = (measured[:, 0] - state[:, 3]) * equation.along
    by_measured = np.stack([-equation.row[:, 2], -(along + reach) / 2, -(along - reach) / 2], axis=-1)
    by_state = np.column_stack([equation.row[:, :2], by_measured[:, 2], equation.row[:, 2]])
    scale = 1 / np.sqrt(np.einsum("ni,nij,nj->n", by_measured, covariance, by_measured))
    return Block(
        path,
        (equation.residual_m(state[:, [0, 1, 3]]) * scale)[:, None],
        (by_state * scale[:, None])[:, None],
        (by_measured[:, 1] * scale)[:, None, None],
        now.session[row][:, None],
    )


def _direct_block(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig, path: IntArray
) -> Block:
    """Line of sight or paths off landmarks: three residuals each."""
    row, kind, index = seen.row[path], link.kind[path[0]], link.landmark[path]
    measured, state, covariance = without_heading_offsets(seen, now, path), now.state[row], seen.covariance[path]
    offsets, walls = len(now.offset_rad), now.walls
    if kind == PathClass.LOS:
        difference = residual(measured, predict_los(seen.tx, state))
        by_landmark = np.empty((len(path), 3, 0))
        by_state = los_jacobian_rx(seen.tx, state)
        columns = np.empty((len(path), 0), int)
    elif kind == PathClass.OBJECT:
        difference, covariance, found = object_residual(
            seen.tx, state, measured, covariance, now.objects[index[:, 0]], config.object_roughness_m
        )
        by_landmark, by_state = found.by_landmark, found.by_state
        columns = offsets + walls.size + 3 * index[:, :1] + np.arange(3)
    else:
        used = index[:, : 1 if kind == PathClass.WALL else 2]
        difference, covariance, found = landmark_residual(
            seen.tx, state, measured, covariance, walls[used], config.wall_roughness_m
        )
        by_landmark, by_state = found.by_landmark, found.by_state
        columns = offsets + (2 * used[..., None] + np.arange(2)).reshape(len(path), -1)
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    by_shared = np.concatenate([whiten[..., 1:2], -whiten @ by_landmark], axis=-1)
    return Block(
        path,
        np.einsum("nab,nb->na", whiten, difference),
        -whiten @ by_state,
        by_shared,
        np.concatenate([now.session[row][:, None], columns], axis=1),
    )


def _with_roughness(
    tx: Pose,
    state: FloatArray,
    measured: FloatArray,
    covariance: FloatArray,
    point: FloatArray,
    prediction: Prediction,
    rough_m: float,
) -> tuple[FloatArray, FloatArray, Prediction]:
    """The IP may be off the surface by `rough_m` in any direction."""
    by_point = bounce_jacobian_point(tx, state, point)
    rough = rough_m**2 * by_point @ np.swapaxes(by_point, -1, -2)
    return residual(measured, prediction.value), covariance + rough, prediction


def predict_bounce(tx: Pose, rx_state: FloatArray, point_m: FloatArray) -> FloatArray:
    """Measurement (..., 3) of the single bounce at each IP (..., 2): g of equation (3)."""
    from_tx, from_rx = point_m - tx.position_m[:2], point_m - rx_state[..., :2]
    return np.stack(
        [
            _norm(from_tx) + _norm(from_rx) + rx_state[..., 3],
            wrap_angle(_azimuth(from_tx) - tx.heading_rad),
            wrap_angle(_azimuth(from_rx) - rx_state[..., 2]),
        ],
        axis=-1,
    )


def bounce_jacobian_point(tx: Pose, rx_state: FloatArray, point_m: FloatArray) -> FloatArray:
    """Derivative (..., 3, 2) of `predict_bounce` with respect to the IP."""
    from_tx, from_rx = point_m - tx.position_m[:2], point_m - rx_state[..., :2]
    unit_tx, turn_tx = _unit_and_turn(from_tx)
    unit_rx, turn_rx = _unit_and_turn(from_rx)
    return np.stack(np.broadcast_arrays(unit_tx + unit_rx, turn_tx, turn_rx), axis=-2)


def bounce_jacobian_rx(tx: Pose, rx_state: FloatArray, point_m: FloatArray) -> FloatArray:
    """Derivative (..., 3, 4) of `predict_bounce` with respect to the RX state."""
    unit_rx, turn_rx = _unit_and_turn(point_m - rx_state[..., :2])
    jacobian = np.zeros((*unit_rx.shape[:-1], 3, 4))
    jacobian[..., 0, :2] = -unit_rx
    jacobian[..., 2, :2] = -turn_rx
    jacobian[..., 2, 2] = -1.0
    jacobian[..., 0, 3] = 1.0
    return jacobian


def predict_los(tx: Pose, rx_state: FloatArray) -> FloatArray:
    """Measurement (..., 3) of the line of sight."""
    from_tx = rx_state[..., :2] - tx.position_m[:2]
    azimuth = _azimuth(from_tx)
    return np.stack(
        [
            _norm(from_tx) + rx_state[..., 3],
            wrap_angle(azimuth - tx.heading_rad),
            wrap_angle(azimuth + np.pi - rx_state[..., 2]),
        ],
        axis=-1,
    )


def los_jacobian_rx(tx: Pose, rx_state: FloatArray) -> FloatArray:
    """Derivative (..., 3, 4) of `predict_los` with respect to the RX state."""
    unit, turn = _unit_and_turn(rx_state[..., :2] - tx.position_m[:2])
    jacobian = np.zeros((*unit.shape[:-1], 3, 4))
    jacobian[..., 0, :2] = unit
    jacobian[..., 1, :2] = turn
    jacobian[..., 2, :2] = turn
    jacobian[..., 2, 2] = -1.0
    jacobian[..., 0, 3] = 1.0
    return jacobian


def _norm(vector: FloatArray) -> FloatArray:
    return np.hypot(vector[..., 0], vector[..., 1])


def _azimuth(vector: FloatArray) -> FloatArray:
    return np.arctan2(vector[..., 1], vector[..., 0])


def _unit_and_turn(vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gradients of length and azimuth of a vector (..., 2), the length kept above 1 um."""
    length = np.maximum(_norm(vector), 1e-6)[..., None]
    unit = vector / length
    turned = np.stack([-unit[..., 1], unit[..., 0]], axis=-1)
    return unit, turned / length


def predict_walls(tx: Pose, state: FloatArray, walls: FloatArray) -> Prediction:
    """Specular path off one or more walls, in the order from TX to RX.

    The image of the TX in all walls, p_i' = p_i + 2 (offset - n' p_i) n, gives range and arrival; the image of
    the RX in all walls, in reverse order, gives the departure.

    Parameters
    ----------
    walls
        (..., bounce, 2) lines. `by_landmark` has 2 parameters per bounce, in order.
    """
    image, image_by_wall, _ = _mirror(np.broadcast_to(tx.position_m[:2], state[..., :2].shape), walls)
    target, target_by_wall, turn = _mirror(state[..., :2], walls[..., ::-1, :])
    target_by_wall = target_by_wall[..., ::-1, :, :]
    arrival, departure = image - state[..., :2], target - tx.position_m[:2]
    length, unit, turn_rx = _polar(arrival)
    _, _, turn_tx = _polar(departure)
    value = np.stack(
        [
            length + state[..., 3],
            wrap_angle(np.arctan2(departure[..., 1], departure[..., 0]) - tx.heading_rad),
            wrap_angle(np.arctan2(arrival[..., 1], arrival[..., 0]) - state[..., 2]),
        ],
        axis=-1,
    )
    by_state = np.zeros((*length.shape, 3, 4))
    by_state[..., 0, :2] = -unit
    by_state[..., 0, 3] = 1.0
    by_state[..., 1, :2] = np.einsum("...i,...ij->...j", turn_tx, turn)
    by_state[..., 2, :2] = -turn_rx
    by_state[..., 2, 2] = -1.0
    n = 2 * walls.shape[-2]
    image_by_wall = np.moveaxis(image_by_wall, -3, -2).reshape(*length.shape, 2, n)
    target_by_wall = np.moveaxis(target_by_wall, -3, -2).reshape(*length.shape, 2, n)
    by_landmark = np.stack(
        [
            np.einsum("...i,...ij->...j", unit, image_by_wall),
            np.einsum("...i,...ij->...j", turn_tx, target_by_wall),
            np.einsum("...i,...ij->...j", turn_rx, image_by_wall),
        ],
        axis=-2,
    )
    return Prediction(value, by_state, by_landmark)


def predict_circle(tx: Pose, state: FloatArray, circle: FloatArray) -> Prediction:
    """Specular path off the lit side of a circle (..., 3).

    The IP q = c + radius m is where the tangent is perpendicular to the sum of the unit vectors from both
    devices; its derivatives follow from that condition.
    """
    centre, radius = circle[..., :2], circle[..., 2, None]
    source, receiver = tx.position_m[:2], state[..., :2]
    normal = _unit(_unit(source - centre) + _unit(receiver - centre))
    for _ in range(30):
        point, before = centre + radius * normal, normal
        normal = _unit(_unit(source - point) + _unit(receiver - point))
        if np.all(np.abs(normal - before) < 1e-13):
            break
    point = centre + radius * normal
    tangent = np.stack([-normal[..., 1], normal[..., 0]], axis=-1)
    across_tx, across_rx = _transverse(point - source), _transverse(point - receiver)
    both = np.einsum("...i,...ij->...j", tangent, across_tx + across_rx)
    units = _unit(point - source) + _unit(point - receiver)
    slope = -_dot(normal, units) + radius[..., 0] * _dot(both, tangent)
    # d angle / d [x, y of RX, x, y of centre, radius]
    by_receiver = np.einsum("...i,...ij->...j", tangent, across_rx) / slope[..., None]
    by_circle = -np.concatenate([both, _dot(both, normal)[..., None]], axis=-1) / slope[..., None]
    sweep = radius * tangent
    point_by_rx = sweep[..., :, None] * by_receiver[..., None, :]
    direct = np.concatenate([np.broadcast_to(np.eye(2), (*normal.shape[:-1], 2, 2)), normal[..., None]], axis=-1)
    point_by_circle = direct + sweep[..., :, None] * by_circle[..., None, :]
    by_point = bounce_jacobian_point(tx, state, point)
    by_state = bounce_jacobian_rx(tx, state, point)
    by_state[..., :2] += by_point @ point_by_rx
    return Prediction(predict_bounce(tx, state, point), by_state, by_point @ point_by_circle)


def wall_point(tx: Pose, position_m: FloatArray, wall: FloatArray) -> FloatArray:
    """Specular point (..., 2) on a wall (..., 2) for RX positions (..., 2)."""
    image, _, _ = _mirror(np.broadcast_to(tx.position_m[:2], position_m.shape), wall[..., None, :])
    normal = _unit_vector(wall[..., 0])
    before, after = wall[..., 1] - _dot(normal, image), wall[..., 1] - _dot(normal, position_m)
    total = before - after
    share = before / np.where(np.abs(total) < 1e-9, 1e-9, total)
    return np.asarray(image + share[..., None] * (position_m - image))


def _mirror(point: FloatArray, walls: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Image of a point in walls (..., bounce, 2), one after the other.

    Returns the image (..., 2), its derivatives (..., bounce, 2, 2) by each wall's (azimuth, offset), the bounce
    axis in the order of the walls, and the derivative (..., 2, 2) by the point.
    """
    derivatives: list[FloatArray] = []
    turn = np.broadcast_to(np.eye(2), (*point.shape[:-1], 2, 2))
    for b in range(walls.shape[-2]):
        azimuth, offset = walls[..., b, 0], walls[..., b, 1]
        normal = _unit_vector(azimuth)
        tangent = np.stack([-normal[..., 1], normal[..., 0]], axis=-1)
        gap = offset - _dot(normal, point)
        by_azimuth = 2 * (gap[..., None] * tangent - _dot(tangent, point)[..., None] * normal)
        reflect = np.eye(2) - 2 * normal[..., :, None] * normal[..., None, :]
        derivatives = [reflect @ d for d in derivatives]
        derivatives.append(np.stack([by_azimuth, 2 * normal], axis=-1))
        turn = reflect @ turn
        point = point + 2 * gap[..., None] * normal
    return point, np.stack(np.broadcast_arrays(*derivatives), axis=-3), turn


def _polar(vector: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Length, unit vector and gradient of the azimuth of a vector (..., 2)."""
    length = np.maximum(np.hypot(vector[..., 0], vector[..., 1]), 1e-6)
    unit = vector / length[..., None]
    return length, unit, np.stack([-unit[..., 1], unit[..., 0]], axis=-1) / length[..., None]


def _transverse(vector: FloatArray) -> FloatArray:
    """Derivative (..., 2, 2) of a vector's unit vector by the vector."""
    length, unit, _ = _polar(vector)
    return np.asarray((np.eye(2) - unit[..., :, None] * unit[..., None, :]) / length[..., None, None])


def _unit(vector: FloatArray) -> FloatArray:
    return _polar(vector)[1]


def _unit_vector(azimuth_rad: FloatArray) -> FloatArray:
    return np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], axis=-1)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...i,...i->...", a, b))
