"""The objects of a campaign: clusters split by the reflection law, joined where one object explains several.

Gaps in the walk divide a wall into several clusters. Clusters are therefore only a start: after the split every
path may join any object, and objects that one contour explains as well are joined.
"""

from dataclasses import dataclass

import numpy as np

from estimation.laws.plane import bounce, residual
from estimation.shape.config import ReflectionConfig
from estimation.shape.gp.clustering import NOISE, cluster_points
from estimation.shape.reflection.association import GATE, GHOST, MIN_PATHS, ONE_GATE, GroupFits, split_rows
from estimation.shape.reflection.normals import oriented_points
from estimation.shape.reflection.posterior import Optimum
from estimation.shape.reflection.reflections import Reflections
from estimation.steps import steps
from scenes.record import BoolArray, FloatArray, IntArray

_MAX_ROUNDS = 6
_LEAST_M = 1e-9
_SHARED = 0.5  # share of the paths of an object that another explains: the two are then tried as one


@dataclass(frozen=True)
class FoundObject:
    """One object: the simplest kind of its class, its optimum, and its paths."""

    kind: str
    optimum: Optimum
    paths: IntArray  # rows of the data

    def holds(self, other: "FoundObject") -> bool:
        """Whether this is a pillar, and the other an edge on or in it: what its sides diffract or scatter."""
        if self.kind != "circle" or other.kind != "edge":
            return False
        body, edge = self.optimum, other.optimum
        offset_m, radius_m = edge.parameter - body.parameter[:2], float(np.exp(body.parameter[2]))
        distance_m = max(float(np.hypot(*offset_m)), _LEAST_M)
        slope = np.append(-offset_m / distance_m, -radius_m)
        variance = slope @ body.parameter_covariance @ slope
        variance += slope[:2] @ edge.parameter_covariance @ slope[:2]
        return bool(distance_m - radius_m < np.sqrt(ONE_GATE * variance))


def find_objects(data: Reflections, eps_m: float, min_samples: int, config: ReflectionConfig) -> list[FoundObject]:
    """Objects among all paths of a campaign; a path belongs to one of them or to none."""
    seeds, fits = [], GroupFits(data, config)
    label = seed_clusters(data, eps_m, min_samples)
    for cluster in steps(range(int(label.max(initial=NOISE)) + 1), "cluster"):
        rows = np.flatnonzero(label == cluster)
        split = split_rows(fits, rows)
        seeds += [rows[split.label == k] for k in range(len(split.kind))]
    return refit_objects(fits, seeds, min_samples)


def refit_objects(fits: GroupFits, seeds: list[IntArray], min_paths: int) -> list[FoundObject]:
    """Objects from the paths of `seeds`. Joining objects, assigning paths to them and fitting them alternate."""
    objects = _objects(fits, seeds, min_paths)
    for _ in range(_MAX_ROUNDS):
        before = [each.paths for each in objects]
        objects = _joined(fits, objects)
        objects = _objects(fits, _choices(fits, objects), min_paths)
        if len(before) == len(objects) and all(
            np.array_equal(old, new.paths) for old, new in zip(before, objects, strict=True)
        ):
            break
    return objects


def seed_clusters(data: Reflections, eps_m: float, min_samples: int) -> IntArray:
    """Cluster (path,) of the incidence points of the paths that can be single bounces, -1 for none."""
    label = np.full(len(data), NOISE)
    if not len(data):
        return label
    points = oriented_points(data)
    largest = np.linalg.eigvalsh(points.covariance_m2)[:, -1]
    good = (largest <= eps_m**2) & _is_single_bounce(data, points.position_m)
    label[good] = cluster_points(points.position_m[good], eps_m, min_samples)
    return label


def _is_single_bounce(data: Reflections, point_m: FloatArray) -> BoolArray:
    """Whether the point (path, xy) of each path explains its three measurements within the gate."""
    predicted = bounce(data.tx, data.rx_state, point_m)
    by_rx = predicted.by_state
    covariance = data.covariance_with_poses(by_rx)
    difference = residual(data.measured, predicted.value)
    return np.asarray(np.einsum("na,nab,nb->n", difference, np.linalg.inv(covariance), difference) <= GATE)


def _objects(fits: GroupFits, groups: list[IntArray], min_paths: int) -> list[FoundObject]:
    """The groups that have enough paths and evidence for an object, the largest first."""
    least, objects = max(min_paths, MIN_PATHS), []
    for rows in groups:
        best = fits.fit(rows) if len(rows) >= least else None
        if best is not None and np.count_nonzero(best[1].inlier > 0.5) >= least:
            objects.append(FoundObject(*best, rows))
    return sorted(objects, key=lambda each: (-len(each.paths), int(each.paths[0])))


def _choices(fits: GroupFits, objects: list[FoundObject]) -> list[IntArray]:
    """Paths of each object when every path takes the one that explains it best, if any does.

    A contour has one path per stop and TX; of several the most likely counts.
    """
    if not objects:
        return []
    square, log_density = _squares(fits, objects)
    choice = np.where(square.min(axis=0) <= GATE, square.argmin(axis=0), GHOST)
    groups = []
    for k in range(len(objects)):
        rows = np.flatnonzero(choice == k)
        rows = rows[np.argsort(-log_density[k, rows], kind="stable")]
        link = fits.data.stop[rows] * (fits.data.clock.max(initial=0) + 1) + fits.data.clock[rows]
        _, first = np.unique(link, return_index=True)
        groups.append(np.sort(rows[first]))
    return groups


def _joined(fits: GroupFits, objects: list[FoundObject]) -> list[FoundObject]:
    """Objects after merging those that have more evidence as one than as two."""
    tried: set[bytes] = set()
    while True:
        pair = _next_pair(_squares(fits, objects)[0], objects, tried)
        if pair is None:
            return objects
        one, other = (objects[k] for k in pair)
        rows = np.sort(np.concatenate([one.paths, other.paths]))
        tried.add(rows.tobytes())
        best = fits.fit(rows)
        apart = one.optimum.log_evidence + other.optimum.log_evidence
        if best is not None and best[1].log_evidence > apart:
            objects = [each for k, each in enumerate(objects) if k not in pair]
            objects.append(FoundObject(*best, rows))


def _next_pair(square: FloatArray, objects: list[FoundObject], tried: set[bytes]) -> tuple[int, int] | None:
    """The first pair not yet tried of which one explains at least half of the paths of the other."""
    n = len(objects)
    shared = np.array([np.mean(square[:, each.paths] <= GATE, axis=1) for each in objects]).reshape(n, n).T
    for k, j in np.argwhere((shared >= _SHARED) & ~np.eye(n, dtype=bool)).tolist():
        rows = np.sort(np.concatenate([objects[k].paths, objects[j].paths]))
        if rows.tobytes() not in tried:
            return k, j
    return None


def _squares(fits: GroupFits, objects: list[FoundObject]) -> tuple[FloatArray, FloatArray]:
    """Squared distances and log densities (object, path) of all paths."""
    terms = [fits.squares(each.kind, each.optimum) for each in objects]
    square, log_density = np.array(terms).reshape(len(objects), 2, len(fits.data)).swapaxes(0, 1)
    return square, log_density
