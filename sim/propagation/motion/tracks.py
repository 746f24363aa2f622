"""The paths of a sweep over its time: traced at some symbols, and smooth stretches between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray, Record, array
from sim.propagation.paths import Paths

ANGLES = ("aod_azimuth", "aod_elevation", "aoa_azimuth", "aoa_elevation")


@dataclass(frozen=True)
class SweepMotion(Record):
    """How the paths of one stop change while it is swept. Times are relative to its middle symbol.

    A stretch is a path from one symbol to another, over three of its states: the first, one between, and the last.
    A path that appears or vanishes has stretches from its first symbol or to its last. Length and directions
    follow the values and rates of the states, the gain without the phase of the length follows its values.
    """

    states: Paths
    state_s: FloatArray = array("state", unit="s", doc="time of each of the paths in `states`")
    first: IntArray = array("stretch", dtype=int, doc="state at its start")
    middle: IntArray = array("stretch", dtype=int, doc="state between")
    last: IntArray = array("stretch", dtype=int, doc="state at its end; all three are one for a single symbol")
    from_s: FloatArray = array("stretch", unit="s", doc="first symbol of the stretch")
    to_s: FloatArray = array("stretch", unit="s", doc="symbol after its last one")
    time_s: float = array(unit="s", doc="time of the campaign of the middle symbol")
    rx_velocity_m_s: FloatArray = array("xyz", unit="m/s", doc="velocity of the receiver during the sweep")
    n_traces: int = array(
        dtype=int, doc="times at which the paths were traced, 3 where the second order is enough"
    )
    second_order_phase_rad: float = array(
        unit="rad", doc="largest phase error of the second order from the ends to the middle, times relative gain"
    )

    def __len__(self) -> int:
        return self.size("stretch")

    def stretches(self, index: IntArray) -> SweepMotion:
        """The same states with some of the stretches."""
        return self.take("stretch", index)

    def is_still(self) -> BoolArray:
        """Mask (stretch,) of whole paths that do not change in the sweep."""
        rates = self.states.rates
        assert rates is not None
        rests = ~(rates.length_rate_m_s.astype(bool) | rates.length_acceleration_m_s2.astype(bool))
        for name in ANGLES:
            rests &= getattr(rates, f"{name}_rate_rad_s") == 0
        still = rests[self.first] & rests[self.middle] & rests[self.last] & np.isinf(self.to_s)
        gain = self.states.gain
        same = (gain[self.first] == gain[self.middle]) & (gain[self.middle] == gain[self.last])
        return np.asarray(still & same & (self.from_s == self.state_s.min(initial=0.0)))


def lengths_at(motion: SweepMotion, time_s: FloatArray, carrier_hz: float) -> tuple[FloatArray, ComplexArray]:
    """Length in m, and gain without the phase of the length, of all stretches (time, stretch) at times (time,)."""
    paths, rates = motion.states, motion.states.rates
    assert rates is not None
    low, high, gone, span = _between(motion, time_s)
    length = _quintic(gone, span, paths.length_m, rates.length_rate_m_s, rates.length_acceleration_m_s2, low, high)
    spread = paths.gain * paths.length_m * np.exp(2j * np.pi * carrier_hz * paths.delay_s)
    return length, _quadratic(motion, time_s, spread) / length


def angle_at(motion: SweepMotion, time_s: FloatArray, name: str) -> FloatArray:
    """One of `ANGLES` in rad of all stretches (time, stretch) at times (time,)."""
    low, high, gone, span = _between(motion, time_s)
    rate = getattr(motion.states.rates, f"{name}_rate_rad_s")
    return _cubic(gone, span, getattr(motion.states, f"{name}_rad"), rate, low, high)


def _between(motion: SweepMotion, time_s: FloatArray) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """States before and after times (time, stretch), and the time since the first of them and between them."""
    late = time_s[:, None] > motion.state_s[motion.middle]
    low, high = np.where(late, motion.middle, motion.first), np.where(late, motion.last, motion.middle)
    start = motion.state_s[low]
    return low, high, time_s[:, None] - start, motion.state_s[high] - start


def carrier_phase(length_m: FloatArray, carrier_hz: float) -> ComplexArray:
    """exp(-j k L) of lengths (...)."""
    cycles = length_m * (carrier_hz / SPEED_OF_LIGHT_M_S)
    angle = -2 * np.pi * (cycles - np.round(cycles))
    wave = np.empty(length_m.shape, complex)
    np.cos(angle, out=wave.real)
    np.sin(angle, out=wave.imag)
    return wave


def _quintic(
    gone: FloatArray,
    span: FloatArray,
    value: FloatArray,
    rate: FloatArray,
    bend: FloatArray,
    low: IntArray,
    high: IntArray,
) -> FloatArray:
    """Quintic with values, first and second derivatives of two states; Taylor's polynomial where both are one."""
    one = span == 0
    h = np.where(one, 1.0, span)
    x = gone / h
    taylor = value[low] + gone * (rate[low] + gone * bend[low] / 2)
    rest = value[high] - value[low] - h * rate[low] - h * h * bend[low] / 2
    slope = (rate[high] - rate[low] - h * bend[low]) * h
    curve = (bend[high] - bend[low]) * h * h
    c3, c4, c5 = (
        10 * rest - 4 * slope + curve / 2,
        -15 * rest + 7 * slope - curve,
        6 * rest - 3 * slope + curve / 2,
    )
    return np.where(one, taylor, taylor + x**3 * (c3 + x * (c4 + x * c5)))


def _cubic(
    gone: FloatArray, span: FloatArray, angle: FloatArray, rate: FloatArray, low: IntArray, high: IntArray
) -> FloatArray:
    """Cubic with angles and rates of two states; a line where both are one."""
    one = span == 0
    h = np.where(one, 1.0, span)
    x = gone / h
    line = angle[low] + gone * rate[low]
    rest = wrap_angle(angle[high] - angle[low]) - h * rate[low]
    slope = (rate[high] - rate[low]) * h
    return np.where(one, line, line + x**2 * (3 * rest - slope + x * (slope - 2 * rest)))


def _quadratic(motion: SweepMotion, time_s: FloatArray, value: ComplexArray) -> ComplexArray:
    """Parabola (time, stretch) through the values of three states, or the value of one."""
    a, b, c = (motion.state_s[state] for state in (motion.first, motion.middle, motion.last))
    one = (a == b) | (b == c)
    t = time_s[:, None]
    below, above, both = (np.where(one, 1.0, gap) for gap in (b - a, c - b, c - a))
    weight = [
        (t - b) * (t - c) / (below * both),
        -(t - a) * (t - c) / (below * above),
        (t - a) * (t - b) / (both * above),
    ]
    curve = sum(
        each * value[state] for each, state in zip(weight, (motion.first, motion.middle, motion.last), strict=True)
    )
    return np.where(one, value[motion.first], curve)
