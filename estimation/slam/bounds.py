"""Cramer-Rao bounds of the receiver state and of the incidence points (IPs), per stop and along a walk.

Paths are independent and Gaussian. The IP of a single bounce is marginalised, which gives one equation per path
for the receiver state (a Schur complement of rank one). The stops of a walk are coupled by a smoothness prior of
the positions and by shared flat walls: lines that mirror the TX. States are [x, y, heading, bias] in m, m, rad,
m; measurements are those of `estimation.laws.plane`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.laws import plane as plane_law
from estimation.laws.contour import predict_circle
from estimation.laws.wall import predict_walls, wall_line
from estimation.slam.mapping.point_fit import point_bound, state_information
from scenes.pose import Pose
from scenes.record import FloatArray, IntArray

_NO_INFORMATION = 1e-12  # share of the largest eigenvalue of a scaled information below which there is no bound


@dataclass(frozen=True)
class StateBound:
    """Bounds on the standard deviation of unbiased estimates; infinite where unobservable."""

    position_m: FloatArray  # (...) root of the summed variance of x and y: the PEB
    heading_rad: FloatArray  # (...)
    clock_m: FloatArray  # (...)


@dataclass(frozen=True)
class StopPaths:
    """The paths of one stop that are informative of its receiver.

    `wall` (path,) is the number of the flat wall that the stops share, -1 for other paths; `circle` (path,) that
    of the round object of `RoundObjects`, or None.
    """

    point_m: FloatArray  # (path, xy) IPs of the single bounces
    covariance: FloatArray  # (path, 3, 3) in (m, rad, rad)^2
    wall: IntArray  # (path,)
    los_covariance: FloatArray | None = None  # (3, 3); None without a line of sight
    circle: IntArray | None = None  # (path,)


@dataclass(frozen=True)
class RoundObjects:
    """Round objects that the stops of a walk share, with a prior `radius_std_m` of their radii."""

    circle: FloatArray  # (object, 3) x, y, radius in m
    radius_std_m: float


def stop_information(tx: Pose, state: FloatArray, paths: StopPaths) -> FloatArray:
    """Fisher information (4, 4) of one receiver state (4,), the IPs marginalised."""
    return state_information(plane_law, tx, state, paths.point_m, paths.covariance, paths.los_covariance)


def shared_pose_information(parts: Sequence[FloatArray]) -> FloatArray:
    """Information (3 + tx, 3 + tx) of one pose and a clock bias per TX, from that of every TX (4, 4)."""
    total = np.zeros((3 + len(parts), 3 + len(parts)))
    for tx, part in enumerate(parts):
        at = plane_law.state_columns(np.array(tx))
        total[at[:, None], at] += part
    return total


def state_covariance(information: FloatArray) -> FloatArray:
    """Inverse (n, n) of an information; infinite variances of unknowns that are unobservable."""
    scale = np.sqrt(np.maximum(np.diagonal(information), 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    value, vector = np.linalg.eigh(information / np.outer(scale, scale))
    free = value <= _NO_INFORMATION * max(float(value[-1]), 1.0)
    kept = vector[:, ~free]
    covariance = (kept / value[~free]) @ kept.T / np.outer(scale, scale)
    touched = np.any(np.abs(vector[:, free]) > 1e-6, axis=1)
    covariance[touched, touched] = np.inf
    return np.asarray(covariance)


def state_bound(covariance: FloatArray) -> StateBound:
    """Bounds from covariances (..., 4, 4) of the state; with several TX the clock is that of the first."""
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    return StateBound(
        np.sqrt(variance[..., 0] + variance[..., 1]), np.sqrt(variance[..., 2]), np.sqrt(variance[..., 3])
    )


def stop_bound(tx: Pose, state: FloatArray, paths: StopPaths) -> tuple[StateBound, FloatArray]:
    """Bounds of one stop: of its receiver state, and (path,) in m of the position of each IP.

    The bounds of the IPs include the uncertainty of the state.
    """
    covariance = state_covariance(stop_information(tx, state, paths))
    points = point_bound(plane_law, tx, state, paths.point_m, paths.covariance, covariance)
    return state_bound(covariance), points


def trajectory_covariance(
    tx: Pose,
    states: FloatArray,
    stops: Sequence[StopPaths],
    smoothness_m: float | None,
    objects: RoundObjects | None = None,
) -> FloatArray:
    """Covariances (stop, 4, 4) of all receiver states (stop, 4) of a walk, estimated together.

    Single bounces off a numbered wall share its line, those off a numbered object its circle; each other one has
    its own IP. `smoothness_m` is the standard deviation of the second difference of the position per coordinate,
    in m per stop^2; None for no prior. The information is exact and dense: first the states, then the landmarks.
    """
    n = len(states)
    walls = sorted({int(wall) for stop in stops for wall in stop.wall if wall >= 0})
    column = {wall: 4 * n + 2 * index for index, wall in enumerate(walls)}
    first_circle = 4 * n + 2 * len(walls)
    size = first_circle + (objects.circle.size if objects is not None else 0)
    information = np.zeros((size, size))
    for index, (state, paths) in enumerate(zip(states, stops, strict=True)):
        own = slice(4 * index, 4 * index + 4)
        circle = np.full(len(paths.wall), -1) if paths.circle is None or objects is None else paths.circle
        loose = (paths.wall < 0) & (circle < 0)
        alone = StopPaths(paths.point_m[loose], paths.covariance[loose], paths.wall[loose], paths.los_covariance)
        information[own, own] += stop_information(tx, state, alone)
        line = wall_line(tx, state, paths.point_m)
        for path in np.flatnonzero(~loose):
            if circle[path] >= 0 and objects is not None:
                by = predict_circle(tx, state, objects.circle[circle[path]])
                at = np.r_[own, first_circle + 3 * circle[path] + np.arange(3)]
            else:
                by = predict_walls(tx, state, line[path, None])
                at = np.r_[own, column[int(paths.wall[path])] + np.arange(2)]
            jacobian = np.concatenate([by.by_state, by.by_landmark], axis=-1)
            information[np.ix_(at, at)] += jacobian.T @ np.linalg.inv(paths.covariance[path]) @ jacobian
    if objects is not None:
        radii = np.arange(first_circle + 2, size, 3)
        information[radii, radii] += objects.radius_std_m**-2.0
    if smoothness_m is not None and n > 2:
        difference = np.kron(np.diff(np.eye(n), 2, axis=0), np.eye(4)[:2]) / smoothness_m
        information[: 4 * n, : 4 * n] += difference.T @ difference
    covariance = state_covariance(information)
    return np.stack([covariance[4 * i : 4 * i + 4, 4 * i : 4 * i + 4] for i in range(n)])
