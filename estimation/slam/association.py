"""Which shared landmark a path comes from: incidence points clustered into walls and compact objects."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, permutations

import numpy as np
from scipy.stats import chi2
from sklearn.cluster import DBSCAN

from estimation.geometry import start_point
from estimation.slam.config import TrajectoryConfig
from estimation.slam.landmarks import wall_point
from estimation.slam.mapping import point_covariance
from estimation.slam.refine import bounce_terms
from estimation.slam.residuals import (
    Association,
    Observations,
    PathKind,
    TrajectoryState,
    corrected,
    landmark_residual,
    object_residual,
)
from scenes.record import BoolArray, FloatArray, IntArray

# Incidence points less certain than this take no part in finding landmarks.
_MAX_POINT_STD_M = 0.6
_WALL_TOLERANCE_M = 0.25
_MAX_OBJECT_SCATTER_M = 0.4
_END_MARGIN_M = 0.7


def single_bounces(
    seen: Observations, now: TrajectoryState, is_los: BoolArray, config: TrajectoryConfig
) -> BoolArray:
    """Paths (path,) that the present trajectory explains as a single bounce somewhere."""
    everyone = np.ones(len(is_los), bool)
    terms = bounce_terms(seen.tx, corrected(seen, now, everyone), seen.covariance, now.state[seen.row])
    gate = chi2.ppf(config.gate_probability, 1)
    return np.asarray(~is_los & terms.is_feasible & (terms.value_m**2 <= gate * terms.variance_m2))


def associate(
    seen: Observations, now: TrajectoryState, is_los: BoolArray, config: TrajectoryConfig
) -> tuple[Association, TrajectoryState]:
    """Explain every path at the present trajectory, and start the landmarks it shows.

    Single bounces are mapped and clustered; long clusters become walls, compact ones circles. A path belongs to
    the landmark that predicts it best, if within the gate; a single bounce without one keeps an IP of its own;
    what is left may be a double bounce between two walls.
    """
    bounce = single_bounces(seen, now, is_los, config)
    kind = np.where(is_los, PathKind.LOS, np.where(bounce, PathKind.BOUNCE, PathKind.UNUSED))
    link = Association(kind, np.full((len(kind), 2), -1))
    now = replace(now, walls=np.empty((0, 2)), objects=np.empty((0, 3)))
    if not config.use_landmarks or not bounce.any():
        return link, now
    path = np.flatnonzero(bounce)
    state, measured = now.state[seen.row[path]], corrected(seen, now, path)
    point = start_point(seen.tx, state, measured)
    covariance, _ = point_covariance(seen.tx, state, point, seen.covariance[path])
    sharp = np.linalg.eigvalsh(covariance)[:, -1] < _MAX_POINT_STD_M**2
    walls, objects, spans = find_landmarks(point[sharp], config)
    now = replace(now, walls=walls, objects=objects)
    return assign(seen, now, link, spans, config), now


def find_landmarks(
    point_m: FloatArray, config: TrajectoryConfig
) -> tuple[FloatArray, FloatArray, list[tuple[float, float]]]:
    """Walls (wall, 2), circles (object, 3) and the extents of the walls along themselves, from IPs (ip, 2)."""
    walls: list[FloatArray] = []
    objects: list[FloatArray] = []
    spans: list[tuple[float, float]] = []
    if not len(point_m):
        return np.empty((0, 2)), np.empty((0, 3)), spans
    label = DBSCAN(eps=config.cluster_eps_m, min_samples=config.cluster_min_samples).fit_predict(point_m)
    for cluster in range(label.max() + 1):
        rest = point_m[label == cluster]
        while len(rest) >= config.cluster_min_samples:
            if _scatter(rest) <= _MAX_OBJECT_SCATTER_M and _extent(rest) <= config.max_object_extent_m:
                objects.append(np.array([*np.median(rest, axis=0), config.object_radius_m]))
                break
            wall, on_wall = _best_line(rest)
            along = rest[on_wall] @ np.array([-np.sin(wall[0]), np.cos(wall[0])])
            enough = np.count_nonzero(on_wall) >= config.cluster_min_samples
            if not enough or np.ptp(along) < config.min_wall_length_m:
                break
            walls.append(wall)
            spans.append((float(along.min()), float(along.max())))
            rest = rest[~on_wall]
    return np.array(walls).reshape(-1, 2), np.array(objects).reshape(-1, 3), spans


def assign(
    seen: Observations,
    now: TrajectoryState,
    link: Association,
    spans: list[tuple[float, float]],
    config: TrajectoryConfig,
) -> Association:
    """Give every path but the lines of sight to the landmark of smallest chi-square within the gate."""
    kind, landmark = link.kind.copy(), link.landmark.copy()
    path = np.flatnonzero(kind != PathKind.LOS)
    limit = chi2.ppf(config.gate_probability, 3)
    best = np.full(len(path), limit)
    for w in range(len(now.walls)):
        distance = wall_distance(seen, now, path, np.array([w]), config)
        distance[~_within(seen, now, path, w, spans[w])] = np.inf
        best = _take(best, distance, path, kind, landmark, PathKind.WALL, (w, -1))
    for o in range(len(now.objects)):
        distance = _object_distance(seen, now, path, o, config)
        best = _take(best, distance, path, kind, landmark, PathKind.OBJECT, (o, -1))
    if config.use_double_bounces:
        path = np.flatnonzero(kind == PathKind.UNUSED)
        best = np.full(len(path), chi2.ppf(0.95, 3))
        for a, b in permutations(range(len(now.walls)), 2):
            distance = wall_distance(seen, now, path, np.array([a, b]), config)
            best = _take(best, distance, path, kind, landmark, PathKind.DOUBLE, (a, b))
    return Association(kind, landmark)


def wall_distance(
    seen: Observations, now: TrajectoryState, path: IntArray, walls: IntArray, config: TrajectoryConfig
) -> FloatArray:
    """Chi-square distance (path,), 3 degrees of freedom, to the path by way of the walls of these indices."""
    state = now.state[seen.row[path]]
    chain = np.broadcast_to(now.walls[walls], (len(path), len(walls), 2))
    difference, covariance, _ = landmark_residual(
        seen.tx, state, corrected(seen, now, path), seen.covariance[path], chain, config.wall_roughness_m
    )
    return _quadratic(difference, covariance)


def _object_distance(
    seen: Observations, now: TrajectoryState, path: IntArray, index: int, config: TrajectoryConfig
) -> FloatArray:
    state = now.state[seen.row[path]]
    circle = np.broadcast_to(now.objects[index], (len(path), 3))
    difference, covariance, _ = object_residual(
        seen.tx, state, corrected(seen, now, path), seen.covariance[path], circle, config.object_roughness_m
    )
    return _quadratic(difference, covariance)


def _within(
    seen: Observations, now: TrajectoryState, path: IntArray, wall: int, span: tuple[float, float]
) -> BoolArray:
    """Whether the specular point lies on the stretch of the wall that was seen."""
    line = np.broadcast_to(now.walls[wall], (len(path), 2))
    point = wall_point(seen.tx, now.state[seen.row[path], :2], line)
    along = point @ np.array([-np.sin(line[0, 0]), np.cos(line[0, 0])]) if len(path) else np.empty(0)
    return np.asarray((along > span[0] - _END_MARGIN_M) & (along < span[1] + _END_MARGIN_M))


def _take(
    best: FloatArray,
    distance: FloatArray,
    path: IntArray,
    kind: IntArray,
    landmark: IntArray,
    as_kind: PathKind,
    index: tuple[int, int],
) -> FloatArray:
    """Hand the paths that fit better than before to a landmark, in place; returns the new distances."""
    better = distance < best
    kind[path[better]], landmark[path[better]] = as_kind, index
    return np.where(better, distance, best)


def _best_line(point_m: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Line [azimuth of normal, offset] through two of the points with the most points near it, refitted."""
    pairs = np.array(list(combinations(range(min(len(point_m), 60)), 2)))
    along = point_m[pairs[:, 1]] - point_m[pairs[:, 0]]
    pairs = pairs[np.hypot(*along.T) > 0.5]
    if not len(pairs):
        return np.zeros(2), np.zeros(len(point_m), bool)
    along = point_m[pairs[:, 1]] - point_m[pairs[:, 0]]
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.hypot(*along.T)[:, None]
    gap = np.abs(normal @ point_m.T - np.sum(normal * point_m[pairs[:, 0]], axis=1)[:, None])
    closeness = np.sum(np.maximum(1 - (gap / _WALL_TOLERANCE_M) ** 2, 0), axis=1)
    on_wall = gap[int(np.argmax(closeness))] < _WALL_TOLERANCE_M
    centre = point_m[on_wall].mean(axis=0)
    axes = np.linalg.svd(point_m[on_wall] - centre, full_matrices=False)[2]
    n = np.array([-axes[0, 1], axes[0, 0]])
    return np.array([np.arctan2(n[1], n[0]), n @ centre]), on_wall


def _extent(point_m: FloatArray) -> float:
    """Length in m of the middle nine tenths of a cluster along its main axis."""
    along = (point_m - point_m.mean(axis=0)) @ np.linalg.svd(point_m - point_m.mean(axis=0))[2][0]
    low, high = np.quantile(along, [0.05, 0.95])
    return float(high - low)


def _scatter(point_m: FloatArray) -> float:
    """Standard deviation in m along the main axis."""
    return float(np.sqrt(np.linalg.eigvalsh(np.cov(point_m.T))[-1]))


def _quadratic(difference: FloatArray, covariance: FloatArray) -> FloatArray:
    solved = np.linalg.solve(covariance, difference[..., None])[..., 0]
    return np.asarray(np.sum(difference * solved, axis=-1))
