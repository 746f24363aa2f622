"""Which paths of a stop belong to the world that stands: what mapping, SLAM and contours take.

A receiver that walks shifts every path by its own velocity along the arrival: nu = v . u(aoa) for all that stands,
in units of the wavelength. So the world that stands is the largest part of the paths that one velocity explains,
zero among the candidates. Every path is either part of it, or a mover whose shift may be anything: the likelihood
of this mixture chooses the velocity, and the evidence between the two decides path by path.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from estimation.channel.record import ChannelEstimate
from scenes.arguments import need
from scenes.record import BoolArray, FloatArray, IntArray

MOVERS = 0.2  # prior share of the paths
WIDEST_HZ = 2400.0  # range that the shift of a mover is uniform in
LEAST_STD_HZ = 3.0  # by which directions and the errors of the model limit the sum of a velocity
SHARE = 0.02  # of the shift by the receiver's own motion: elevations are not always known
FROZEN_SHIFT = 3.3  # standard deviations that the shift of a frozen path may have
MOST_PAIRS = 400
LEAST_ANGLE = 0.1  # sine of the angle between two arrivals that tell a velocity
REFITS = 3


@dataclass(frozen=True)
class StillPaths:
    """The paths of all stops that stand, and their numbers (path,) among all paths of each stop."""

    channel: list[ChannelEstimate]
    number: list[IntArray]

    def of_all(self, stop: IntArray, path: IntArray) -> IntArray:
        """Numbers (point,) among all paths, of paths numbered among those that stand."""
        return self._translated(stop, path, self.number)

    def of_still(self, stop: IntArray, path: IntArray) -> IntArray:
        """Numbers (point,) among the paths that stand, of those of them that are numbered among all."""
        tables = []
        for number in self.number:
            table = np.full(number.max(initial=-1) + 1, -1)
            table[number] = np.arange(len(number))
            tables.append(table)
        return self._translated(stop, path, tables)

    def _translated(self, stop: IntArray, path: IntArray, tables: list[IntArray]) -> IntArray:
        row = {estimate.stop: table for estimate, table in zip(self.channel, tables, strict=True)}
        pairs = zip(stop.tolist(), path.tolist(), strict=True)
        return np.array([row[at][one] for at, one in pairs], int).reshape(len(path))


def still_paths(channel: Sequence[ChannelEstimate]) -> StillPaths:
    """The paths that stand, stop by stop; estimates without Doppler shifts are kept as they are."""
    kept, numbers = [], []
    for estimate in channel:
        still = is_still(estimate)
        kept.append(estimate if still.all() else estimate.take("path", still))
        numbers.append(np.flatnonzero(still))
    return StillPaths(kept, numbers)


def is_still(estimate: ChannelEstimate) -> BoolArray:
    """Mask (path,) of the paths that stand: those with a shift that the receiver's own motion explains."""
    need("estimate", estimate, ChannelEstimate)
    return still_motion(estimate)[0]


def still_motion(estimate: ChannelEstimate) -> tuple[BoolArray, FloatArray]:
    """The mask (path,) of `is_still`, and the receiver's velocity (xy,) in its own frame, in wavelengths per s."""
    motion = estimate.motion
    if motion is None or not motion.is_moving.any():
        return np.ones(len(estimate), bool), np.zeros(2)
    shift_hz = motion.doppler_hz
    std_hz = np.where(motion.is_moving, motion.doppler_std_hz, np.nanmedian(motion.doppler_std_hz) * FROZEN_SHIFT)
    level = np.cos(np.nan_to_num(estimate.aoa_elevation_rad))
    along = level[:, None] * np.stack([np.cos(estimate.aoa_azimuth_rad), np.sin(estimate.aoa_azimuth_rad)], axis=1)
    best, highest = np.zeros(2), -np.inf
    for candidate in _candidates(along, shift_hz, np.flatnonzero(motion.is_moving)):
        velocity = candidate
        for _ in range(REFITS if candidate.any() else 0):
            velocity = _refitted(velocity, along, shift_hz, std_hz)
        likelihood = np.logaddexp(*_log_parts(velocity, along, shift_hz, std_hz)).sum()
        if candidate.any():
            likelihood += _log_share(velocity, along, shift_hz, std_hz)
        if likelihood > highest:
            best, highest = velocity, float(likelihood)
    still, mover = _log_parts(best, along, shift_hz, std_hz)
    return np.asarray(still >= mover), best


def _candidates(along: FloatArray, shift_hz: FloatArray, moving: IntArray) -> list[FloatArray]:
    """Velocities (xy,) in Hz: none, and those that the shifts of two moving paths have in common."""
    found: list[FloatArray] = [np.zeros(2)]
    for pair in list(combinations(moving, 2))[:MOST_PAIRS]:
        rows: FloatArray = along[list(pair)]
        if abs(np.linalg.det(rows)) > LEAST_ANGLE:
            velocity = np.asarray(np.linalg.solve(rows, shift_hz[list(pair)]), float)
            found.append(velocity)
    return found


def _spread_hz(velocity: FloatArray, std_hz: FloatArray) -> FloatArray:
    own = np.square(SHARE * np.linalg.norm(velocity))
    return np.asarray(np.sqrt(np.square(std_hz) + LEAST_STD_HZ**2 + own))


def _log_parts(
    velocity: FloatArray, along: FloatArray, shift_hz: FloatArray, std_hz: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Log likelihoods (path,) with priors of standing and of moving, at a velocity of the receiver."""
    spread = _spread_hz(velocity, std_hz)
    off = (shift_hz - along @ velocity) / spread
    still = np.log(1 - MOVERS) - np.square(off) / 2 - np.log(np.sqrt(2 * np.pi) * spread)
    return still, np.full(len(off), np.log(MOVERS / WIDEST_HZ))


def _refitted(velocity: FloatArray, along: FloatArray, shift_hz: FloatArray, std_hz: FloatArray) -> FloatArray:
    """The velocity that the paths standing at a velocity have in common."""
    weight = _weight(velocity, along, shift_hz, std_hz)
    information = along.T @ (along * weight[:, None])
    return np.asarray(np.linalg.lstsq(information, along.T @ (weight * shift_hz), rcond=None)[0])


def _log_share(velocity: FloatArray, along: FloatArray, shift_hz: FloatArray, std_hz: FloatArray) -> float:
    """Log share of all velocities that the paths leave possible: what a receiver that stands need not explain."""
    weight = _weight(velocity, along, shift_hz, std_hz)
    information = along.T @ (along * weight[:, None])
    return float(np.log(2 * np.pi / WIDEST_HZ**2) - np.log(max(np.linalg.det(information), WIDEST_HZ**-4)) / 2)


def _weight(velocity: FloatArray, along: FloatArray, shift_hz: FloatArray, std_hz: FloatArray) -> FloatArray:
    """Weights (path,) in Hz^-2 of paths at a velocity: their precision, times the chance that they stand."""
    still, mover = _log_parts(velocity, along, shift_hz, std_hz)
    chance = 1 / (1 + np.exp(np.clip(mover - still, -50, 50)))
    return np.asarray(chance / np.square(_spread_hz(velocity, std_hz)))
