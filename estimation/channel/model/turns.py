"""Doppler in a beam sweep: the phase of a moving path turns from beam pair to beam pair.

The time of a pair is that of its TX beam plus that of its RX beam, so the turn is a product of one factor per end
and every response stays a product over TX, RX and delay. A Doppler shift is counted in turns during the sweep:
its derivatives are then as large as those of angles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import BoolArray, ComplexArray, FloatArray
from sim.observation import BeamClock, BeamSweep


@dataclass(frozen=True)
class SweepTurns:
    """When beams are measured, as shares of the sweep about its middle; equal for all stops of a campaign.

    Attributes
    ----------
    tx, rx : (beam,) times of the beams over `span_s`
    span_s : duration that turns are counted over
    carrier_hz : of the waves
    most : largest number of turns that is searched
    """

    tx: tuple[float, ...]
    rx: tuple[float, ...]
    span_s: float
    carrier_hz: float
    most: float

    def turned(self, factor: ComplexArray | FloatArray, turns: FloatArray, *, is_tx: bool) -> ComplexArray:
        """Responses or slopes (path, factor, beam) of one end, turned by the Doppler shifts (path, 1)."""
        return np.asarray(factor * self.wave(turns, is_tx=is_tx)[:, None])

    def wave(self, turns: FloatArray, *, is_tx: bool) -> ComplexArray:
        """The turning factor (path, beam) of one end, for Doppler shifts (path, 1)."""
        return np.asarray(np.exp(2j * np.pi * turns * np.array(self.tx if is_tx else self.rx)))

    def with_slope(self, factor: ComplexArray | FloatArray, turns: FloatArray, *, is_tx: bool) -> ComplexArray:
        """Tangents (path, factor, beam) of one end, turned, and a last one: the slope of the first over turns.

        A shift of exactly zero is that of a frozen path: it has no slope and stays.
        """
        turned = self.turned(factor, turns, is_tx=is_tx)
        rate = 2j * np.pi * np.array(self.tx if is_tx else self.rx) * (turns[:, :1] != 0)
        return np.concatenate([turned, turned[:, :1] * rate[:, None]], axis=1)

    def mean_time(self, tx: ComplexArray, rx: ComplexArray) -> FloatArray:
        """When the energy of paths arrives, as a share of the sweep (path,), from responses (path, beam)."""
        return _moments(tx, self.tx)[0] + _moments(rx, self.rx)[0]

    def rates(self, tx: ComplexArray | FloatArray, rx: ComplexArray | FloatArray) -> FloatArray:
        """Length on the manifold (path,) per turn, from the responses (path, beam) of both ends."""
        return np.asarray(2 * np.pi * np.sqrt(_moments(tx, self.tx)[1] + _moments(rx, self.rx)[1]))


def sweep_turns(sweep: BeamSweep, max_rate_m_s: float) -> SweepTurns | None:
    """The turns of a sweep with a clock, for lengths of paths that change by at most `max_rate_m_s`; else None."""
    clock = sweep.clock
    if clock is None or not (span_s := _span_s(clock)):
        return None
    tx, rx = (tuple((each / span_s).tolist()) for each in (clock.tx_s, clock.rx_s))
    return SweepTurns(
        tx, rx, span_s, sweep.carrier_hz, max_rate_m_s / SPEED_OF_LIGHT_M_S * sweep.carrier_hz * span_s
    )


def is_moving(turns: FloatArray) -> BoolArray:
    """Mask (path,) of the paths with a Doppler shift (path, 0 or 1)."""
    return np.asarray((turns != 0).any(axis=1))


def _span_s(clock: BeamClock) -> float:
    return float(np.ptp(clock.tx_s) + np.ptp(clock.rx_s))


def _moments(response: ComplexArray | FloatArray, time: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Mean and variance (path,) of the times of beams (beam,), weighted by the energy in them."""
    energy = np.square(np.abs(response))
    weight = energy / np.maximum(energy.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    mean = weight @ np.array(time)
    return mean, np.maximum(weight @ np.square(time) - mean**2, 0.0)
