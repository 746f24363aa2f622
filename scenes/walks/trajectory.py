"""The walk of the RX: stops along way-points and the pose at each."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from scenes.contours.pieces import SplinePiece
from scenes.pose import LARGEST_LENGTH_M, Pose
from scenes.record import BoolArray, FloatArray, IntArray, Record, array

N_DRAWN_PER_WAYPOINT = 16
LEAST_STOPS = 3  # of a walk
ORDERED = 0.75  # rms leg of a walk, over that of the same stops in a random order; three on a line have 0.71
LEAP = 5.0  # a leg of so many times the median leg is no step of a walk


@dataclass(frozen=True)
class Walk(Record):
    """Stops along way-points at one height.

    With `n_stops` the stops have equal spacing in arc length from the first way-point to the last. Without it the
    way-points are the stops. A smooth walk follows the cubic spline through its way-points, other walks follow
    straight lines. A NaN heading looks along the path.
    """

    waypoints_m: FloatArray = array("waypoint", "xy", unit="m", doc="corners of the walk, first to last")
    height_m: float = array(unit="m", doc="height of the RX array at every stop")
    heading_rad: float = array(unit="rad", doc="heading at every stop; NaN: along the path")
    n_stops: int | None = None
    is_smooth: bool = False
    speed_m_s: float = array(unit="m/s", default=0.0, doc="of a receiver that walks while it sweeps")
    stop_interval_s: float = array(unit="s", default=0.0, doc="from stop to stop, of one that stands")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.waypoints_m) == 0 or not np.all(np.isfinite(self.waypoints_m)):
            raise ValueError(f"waypoints_m = {self.waypoints_m.tolist()}: at least one finite point is needed")
        if not np.isfinite(self.height_m):
            raise ValueError(f"height_m = {self.height_m}: must be finite")
        if self.n_stops is not None and self.n_stops < 1:
            raise ValueError(f"n_stops = {self.n_stops}: must be >= 1")
        if self.n_stops is not None and self.n_stops > 1 and not self._straight_length_m > 0:
            raise ValueError(f"waypoints_m = {self.waypoints_m.tolist()}: {self.n_stops} stops need a path")
        if self.is_smooth and (len(self.waypoints_m) < 2 or np.any(self._is_repeated)):
            raise ValueError(
                f"waypoints_m = {self.waypoints_m.tolist()}: a smooth walk needs two or more, neighbours distinct"
            )

    @property
    def length_m(self) -> float:
        """Length in m of the path through all way-points."""
        return self._spline.length if self.is_smooth else self._straight_length_m

    def positions_m(self) -> FloatArray:
        """Positions (stop, xyz) in m."""
        if self.is_smooth:
            t = self._spline_stops()
            return np.column_stack([self._spline.point(t), np.full(len(t), self.height_m)])
        at, stretch = self._stops()
        start, step = self.waypoints_m[stretch], self._step(stretch)
        share = np.clip(at - stretch, 0, 1)[:, None]
        return np.column_stack([start + share * step, np.full(len(at), self.height_m)])

    def headings_rad(self) -> FloatArray:
        """Headings (stop,) in rad, from world +x counter-clockwise."""
        if self.is_smooth:
            step = self._spline.derivative(self._spline_stops())
        else:
            _, stretch = self._stops()
            step = self._step(stretch)
        if not np.isnan(self.heading_rad):
            return np.full(len(step), self.heading_rad)
        return np.asarray(np.arctan2(step[:, 1], step[:, 0]))

    def poses(self) -> tuple[Pose, ...]:
        """Pose at each stop."""
        stops = zip(self.positions_m(), self.headings_rad(), strict=True)
        return tuple(Pose(position, heading) for position, heading in stops)

    def line_m(self) -> FloatArray:
        """Points (point, xy) in m of the line between the stops, for drawing."""
        if not self.is_smooth:
            return self.waypoints_m
        return self._spline.point(self._spline.equidistant(N_DRAWN_PER_WAYPOINT * len(self.waypoints_m)))

    @cached_property
    def _spline(self) -> SplinePiece:
        return SplinePiece(self.waypoints_m)

    def _spline_stops(self) -> FloatArray:
        """Parameter (stop,) of each stop on the spline."""
        return self._spline.breaks if self.n_stops is None else self._spline.equidistant(self.n_stops - 1)

    @property
    def _straight_length_m(self) -> float:
        return float(np.linalg.norm(np.diff(self.waypoints_m, axis=0), axis=1).sum())

    @property
    def _is_repeated(self) -> BoolArray:
        return np.asarray(np.linalg.norm(np.diff(self.waypoints_m, axis=0), axis=1) < 1e-9)

    def _step(self, stretch: IntArray) -> FloatArray:
        if len(self.waypoints_m) == 1:
            return np.zeros((len(stretch), 2))
        return np.asarray(np.diff(self.waypoints_m, axis=0)[stretch])

    def _stops(self) -> tuple[FloatArray, IntArray]:
        """Each stop as a fractional way-point index, and the index of the way-point before it."""
        n_last = max(len(self.waypoints_m) - 2, 0)
        if self.n_stops is None:
            at = np.arange(len(self.waypoints_m), dtype=float)
        else:
            length = np.linalg.norm(np.diff(self.waypoints_m, axis=0), axis=1)
            reached = np.concatenate([[0.0], np.cumsum(length)])
            at = np.interp(np.linspace(0, reached[-1], self.n_stops), reached, np.arange(len(reached)))
        return at, np.minimum(at.astype(int), n_last)


def follow_one_another(position_m: FloatArray) -> bool:
    """Whether stops at `position_m` (stop, xyz), in this order, are a walk: three or more, near each other.

    Their legs are shorter than those of a random order, by von Neumann's ratio of the mean square successive
    difference to the variance (Annals of Mathematical Statistics, 1941), and none is a leap.
    """
    if len(position_m) < LEAST_STOPS:
        return False
    leg_m = np.linalg.norm(np.diff(position_m, axis=0), axis=1)
    random_leg_m = np.sqrt(2 * position_m.var(axis=0, ddof=1).sum())
    is_short = np.sqrt(np.mean(leg_m**2)) <= ORDERED * random_leg_m
    return bool(is_short and leg_m.max() <= LEAP * np.median(leg_m))


@dataclass(frozen=True)
class RecordedWalk(Record):
    """Stops with one given pose each, for example recorded ones."""

    position_m: FloatArray = array("stop", "xyz", unit="m", doc="position of the RX array at every stop")
    heading_rad: FloatArray = array("stop", unit="rad", doc="heading at every stop")
    speed_m_s: float = array(unit="m/s", default=0.0, doc="of a receiver that walks while it sweeps")
    stop_interval_s: float = array(unit="s", default=0.0, doc="from stop to stop, of one that stands")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not len(self.position_m) or not (np.abs(self.position_m) <= LARGEST_LENGTH_M).all():
            raise ValueError(f"position_m: at least one stop and numbers within +-{LARGEST_LENGTH_M:g} are needed")
        if not np.isfinite(self.heading_rad).all():
            raise ValueError("heading_rad: finite numbers are needed")

    @property
    def height_m(self) -> float:
        """Mean height in m of the stops."""
        return float(self.position_m[:, 2].mean())

    @property
    def length_m(self) -> float:
        """Length in m of the line through all stops."""
        return float(np.linalg.norm(np.diff(self.position_m, axis=0), axis=1).sum())

    def positions_m(self) -> FloatArray:
        """Positions (stop, xyz) in m."""
        return self.position_m

    def headings_rad(self) -> FloatArray:
        """Headings (stop,) in rad, from world +x counter-clockwise."""
        return self.heading_rad

    def poses(self) -> tuple[Pose, ...]:
        """Pose at each stop."""
        stops = zip(self.position_m, self.heading_rad, strict=True)
        return tuple(Pose(position, float(heading)) for position, heading in stops)

    def line_m(self) -> FloatArray:
        """Points (point, xy) in m of the line between the stops, for drawing."""
        return self.position_m[:, :2]


AnyWalk = Walk | RecordedWalk


def velocities_m_s(walk: AnyWalk) -> FloatArray:
    """Velocity (stop, xyz) in m/s of the receiver during the sweep of each stop: straight towards the next stop.

    That of the last stop is the one before. Zero where it stands while it sweeps.
    """
    position_m = walk.positions_m()
    if not walk.speed_m_s or len(position_m) < 2:
        return np.zeros_like(position_m)
    leg_m = np.diff(position_m, axis=0)
    leg_m = np.vstack([leg_m, leg_m[-1:]])
    return np.asarray(walk.speed_m_s * leg_m / np.linalg.norm(leg_m, axis=1, keepdims=True))


def stop_times_s(walk: AnyWalk, sweep_s: float) -> FloatArray:
    """Middle (stop,) in s of the sweep at every stop; the sweep of the first stop starts the campaign.

    A receiver that walks while it sweeps is at its stops in the middle of the sweeps. One that stands takes
    `stop_interval_s` from stop to stop, or no longer than a sweep of `sweep_s`.

    Raises `ValueError` where it is at a stop before the sweep of the one before has ended, or does not move.
    """
    position_m = walk.positions_m()
    interval_s = np.full(len(position_m) - 1, max(sweep_s, walk.stop_interval_s))
    if walk.speed_m_s:
        interval_s = np.linalg.norm(np.diff(position_m, axis=0), axis=1) / walk.speed_m_s
        if len(position_m) < 2:
            raise ValueError(f"walk.speed_m_s = {walk.speed_m_s:g}: a walk has two or more stops")
    if len(interval_s) and interval_s.min() < sweep_s:
        stop = int(interval_s.argmin())
        raise ValueError(
            f"walk.speed_m_s = {walk.speed_m_s:g}: stop {stop} is {interval_s[stop]:.3g} s before the next, "
            f"but a sweep takes {sweep_s:.3g} s; take fewer stops, fewer beams or a lower speed"
        )
    return np.asarray(sweep_s / 2 + np.concatenate([[0.0], np.cumsum(interval_s)]))
