"""Rigid motions: shift and turn of a body over time, with their first two derivatives.

Bodies are prisms and meshes that stay upright: they shift, and turn about the vertical through their pivot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.record import FloatArray, Record, array

N_POWERS = 4  # of a cubic
CLOSED_M, CLOSED_RAD = 0.01, 0.01  # a loop ends this near to its start


@dataclass(frozen=True)
class RigidState(Record):
    """A body at one instant: where it has moved to since the start, and how it moves on."""

    shift_m: FloatArray = array("xyz", unit="m", doc="displacement of the pivot")
    turn_rad: float = array(unit="rad", doc="turn about the vertical through the pivot, counter-clockwise")
    velocity_m_s: FloatArray = array("xyz", unit="m/s", doc="of the pivot")
    turn_rate_rad_s: float = array(unit="rad/s", doc="angular rate")
    acceleration_m_s2: FloatArray = array("xyz", unit="m/s^2", doc="of the pivot")
    turn_acceleration_rad_s2: float = array(unit="rad/s^2", doc="angular acceleration")


AT_REST = RigidState(np.zeros(3), 0.0, np.zeros(3), 0.0, np.zeros(3), 0.0)


@dataclass(frozen=True)
class Motion(Record):
    """Shift and turn as cubic polynomials of time between knots; at rest before the first and after the last.

    A motion that loops starts again at its last knot.

    Raises `ValueError` unless the knots increase.
    """

    knot_s: FloatArray = array("knot", unit="s", doc="times between the stretches, one more than stretches")
    coefficient: FloatArray = array(
        "stretch", "power", "coordinate", doc="of t^3, t^2, t, 1 since the knot before: x, y, z in m, turn in rad"
    )
    loops: bool = array(dtype=bool, default=False, doc="whether it starts again at the last knot")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.knot_s) != len(self.coefficient) + 1 or not (np.diff(self.knot_s) > 0).all():
            raise ValueError("knot_s: increasing times are needed, one more than stretches")

    def at(self, time_s: float) -> RigidState:
        """The state at a time."""
        place, rate, bend = (value[0] for value in self.over(np.array([time_s])))
        return RigidState(place[:3], place[3], rate[:3], rate[3], bend[:3], bend[3])

    def over(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Shift and turn, their rates and their second derivatives, each (time, 4), at times (time,)."""
        first, last = self.knot_s[0], self.knot_s[-1]
        if self.loops:
            time_s = np.where(time_s > first, first + (time_s - first) % (last - first), time_s)
        moves = ((first <= time_s) & (time_s < last))[:, None]
        inside = np.clip(time_s, first, last)
        stretch = np.clip(np.searchsorted(self.knot_s, inside, "right") - 1, 0, len(self.coefficient) - 1)
        a, b, c, d = np.moveaxis(self.coefficient[stretch], 1, 0)
        t = (inside - self.knot_s[stretch])[:, None]
        return ((a * t + b) * t + c) * t + d, ((3 * a * t + 2 * b) * t + c) * moves, (6 * a * t + 2 * b) * moves

    @property
    def top_speed_m_s(self) -> float:
        """Highest speed of the pivot in m/s, from below at 16 times a stretch."""
        return float(np.linalg.norm(self._rates()[..., :3], axis=-1).max())

    @property
    def top_turn_rate_rad_s(self) -> float:
        """Highest angular rate in rad/s, from below as above."""
        return float(np.abs(self._rates()[..., 3]).max())

    def _rates(self) -> FloatArray:
        """Rates (stretch, time, coordinate) at times of all stretches; a stretch without end has one rate."""
        length = np.diff(self.knot_s)
        span = np.where(np.isfinite(length), length, 0.0)[:, None, None] * np.linspace(0, 1, 16)[:, None]
        a, b, c, _ = (self.coefficient[:, None, power] for power in range(N_POWERS))
        return np.asarray((3 * a * span + 2 * b) * span + c)


def steady_motion(
    velocity_m_s: FloatArray, turn_rate_rad_s: float = 0.0, start_s: float = 0.0, end_s: float = np.inf
) -> Motion:
    """Constant velocity (xyz,) and angular rate from a start to an end."""
    rate = np.append(np.asarray(velocity_m_s, float), turn_rate_rad_s)
    return Motion(np.array([start_s, end_s]), np.stack([0 * rate, 0 * rate, rate, 0 * rate])[None])


