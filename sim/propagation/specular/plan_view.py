"""Paths in plan view: reflections off vertical surfaces, without heights."""

from dataclasses import dataclass

import numpy as np

from scenes.record import FloatArray, IntArray, Record, array

SAME_POINT_M = 1e-6  # paths over the same objects are equal if their corners are closer than this


@dataclass(frozen=True)
class PlanPaths(Record):
    """Candidate paths of one TX over vertical surfaces, all with the same number of corners, to many receivers."""

    receiver: IntArray = array("path", dtype=int, doc="index of the receiver")
    surface: IntArray = array("path", "corner", dtype=int, doc="index of the object, TX to RX")
    point_m: FloatArray = array("path", "corner", "xy", unit="m", doc="points of reflection")
    normal: FloatArray = array("path", "corner", "xy", doc="unit normal of the lit side")
    curvature: FloatArray = array("path", "corner", unit="1/m", doc="> 0 where convex, seen from the lit side")

    def __len__(self) -> int:
        return self.size("path")


def straight_paths(n_receivers: int) -> PlanPaths:
    """The straight path to each receiver, without corners."""
    none = np.zeros((n_receivers, 0))
    plane = np.zeros((n_receivers, 0, 2))
    return PlanPaths(np.arange(n_receivers), none.astype(int), plane, plane, none)


def without_duplicates(paths: PlanPaths) -> PlanPaths:
    """The paths without repetitions, which occur where two curves or faces join."""
    first = paths.point_m[:, 0]
    order = np.lexsort(
        [0.755 * first[:, 0] + 0.570 * first[:, 1], *paths.surface.T, paths.receiver]
    )  # the last key is the position along a direction that is parallel to no usual wall
    before, after = order[:-1], order[1:]
    same = (paths.receiver[before] == paths.receiver[after]) & (paths.surface[before] == paths.surface[after]).all(
        axis=1
    )
    offset = np.abs(paths.point_m[after] - paths.point_m[before]).max(axis=(1, 2), initial=0)
    repeated = np.zeros(len(paths), bool)
    repeated[after[same & (offset < SAME_POINT_M)]] = True
    return paths.take("path", ~repeated)


def norm(vector: FloatArray) -> FloatArray:
    """Length (...) of vectors (..., xy), with the same bits for arrays of any shape."""
    return np.asarray(np.sqrt(vector[..., 0] * vector[..., 0] + vector[..., 1] * vector[..., 1]))


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Inner product (...) of vectors (..., xy)."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1])


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product a x b (...) of vectors (..., xy)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
