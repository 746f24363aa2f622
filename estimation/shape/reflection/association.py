"""Which paths of a cluster belong to which object: merged clusters are split, ghosts stay unassigned.

Neighbouring incidence points may belong to several objects: a pillar touches a rail, a jamb stands before a
wall. The reflection law separates them, because each object predicts delay and both angles of its own paths
only. Objects are found one after another, each among the paths that no earlier object explains. Then assignment
and fits alternate.
"""

from dataclasses import dataclass, field

import numpy as np

from estimation.shape.config import ReflectionConfig
from estimation.shape.kinds.fit import OBJECT_KINDS
from estimation.shape.reflection.posterior import Optimum, path_agreement
from estimation.shape.reflection.reflections import Reflections
from scenes.record import FloatArray, IntArray

GHOST = -1
SIMPLE_KINDS = ("circle", "wall", "edge")  # the simplest of each class
MIN_PATHS = 4  # fewer do not make an object
MIN_GAIN_NAT = 5.0  # of the evidence over that of ghosts alone
GATE = 16.27  # chi-square of 3 degrees of freedom at 0.999
ONE_GATE = 10.83  # the same of 1
_MAX_OBJECTS = 5
_MAX_ROUNDS = 5


@dataclass(frozen=True)
class ClusterSplit:
    """Objects among the paths of a cluster: `label` (path,) is their number from 0, -1 marks ghosts."""

    label: IntArray
    kind: tuple[str, ...]  # per object: one of `SIMPLE_KINDS`


def split_cluster(data: Reflections, config: ReflectionConfig) -> ClusterSplit:
    """Split the paths of one cluster into objects and ghosts.

    An object needs `MIN_PATHS` paths and more evidence than the same paths as ghosts.
    """
    return split_rows(GroupFits(data, config), np.arange(len(data)))


@dataclass(frozen=True)
class GroupFits:
    """Fits of groups of paths; each group is fitted once."""

    data: Reflections
    config: ReflectionConfig
    known: dict[bytes, tuple[str, Optimum] | None] = field(default_factory=dict)
    square: dict[int, tuple[Optimum, FloatArray, FloatArray]] = field(default_factory=dict)

    def fit(self, rows: IntArray) -> tuple[str, Optimum] | None:
        """The most evident simple contour of some paths, None where ghosts explain them as well."""
        key = rows.tobytes()
        if key not in self.known:
            self.known[key] = most_evident(self.data.take("path", rows), self.config)
        return self.known[key]

    def squares(self, kind: str, optimum: Optimum) -> tuple[FloatArray, FloatArray]:
        """`object_agreement` of all paths; kept, because objects stay the same for many rounds."""
        key = id(optimum)
        if key not in self.square:
            self.square[key] = optimum, *object_agreement(kind, optimum, self.data)
        return self.square[key][1:]


def split_rows(fits: GroupFits, rows: IntArray) -> ClusterSplit:
    """`split_cluster` of some of the paths (path,)."""
    data = fits.data.take("path", rows)
    label = np.full(len(rows), GHOST)
    found: list[tuple[str, Optimum]] = []
    while len(found) < _MAX_OBJECTS:
        rest = np.flatnonzero(label == GHOST)
        best = fits.fit(rows[rest])
        if best is None:
            break
        members = rest[best[1].inlier > 0.5]
        if len(members) < MIN_PATHS:
            break
        label[members] = len(found)
        found.append(best)
    for _ in range(_MAX_ROUNDS):
        before, label = label, _nearest(data, found)
        label, found = _fitted(fits, rows, label, len(found))
        if np.array_equal(label, before):
            break
    return ClusterSplit(label, tuple(kind for kind, _ in found))


def object_agreement(kind: str, optimum: Optimum, data: Reflections) -> tuple[FloatArray, FloatArray]:
    """`path_agreement` of paths with an object of a kind."""
    return path_agreement(OBJECT_KINDS[kind].family, optimum, data)


def most_evident(data: Reflections, config: ReflectionConfig) -> tuple[str, Optimum] | None:
    """Simple kind and optimum of highest evidence, None where ghosts alone explain the paths about as well."""
    if len(data) < MIN_PATHS:
        return None
    optima = {kind: OBJECT_KINDS[kind].optimum(data, config) for kind in SIMPLE_KINDS}
    usable = [(kind, optimum) for kind, optimum in optima.items() if optimum is not None]
    kind, best = max(usable, key=lambda pair: pair[1].log_evidence, default=("", None))
    ghosts = len(data) * config.log_ghost_density
    if best is None or not best.log_evidence > ghosts + MIN_GAIN_NAT:
        return None
    return kind, best


def _nearest(data: Reflections, found: list[tuple[str, Optimum]]) -> IntArray:
    """The object (path,) that predicts each path best, -1 where all are beyond the gate."""
    if not found:
        return np.full(len(data), GHOST)
    square: FloatArray = np.array([object_agreement(kind, optimum, data)[0] for kind, optimum in found])
    return np.where(square.min(axis=0) <= GATE, square.argmin(axis=0), GHOST)


def _fitted(
    fits: GroupFits, rows: IntArray, label: IntArray, n_objects: int
) -> tuple[IntArray, list[tuple[str, Optimum]]]:
    """New labels and fits of the objects; those with too few paths or too little evidence are dissolved."""
    renewed = np.full(len(label), GHOST)
    found: list[tuple[str, Optimum]] = []
    for number in range(n_objects):
        members = label == number
        best = fits.fit(rows[members])
        if best is not None:
            renewed[members] = len(found)
            found.append(best)
    return renewed, found