def waypoint_motion(
    leg_m: FloatArray, speed_m_s: float, turn_rate_rad_s: float = 0.0, start_s: float = 0.0, *, loops: bool = False
) -> Motion:
    """Straight legs (leg, xyz) at one speed; a loop goes straight back from the last point to the first.

    Raises `ValueError` for legs without length, or a loop that is back before it has made whole turns.
    """
    legs = np.vstack([leg_m, -leg_m.sum(axis=0)]) if loops else leg_m
    length = np.linalg.norm(legs, axis=1)
    if loops and length[-1] < CLOSED_M:
        legs, length = legs[:-1], length[:-1]
    if not len(legs) or length.min() < CLOSED_M:
        raise ValueError(f"waypoints_m: neighbours must be {CLOSED_M} m or more apart, the object is at the first")
    knot = start_s + np.concatenate([[0.0], np.cumsum(length)]) / speed_m_s
    if loops and abs((turn_rate_rad_s * (knot[-1] - knot[0]) + np.pi) % (2 * np.pi) - np.pi) > CLOSED_RAD:
        raise ValueError("angular_rate_deg_s: an object that loops turns whole turns on a round, or not at all")
    coefficient = np.zeros((len(legs), N_POWERS, 4))
    coefficient[:, 2, :3] = legs / length[:, None] * speed_m_s
    coefficient[:, 2, 3] = turn_rate_rad_s
    coefficient[:, 3, :3] = np.cumsum(legs, axis=0) - legs
    coefficient[:, 3, 3] = turn_rate_rad_s * (knot[:-1] - knot[0])
    return Motion(knot, coefficient, loops)


def recorded_motion(
    time_s: FloatArray,
    position_m: FloatArray,
    heading_rad: FloatArray,
    start_s: float = 0.0,
    *,
    loops: bool = False,
) -> Motion:
    """The smooth motion (cubic splines) through recorded poses, relative to the first.

    Axes: times (pose,), positions (pose, xyz), headings (pose,). Raises `ValueError` for fewer than two poses,
    times that do not increase, and a loop that does not end where it starts.
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415  (slow to import)

    if len(time_s) < 2 or not (np.diff(time_s) > 0).all():
        raise ValueError("two or more poses with increasing times are needed")
    places = np.column_stack([position_m - position_m[0], np.unwrap(heading_rad) - heading_rad[0]])
    if loops:
        turn = (places[-1, 3] + np.pi) % (2 * np.pi) - np.pi
        if np.linalg.norm(places[-1, :3]) > CLOSED_M or abs(turn) > CLOSED_RAD:
            raise ValueError("loop: the last pose must be the first one, within 1 cm and 0.01 rad")
        places[-1, :3] = 0.0
    spline = CubicSpline(time_s - time_s[0], places, bc_type="natural")
    return Motion(start_s + time_s - time_s[0], np.moveaxis(spline.c, 0, 1), loops)


@dataclass(frozen=True)
class BodyMotion(Record):
    """Rigid motion of several bodies at one instant, about the vertical through their pivots."""

    pivot_m: FloatArray = array("body", "xyz", unit="m", doc="pivot at this instant")
    velocity_m_s: FloatArray = array("body", "xyz", unit="m/s", doc="of the pivot")
    acceleration_m_s2: FloatArray = array("body", "xyz", unit="m/s^2", doc="of the pivot")
    turn_rate_rad_s: FloatArray = array("body", unit="rad/s", doc="angular rate")
    turn_acceleration_rad_s2: FloatArray = array("body", unit="rad/s^2", doc="angular acceleration")

    def velocity_at(self, body: FloatArray, point_m: FloatArray) -> FloatArray:
        """Velocities (..., xyz) in m/s of the points (..., xyz) of bodies (...)."""
        arm = point_m - self.pivot_m[body]
        return np.asarray(self.velocity_m_s[body] + self.turn_rate_rad_s[body][..., None] * quarter_turn(arm))

    def acceleration_at(self, body: FloatArray, point_m: FloatArray) -> FloatArray:
        """Accelerations (..., xyz) in m/s^2 of the points (..., xyz) of bodies (...)."""
        arm = point_m - self.pivot_m[body]
        spin, rise = self.turn_rate_rad_s[body][..., None], self.turn_acceleration_rad_s2[body][..., None]
        return np.asarray(
            self.acceleration_m_s2[body] + rise * quarter_turn(arm) + spin**2 * quarter_turn(quarter_turn(arm))
        )


def quarter_turn(vector: FloatArray) -> FloatArray:
    """Z x v of vectors (..., xyz)."""
    return np.stack([-vector[..., 1], vector[..., 0], np.zeros(vector.shape[:-1])], axis=-1)
