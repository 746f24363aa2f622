"""Paths by way of floor and ceiling, told by the heights of their incidence points.

A level surface scatters from places anywhere in plan view, which look like small objects there. Their heights
agree.
"""

import numpy as np

from estimation.shape.reflection.association import MIN_GAIN_NAT
from estimation.slam.record import IncidencePoints
from scenes.record import BoolArray, FloatArray

_RELIEF_M = 0.05  # standard deviation of places of a level surface about its height
_CLEAR_M = 0.3  # of floor and ceiling from all devices: upright mirrors show their heights
_ROUNDS = 10


def is_level(ips: IncidencePoints, devices_m: tuple[float, float]) -> BoolArray:
    """Whether each point (ip,) lies on the floor or on the ceiling rather than anywhere between.

    Both are heights at which many points lie, below and above the heights of all devices, `devices_m` from the
    lowest to the highest. Points without a height are on neither.
    """
    height, variance = ips.height_m, ips.height_covariance_m2[:, 2]
    found = np.zeros(len(height), bool)
    known = np.isfinite(height) & np.isfinite(variance)
    for outside in (height < devices_m[0] - _CLEAR_M, height > devices_m[1] + _CLEAR_M):
        rows = np.flatnonzero(known & outside)
        if len(rows):
            found[rows] = _on_plane(height[rows], variance[rows])
    return found


def _on_plane(height_m: FloatArray, variance_m2: FloatArray) -> BoolArray:
    """Which heights (ip,) are those of one plane; the others are uniform over their range."""
    spread = variance_m2 + _RELIEF_M**2
    density = np.exp(-0.5 * (height_m - height_m[:, None]) ** 2 / spread) / np.sqrt(2 * np.pi * spread)
    ratio = density * max(float(np.ptp(height_m)), 1.0)  # (plane, ip)
    share = np.full((len(height_m), 1), 0.5)
    for _ in range(_ROUNDS):
        posterior = share * ratio / (share * ratio + 1 - share)
        share = posterior.mean(axis=1, keepdims=True)
    gain = np.log(share * ratio + 1 - share).sum(axis=1)
    best = int(np.argmax(gain))
    return np.asarray((posterior[best] > 0.5) & (gain[best] > MIN_GAIN_NAT))
