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
_PLANES = 2  # floor and ceiling


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
            uniform = np.full(len(rows), 1 / max(float(np.ptp(height[rows])), 1.0))
            found[rows] = _on_plane(height[rows], variance[rows], uniform)
    return found


def on_planes(height_m: FloatArray, variance_m2: FloatArray, elsewhere: FloatArray) -> BoolArray:
    """Which points (point,) have the height of many others: on the floor or on the ceiling.

    `elsewhere` (point,) is the density per m of the height of a point on neither.
    """
    found = np.zeros(len(height_m), bool)
    for _ in range(_PLANES):
        rows = np.flatnonzero(~found)
        if len(rows):
            found[rows] = _on_plane(height_m[rows], variance_m2[rows], elsewhere[rows])
    return found


def _on_plane(height_m: FloatArray, variance_m2: FloatArray, elsewhere: FloatArray) -> BoolArray:
    """Which heights (ip,) are those of one plane; the others have the densities `elsewhere` (ip,)."""
    spread = variance_m2 + _RELIEF_M**2
    density = np.exp(-0.5 * (height_m - height_m[:, None]) ** 2 / spread) / np.sqrt(2 * np.pi * spread)
    ratio = density / elsewhere  # (plane, ip)
    share = np.full((len(height_m), 1), 0.5)
    for _ in range(_ROUNDS):
        posterior = share * ratio / (share * ratio + 1 - share)
        share = posterior.mean(axis=1, keepdims=True)
    gain = np.log(share * ratio + 1 - share).sum(axis=1)
    best = int(np.argmax(gain))
    return np.asarray((posterior[best] > 0.5) & (gain[best] > MIN_GAIN_NAT))
