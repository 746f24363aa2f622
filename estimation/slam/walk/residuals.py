"""A whole campaign: its paths, their association, and the unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property

import numpy as np

from estimation.laws.raised import PathHeights
from estimation.slam.snapshot.problem import SnapshotProblem
from estimation.slam.snapshot.refine import BounceResidual, bounce_terms
from estimation.slam.transmitters import AnyTx, transmitters_of
from scenes.record import BoolArray, FloatArray, IntArray


class PathClass(IntEnum):
    """Kind of a path in the smoother."""

    UNUSED = 0
    LOS = 1
    BOUNCE = 2  # a single bounce with its own IP
    WALL = 3
    OBJECT = 4
    DOUBLE = 5  # off two walls
    RAISED = 6  # by way of a shared point at a height of its own
    LONE = 7  # the same as BOUNCE, not used: its IP may be higher or lower than the devices


SINGLE_BOUNCES = (PathClass.BOUNCE, PathClass.LONE, PathClass.WALL, PathClass.OBJECT)  # with an IP of the plane


@dataclass(frozen=True)
class Observations:
    """Paths of all stops, in the units of `estimation.laws.plane`."""

    tx: AnyTx
    n_stops: int
    row: IntArray  # (path,) index of the stop
    measured: FloatArray  # (path, 3)
    covariance: FloatArray  # (path, 3, 3)
    floor: FloatArray  # (3, 3) part of every covariance that is a floor of the noise
    link: IntArray = field(default_factory=lambda: np.zeros(1, np.int64))  # (path,) index of the TX
    heights: PathHeights | None = None  # None where they are not known, or elevations are
    is_mirrored: bool = False  # the TX reports departures from behind it as their mirror images in front

    @property
    def n_tx(self) -> int:
        """Number of TX."""
        return len(transmitters_of(self.tx))

    @cached_property
    def tx_of_path(self) -> IntArray:
        """Index of the TX (path,)."""
        return np.broadcast_to(self.link, self.row.shape)

    @cached_property
    def tx_rows(self) -> FloatArray:
        """[x, y, heading] (path, 3) of the TX of every path."""
        return transmitters_of(self.tx).rows[self.tx_of_path]

    def states(self, state: FloatArray) -> FloatArray:
        """[x, y, heading, clock bias] (path, 4) of every path from the states (stop, state) of the stops."""
        return np.column_stack([state[self.row, :3], state[self.row, 3 + self.tx_of_path]])

    def with_floor(self, share: float) -> Observations:
        """The same paths with this share of the floor's standard deviations."""
        lower = share**2 * self.floor
        return replace(self, covariance=self.covariance - self.floor + lower, floor=lower)

    def of_stop(self, stop: int) -> Observations:
        """The paths of one stop alone."""
        own = self.take(self.row == stop)
        return replace(own, n_stops=1, row=np.zeros_like(own.row))

    def copies(self, stop: IntArray) -> tuple[Observations, IntArray]:
        """The paths of some stops (copy,), each copy as a stop of its own, and their indices (path,)."""
        counts = np.bincount(self.row, minlength=self.n_stops)
        order = np.argsort(self.row, kind="stable")
        before = np.cumsum(counts) - counts
        row = np.repeat(np.arange(len(stop)), counts[stop])
        place = np.arange(len(row)) - np.repeat(np.cumsum(counts[stop]) - counts[stop], counts[stop])
        index = order[before[stop[row]] + place]
        return replace(self.take(index), n_stops=len(stop), row=row), index

    def take(self, path: IntArray | BoolArray) -> Observations:
        """Some of the paths."""
        kept = self.measured[path], self.covariance[path], self.tx_of_path[path]
        heights = None if self.heights is None else PathHeights(*(each[path] for each in self.heights))
        return replace(
            self, row=self.row[path], measured=kept[0], covariance=kept[1], link=kept[2], heights=heights
        )


def observations(problems: Sequence[SnapshotProblem], tx_pose: AnyTx, floor: FloatArray) -> Observations:
    """All paths of all stops in one table; `floor` (3, 3) is part of their covariances."""
    measured = [problem.measured for problem in problems]
    covariance = [problem.covariance for problem in problems]
    every = np.concatenate([np.empty((0, 3)), *measured])
    return Observations(
        tx_pose,
        len(problems),
        np.repeat(np.arange(len(problems)), [len(m) for m in measured]),
        every,
        np.concatenate([np.empty((0, 3, 3)), *covariance]),
        floor,
        np.concatenate([np.zeros(0, np.int64), *(problem.link for problem in problems)]),
        is_mirrored=bool(np.all(np.cos(every[:, 1]) > 0)),
    )


