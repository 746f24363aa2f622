"""Residuals of a whole campaign: its paths, what they are taken for, and the unknowns that explain them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from estimation.geometry import bounce_jacobian_point, los_jacobian_rx, predict_los, residual
from estimation.slam.config import TrajectoryConfig
from estimation.slam.landmarks import Prediction, predict_circle, predict_walls, wall_point
from estimation.slam.refine import bounce_terms
from scenes.pose import Pose
from scenes.record import BoolArray, FloatArray, IntArray


class PathKind(IntEnum):
    """What the smoother takes a path for."""

    UNUSED = 0
    LOS = 1
    BOUNCE = 2  # a single bounce at a place of its own
    WALL = 3
    OBJECT = 4
    DOUBLE = 5  # by way of two walls


@dataclass(frozen=True)
class Observations:
    """Paths of all stops, in the units of `estimation.geometry`."""

    tx: Pose
    n_stops: int
    row: IntArray  # (path,) index of the stop
    measured: FloatArray  # (path, 3)
    covariance: FloatArray  # (path, 3, 3)


@dataclass(frozen=True)
class Association:
    """What every path is taken for. `landmark` (path, 2): walls of WALL and DOUBLE, object of OBJECT."""

    kind: IntArray
    landmark: IntArray


@dataclass(frozen=True)
class TrajectoryState:
    """All unknowns. `session` (stop,) tells which offset applies; the offset of `anchor` is held at zero."""

    state: FloatArray  # (stop, 4) in m, m, rad, m
    offset_rad: FloatArray  # (session,)
    walls: FloatArray  # (wall, 2)
    objects: FloatArray  # (object, 3)
    session: IntArray  # (stop,)
    anchor: int
    course: FloatArray  # (stop - 2, 2) unit vector of the walk at the inner stops

    @property
    def n_shared(self) -> int:
        """Number of parameters that stops share."""
        return len(self.offset_rad) + self.walls.size + self.objects.size

    def moved(self, step: FloatArray, shared: FloatArray) -> TrajectoryState:
        """The unknowns after a step."""
        a, b = len(self.offset_rad), len(self.offset_rad) + self.walls.size
        return replace(
            self,
            state=self.state + step,
            offset_rad=self.offset_rad + shared[:a],
            walls=self.walls + shared[a:b].reshape(-1, 2),
            objects=self.objects + shared[b:].reshape(-1, 3),
        )


@dataclass(frozen=True)
class Block:
    """Whitened residuals (path, d) of some paths with their derivatives."""

    path: IntArray  # (path,)
    value: FloatArray  # (path, d)
    by_state: FloatArray  # (path, d, 4)
    by_shared: FloatArray  # (path, d, p)
    shared: IntArray  # (path, p) columns of the shared parameters


def corrected(seen: Observations, now: TrajectoryState, path: IntArray | BoolArray) -> FloatArray:
    """Measurements of some paths with the departure turned by their session's TX heading offset."""
    measured = seen.measured[path].copy()
    measured[:, 1] += now.offset_rad[now.session[seen.row[path]]]
    return measured


def residual_blocks(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig
) -> list[Block]:
    """Whitened residuals of all paths in use, one block per kind of path."""
    blocks = []
    for kind in (PathKind.LOS, PathKind.BOUNCE, PathKind.WALL, PathKind.OBJECT, PathKind.DOUBLE):
        path = np.flatnonzero(link.kind == kind)
        if len(path):
            build = _bounce_block if kind is PathKind.BOUNCE else _direct_block
            blocks.append(build(seen, link, now, config, path))
    return blocks


def landmark_residual(
    tx: Pose,
    state: FloatArray,
    measured: FloatArray,
    covariance: FloatArray,
    walls: FloatArray,
    rough_m: float,
) -> tuple[FloatArray, FloatArray, Prediction]:
    """Residual (..., 3), its covariance and the prediction of paths by way of walls (..., bounce, 2)."""
    prediction = predict_walls(tx, state, walls)
    point = wall_point(tx, state[..., :2], walls[..., -1, :])
    return _with_roughness(tx, state, measured, covariance, point, prediction, rough_m)


def object_residual(
    tx: Pose,
    state: FloatArray,
    measured: FloatArray,
    covariance: FloatArray,
    circle: FloatArray,
    rough_m: float,
) -> tuple[FloatArray, FloatArray, Prediction]:
    """The same for paths by way of circles (..., 3)."""
    prediction = predict_circle(tx, state, circle)
    point = circle[..., :2]
    return _with_roughness(tx, state, measured, covariance, point, prediction, rough_m)


def _bounce_block(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig, path: IntArray
) -> Block:
    row = seen.row[path]
    terms = bounce_terms(seen.tx, corrected(seen, now, path), seen.covariance[path], now.state[row])
    scale = 1 / np.sqrt(terms.variance_m2)
    return Block(
        path,
        (terms.value_m * scale)[:, None],
        (terms.jacobian * scale[:, None])[:, None],
        (terms.by_measurement[:, 1] * scale)[:, None, None],
        now.session[row][:, None],
    )


def _direct_block(
    seen: Observations, link: Association, now: TrajectoryState, config: TrajectoryConfig, path: IntArray
) -> Block:
    """Line of sight or paths by way of landmarks: three residuals each."""
    row, kind, index = seen.row[path], link.kind[path[0]], link.landmark[path]
    measured, state, covariance = corrected(seen, now, path), now.state[row], seen.covariance[path]
    offsets, walls = len(now.offset_rad), now.walls
    if kind == PathKind.LOS:
        difference = residual(measured, predict_los(seen.tx, state))
        by_landmark = np.empty((len(path), 3, 0))
        by_state = los_jacobian_rx(seen.tx, state)
        columns = np.empty((len(path), 0), int)
    elif kind == PathKind.OBJECT:
        difference, covariance, found = object_residual(
            seen.tx, state, measured, covariance, now.objects[index[:, 0]], config.object_roughness_m
        )
        by_landmark, by_state = found.by_landmark, found.by_state
        columns = offsets + walls.size + 3 * index[:, :1] + np.arange(3)
    else:
        used = index[:, : 1 if kind == PathKind.WALL else 2]
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
    """The surface is known up to `rough_m`: the IP may stand off it that far in any direction."""
    by_point = bounce_jacobian_point(tx, state, point)
    rough = rough_m**2 * by_point @ np.swapaxes(by_point, -1, -2)
    return residual(measured, prediction.value), covariance + rough, prediction
