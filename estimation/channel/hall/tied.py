"""Versions tied: what each path is when the other versions of its plan path are known too.

Paths that look alike from above fall into clusters. In a cluster every path is loose, or with others a version of
one plan path. The groupings that explain most are searched path by path, the best known first, and each path gets
mean and covariance of the mixture over all of them: which paths belong together is not certain.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from estimation.channel.hall.geometry import Version
from estimation.channel.hall.groups import Group, Groups, mixture
from scenes.record import FloatArray, IntArray

LEAST_AGREEMENT = 0.03  # over that by chance, of two paths in one group
MOST_GROUPINGS = 48  # of a cluster, that are kept

Grouping = tuple[Group, ...]  # groups of two and more paths; all others are loose


@dataclass(frozen=True)
class TiedPaths:
    """The paths of a stop with versions of one plan path tied.

    Attributes
    ----------
    shift : (path, 5) change of range in m, both azimuths and both elevations
    covariance : (path, 5, 5) of what comes out
    probability : (path,) that a path is in a group
    """

    shift: FloatArray
    covariance: FloatArray
    probability: FloatArray


def tied_paths(groups: Groups) -> TiedPaths:
    """All paths of a stop: means and covariances over the likely groupings."""
    n = len(groups.paths)
    tied = TiedPaths(np.zeros((n, 5)), groups.paths.covariance.copy(), np.zeros(n))
    agrees = groups.agrees.max(axis=(1, 3)) > LEAST_AGREEMENT if n else np.zeros((0, 0), bool)
    _, label = connected_components(coo_matrix(agrees), directed=False)
    for cluster in np.flatnonzero(np.bincount(label) > 1):
        members = np.flatnonzero(label == cluster)
        weight, groupings = groupings_of(groups, members)
        for path in members:
            _average(tied, groups, int(path), weight, groupings)
    return tied


def groupings_of(groups: Groups, members: IntArray) -> tuple[FloatArray, list[Grouping]]:
    """Probabilities (grouping,) of the likeliest groupings of a cluster of paths, and the groupings."""
    kept: dict[Grouping, float] = {(): 0.0}
    for path in members[np.argsort(groups.paths.variance[members, 0], kind="stable")]:
        grown = {
            one: sum(_log_weight(groups, group) for group in one)
            for grouping in kept
            for one in _with_path(groups, grouping, int(path))
        }
        kept = dict(sorted(grown.items(), key=lambda one: -one[1])[:MOST_GROUPINGS])
    log_weight = np.array(list(kept.values()))
    weight = np.exp(log_weight - log_weight.max())
    real = [tuple(group for group in grouping if len(group) > 1) for grouping in kept]
    return weight / weight.sum(), real


def _with_path(groups: Groups, grouping: Grouping, path: int) -> Iterator[Grouping]:
    """The groupings that a path leads to: loose, or with a group or a loose path as any version that agrees.

    A loose path is a group of one without a version, -1.
    """
    yield tuple(sorted((*grouping, ((path, -1),))))
    for index, group in enumerate(grouping):
        rest = grouping[:index] + grouping[index + 1 :]
        is_loose = group[0][1] < 0
        starts = [((group[0][0], version),) for version in range(len(Version))] if is_loose else [group]
        for start in starts:
            taken = [version for _, version in start]
            agreement = np.min([groups.agrees[other, version, path] for other, version in start], axis=0)
            for version in np.flatnonzero(agreement > LEAST_AGREEMENT):
                if version not in taken:
                    yield tuple(sorted((*rest, tuple(sorted((*start, (path, int(version))))))))


def _log_weight(groups: Groups, group: Group) -> float:
    path, version = group[0]
    return float(groups.loose[path]) if version < 0 else groups.solve(group).log_weight


def _average(tied: TiedPaths, groups: Groups, path: int, weight: FloatArray, groupings: list[Grouping]) -> None:
    """Enter mean and covariance of a path over groupings."""
    shift = np.zeros((len(groupings), 5))
    covariance = np.broadcast_to(groups.paths.covariance[path], (len(groupings), 5, 5)).copy()
    is_tied = np.zeros(len(groupings), bool)
    for row, grouping in enumerate(groupings):
        for group in grouping:
            place = [other for other, _ in group].index(path) if (path in dict(group)) else -1
            if place >= 0:
                solved, is_tied[row] = groups.solve(group), True
                shift[row], covariance[row] = solved.shift[place], solved.covariance[place]
    tied.shift[path], tied.covariance[path] = mixture(weight, shift, covariance)
    tied.probability[path] = weight @ is_tied
