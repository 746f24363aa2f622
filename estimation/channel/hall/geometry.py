"""Vertical versions of a path in a hall of upright surfaces: lengths and elevations follow from three heights.

Upright surfaces keep the vertical component of a direction. So a path that they reflect has a *plan path*
(azimuths of departure and arrival, and plan length L), and floor and ceiling repeat it: by image sources, a
version with the height difference dz has the length sqrt(L^2 + dz^2) and the elevation of slope dz / L. With the
floor at height 0, the devices at h_t and h_r and the ceiling at H, dz is

    level  h_t - h_r,  floor  h_t + h_r,  ceiling  2 H - h_t - h_r,
    floor, then ceiling  2 H + h_t - h_r,  ceiling, then floor  2 H - h_t + h_r.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from scenes.record import FloatArray


class Version(IntEnum):
    """How a path crosses the height difference; the axis `version` of arrays has this order."""

    LEVEL = 0
    FLOOR = 1
    CEILING = 2
    FLOOR_CEILING = 3
    CEILING_FLOOR = 4


NO_CEILING_M = 1e4  # height of a ceiling that no path reaches

# Height differences are linear in the heights of TX, receiver and ceiling.
HEIGHT_SLOPES = np.array([[1, -1, 0], [1, 1, 0], [-1, -1, 2], [1, -1, 2], [-1, 1, 2]], float)
# Signs of the elevation at the TX and at the receiver over the height difference.
ELEVATION_SIGNS = np.array([[-1, 1], [-1, -1], [1, 1], [-1, 1], [1, -1]], float)


@dataclass(frozen=True)
class Heights:
    """Heights above the floor in m."""

    tx_m: float
    rx_m: float
    ceiling_m: float

    @property
    def vector(self) -> FloatArray:
        """Heights (3,) of TX, receiver and ceiling."""
        return np.array([self.tx_m, self.rx_m, self.ceiling_m])

    @property
    def differences_m(self) -> FloatArray:
        """Height difference dz (version,) of every version."""
        return np.asarray(HEIGHT_SLOPES @ self.vector)

    @property
    def are_possible(self) -> bool:
        """Whether both devices are between floor and ceiling."""
        return min(self.tx_m, self.rx_m) > 0 and max(self.tx_m, self.rx_m) < self.ceiling_m


def heights_from_gaps(floor_m2: FloatArray, ceiling_m2: FloatArray, difference_m: FloatArray) -> FloatArray:
    """Heights (..., 3) of TX, receiver and ceiling from what delays tell: differences of dz^2 from the level one.

    floor_m2 = 4 h_t h_r, ceiling_m2 = 4 (H - h_t) (H - h_r), difference_m = h_t - h_r.
    """
    above_floor = np.sqrt(floor_m2 + difference_m**2) / 2
    below_ceiling = np.sqrt(ceiling_m2 + difference_m**2) / 2
    half = difference_m / 2
    return np.stack([above_floor + half, above_floor - half, above_floor + below_ceiling], axis=-1)
