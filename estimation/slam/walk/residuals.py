"""A whole campaign: its paths, their association, and the unknowns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

from scenes.pose import Pose
from scenes.record import BoolArray, FloatArray, IntArray


class PathClass(IntEnum):
    """Kind of a path in the smoother."""

    UNUSED = 0
    LOS = 1
    BOUNCE = 2  # a single bounce with its own IP
    WALL = 3
    OBJECT = 4
    DOUBLE = 5  # off two walls


@dataclass(frozen=True)
class Observations:
    """Paths of all stops, in the units of `estimation.laws.plane`."""

    tx: Pose
    n_stops: int
    row: IntArray  # (path,) index of the stop
    measured: FloatArray  # (path, 3)
    covariance: FloatArray  # (path, 3, 3)
    floor: FloatArray  # (3, 3) part of every covariance that is a floor of the noise

    def with_floor(self, share: float) -> Observations:
        """The same paths with this share of the floor's standard deviations."""
        lower = share**2 * self.floor
        return replace(self, covariance=self.covariance - self.floor + lower, floor=lower)


@dataclass(frozen=True)
class Association:
    """Kind (path,) of every path, and `landmark` (path, 2): the walls of WALL and DOUBLE, the object of OBJECT."""

    kind: IntArray
    landmark: IntArray


@dataclass(frozen=True)
class TrajectoryState:
    """All unknowns. The offset of a stop is that of its `session`; the offset of `anchor` is zero."""

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


def without_heading_offsets(seen: Observations, now: TrajectoryState, path: IntArray | BoolArray) -> FloatArray:
    """Measurements of some paths, their departures turned by the TX heading offset of their session."""
    measured = seen.measured[path].copy()
    measured[:, 1] += now.offset_rad[now.session[seen.row[path]]]
    return measured
