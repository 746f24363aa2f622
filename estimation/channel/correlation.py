"""Errors that paths of a stop have in common: of paths that are not resolved, and of arrays that point wrong."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from scenes.record import FloatArray, IntArray, Record, array

LEAST_CORRELATION = 0.05  # of any two parameters of two paths that counts


@dataclass(frozen=True)
class CorrelatedPaths(Record):
    """Pairs of paths whose errors are correlated; those of all other pairs count as independent.

    The parameters are those of the covariance of each path, in the same order and units.
    """

    first: IntArray = array("pair", dtype=int, doc="index of a path")
    second: IntArray = array("pair", dtype=int, doc="index of the other path, larger")
    cross_covariance: FloatArray = array(
        "pair",
        "parameter",
        "parameter2",
        unit="(s, rad, ...)^2",
        doc="of a parameter of the first path and one of the second; NaN unknown",
    )

    def of_paths(self, n_paths: int, index: slice | FloatArray | IntArray) -> Self:
        """The pairs among some of `n_paths` paths, a mask or indices (path,), with their new numbers."""
        chosen = np.arange(n_paths)[index]
        place = np.full(n_paths, -1)
        place[chosen] = np.arange(len(chosen))
        first, second = place[self.first], place[self.second]
        kept = (first >= 0) & (second >= 0)
        first, second, cross = first[kept], second[kept], self.cross_covariance[kept]
        turned = first > second
        cross = np.where(turned[:, None, None], cross.swapaxes(1, 2), cross)
        return type(self)(np.minimum(first, second), np.maximum(first, second), cross)

    def dense(self, n_paths: int) -> FloatArray:
        """Cross covariances (path, path, parameter, parameter), 0 on the diagonal and where none are known."""
        size = self.size("parameter")
        result = np.zeros((n_paths, n_paths, size, size))
        cross = np.nan_to_num(self.cross_covariance)
        result[self.first, self.second] = cross
        result[self.second, self.first] = cross.swapaxes(1, 2)
        return result


@dataclass(frozen=True)
class PointingErrors(Record):
    """The part of the covariances of paths by arrays that point a little wrong: common to all paths."""

    covariance: FloatArray = array(
        "path", "parameter", "parameter2", unit="(s, rad, ...)^2", doc="in the order of that of each path"
    )


def correlated_paths(joint: FloatArray) -> CorrelatedPaths:
    """The pairs of a joint covariance (path, parameter, path, parameter) whose errors are correlated."""
    n, size = joint.shape[:2]
    first, second = np.triu_indices(n, 1)
    std = np.sqrt(np.einsum("papa->pa", joint))
    scale = np.maximum(std, np.finfo(float).tiny)
    cross = joint[first, :, second]
    correlation = np.abs(cross) / (scale[first][:, :, None] * scale[second][:, None])
    kept = correlation.reshape(len(first), size * size).max(axis=1, initial=0.0) > LEAST_CORRELATION
    return CorrelatedPaths(first[kept], second[kept], cross[kept])