@dataclass(frozen=True)
class Association:
    """Kind (path,) of every path, and its `landmark` (path, 2): walls of WALL and DOUBLE, else the only one."""

    kind: IntArray
    landmark: IntArray
    rough: FloatArray = field(default_factory=lambda: np.ones(1))  # (path,) of the roughness in the settings


_CERTAIN = (PathClass.LOS, PathClass.WALL, PathClass.OBJECT, PathClass.RAISED)
LEAST_SPARE = 2  # equations beyond the unknowns of a state that make it certain


def certain_paths(seen: Observations, link: Association) -> IntArray:
    """Number (stop,) of lines of sight and paths off shared landmarks: far more certain than other bounces."""
    return np.asarray(np.bincount(seen.row[np.isin(link.kind, _CERTAIN)], minlength=seen.n_stops), int)


def spare_equations(seen: Observations, link: Association) -> IntArray:
    """Equations (stop,) of the paths in use beyond the unknowns of a state.

    A bounce off any place gives one, other paths three. Where they are few, one wrong path moves the state and
    nothing contradicts it.
    """
    is_out = np.isin(link.kind, (PathClass.UNUSED, PathClass.LONE))
    equations = np.where(link.kind == PathClass.BOUNCE, 1, np.where(is_out, 0, 3))
    return np.asarray(np.bincount(seen.row, equations, seen.n_stops) - 3 - seen.n_tx, int)


@dataclass(frozen=True)
class TrajectoryState:
    """All unknowns. A state is x, y, heading and a clock bias per TX.

    The TX of a stop has the offset of its `session`. With one TX the offset of `anchor` is zero: that of all
    sessions is unobservable. With several every TX has its own offsets, and `anchor` has no meaning.
    """

    state: FloatArray  # (stop, 3 + tx) in m, m, rad, m
    offset_rad: FloatArray  # (session x tx,) the TX of the first session first
    walls: FloatArray  # (wall, 2)
    objects: FloatArray  # (object, 3)
    session: IntArray  # (stop,)
    anchor: int
    course: FloatArray  # (stop - 2, 2) unit vector of the walk at the inner stops
    raised: FloatArray = field(default_factory=lambda: np.empty((0, 3)))  # (point, 3) x, y, height over receiver
    flats: FloatArray = field(default_factory=lambda: np.empty(0))  # (surface,) heights of floor and ceiling, too

    @property
    def n_tx(self) -> int:
        """Number of TX."""
        return int(self.state.shape[1]) - 3

    def per_unknown(self, values: Sequence[float]) -> FloatArray:
        """Values of x, y, heading and any clock bias (4,), for every unknown (3 + tx,) of a state."""
        return np.append(values[:3], np.full(self.n_tx, values[3]))

    def offset_of(self, seen: Observations) -> IntArray:
        """Index (path,) of the offset of every path."""
        return np.asarray(self.session[seen.row] * self.n_tx + seen.tx_of_path)

    @property
    def n_shared(self) -> int:
        """Number of parameters that stops share."""
        return len(self.offset_rad) + self.walls.size + self.objects.size + self.raised.size

    def apart(self, state: FloatArray, stop: IntArray) -> TrajectoryState:
        """States (copy, 3 + tx) at some stops (copy,) as stops of their own, which no walk joins."""
        course = np.zeros((max(len(stop) - 2, 0), 2))
        return replace(self, state=state, session=self.session[stop], course=course)

    def moved(self, step: FloatArray, shared: FloatArray) -> TrajectoryState:
        """The unknowns after a step."""
        a, b, c = np.cumsum([len(self.offset_rad), self.walls.size, self.objects.size])
        return replace(
            self,
            state=self.state + step,
            offset_rad=self.offset_rad + shared[:a],
            walls=self.walls + shared[a:b].reshape(-1, 2),
            objects=self.objects + shared[b:c].reshape(-1, 3),
            raised=self.raised + shared[c:].reshape(-1, 3),
        )


def without_heading_offsets(seen: Observations, now: TrajectoryState, path: IntArray | BoolArray) -> FloatArray:
    """Measurements of some paths, their departures turned by the TX heading offset of their session."""
    measured = seen.measured[path].copy()
    measured[:, 1] += now.offset_rad[now.offset_of(seen)[path]]
    return measured


def own_bounces(seen: Observations, now: TrajectoryState, path: IntArray) -> BounceResidual:
    """Residuals of some paths as single bounces off places of their own."""
    measured = without_heading_offsets(seen, now, path)
    return bounce_terms(seen.tx_rows[path], measured, seen.covariance[path], seen.states(now.state)[path])
