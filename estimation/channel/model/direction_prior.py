"""What is known of the directions of paths before they are measured.

Floors and ceilings are level and walls are upright, so a path departs and arrives at the same elevation, up or
down; and most paths are nearly level. Little comes from behind a panel.
"""

import numpy as np

from estimation.channel.model.manifold import Manifold
from scenes.pose import wrap_angle
from scenes.record import FloatArray

SPREAD_RAD = np.deg2rad(10.0)  # Laplacian scale of elevations: a spread of 14 deg (TR 38.901 table 7.5-6, indoor)
BEHIND_SHARE = 0.01  # of the paths, behind a panel: their gain is some 20 dB below that of the mirrored direction
EQUAL_SHARE = 0.9  # of paths with equal elevations at both ends
EQUAL_RAD = np.deg2rad(2.0)  # standard deviation of their estimated difference


def direction_log_prior(tx: Manifold, rx: Manifold, aod_rad: FloatArray, aoa_rad: FloatArray) -> FloatArray:
    """Logarithm (path,) of the prior density of directions (path, angle) that beams observe, up to a constant."""
    ends = [(manifold, angles) for manifold, angles in ((tx, aod_rad), (rx, aoa_rad)) if sees_elevation(manifold)]
    if not ends:
        return np.zeros(len(aod_rad))
    behind = np.sum([manifold.is_behind(angles) for manifold, angles in ends], axis=0)
    seen = [np.abs(wrap_angle(angles[:, 1])) for _, angles in ends]
    first = np.log(BEHIND_SHARE) * behind - seen[0] / SPREAD_RAD
    if len(seen) == 1:
        return np.asarray(first)
    equal = EQUAL_SHARE * np.exp(-(((seen[1] - seen[0]) / EQUAL_RAD) ** 2) / 2) / (np.sqrt(2 * np.pi) * EQUAL_RAD)
    other = (1 - EQUAL_SHARE) * np.exp(-seen[1] / SPREAD_RAD) / SPREAD_RAD
    return np.asarray(first + np.log(equal + other))


def sees_elevation(manifold: Manifold) -> bool:
    """Whether the beams of one panel observe elevations."""
    return manifold.n_angles == 2 and not manifold.hides_elevation
