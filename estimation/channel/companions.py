"""Companions of strong paths: what wrong responses of the arrays leave of them.

The true response of an end differs from that of the model where elements have errors, or where a path stands for
two that nearly coincide. A strong path then leaves a part of its power in other directions of this end, at its
own delay and its own direction at the other end. Weak paths fit that part. True paths rarely agree so: their
number is compared with that of paths at delays a little apart.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import pdtrc

from estimation.channel.fit import PathFit
from estimation.channel.model.manifold import CELL, Manifold
from estimation.distributions import chi_square_quantile
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray

WEAKER_DB = 10.0  # least difference from the strong path
# Squared distance of delay and angle at the other end, over its variance
AGREEMENT = float(chi_square_quantile(0.99, 2))
APART_STD = (4.0, 16.0)  # distance in delay, over its standard deviation, of paths that agree by chance alone
SIGNIFICANT = 1e-3  # probability that so many agree by chance


def companions(fit: PathFit, tx: Manifold, rx: Manifold) -> BoolArray:
    """Mask (path,) of the companions of stronger paths; none if chance explains them.

    A companion agrees with the strong path in delay and in the direction at one end, and is more than a resolution
    cell away at the other. `tx` and `rx` are the manifolds of the fit.
    """
    variance = np.einsum("ipp->ip", fit.covariance)
    n_aod, n_aoa = fit.aod_rad.shape[1], fit.aoa_rad.shape[1]
    departures = _End(fit.aod_rad, variance[:, 1 : 1 + n_aod], tx)
    arrivals = _End(fit.aoa_rad, variance[:, 1 + n_aod : 1 + n_aod + n_aoa], rx)
    late = np.square(fit.delay_s[:, None] - fit.delay_s) / (variance[:, None, 0] + variance[:, 0])
    is_weaker = fit.snr_db[:, None] <= fit.snr_db - WEAKER_DB
    same = is_weaker & (
        (departures.is_same() & arrivals.is_elsewhere()) | (arrivals.is_same() & departures.is_elsewhere())
    )
    agree = same & (late <= AGREEMENT)
    control = same & (late > APART_STD[0] ** 2) & (late <= APART_STD[1] ** 2)
    by_chance = 1 + control.sum() * np.sqrt(AGREEMENT) / (APART_STD[1] - APART_STD[0])
    is_significant = agree.any() and pdtrc(agree.sum() - 1, by_chance) <= SIGNIFICANT
    return np.asarray(agree.any(axis=1) & is_significant)


@dataclass(frozen=True)
class _End:
    """Directions (path, angle) at one end, their variances (path, angle), and the manifold."""

    angle_rad: FloatArray
    variance: FloatArray
    manifold: Manifold

    def is_same(self) -> BoolArray:
        """Whether two directions (path, other) agree within their errors."""
        variance = self.variance[:, None] + self.variance
        return np.asarray((np.square(self._apart_rad()) <= AGREEMENT * variance).all(axis=2))

    def is_elsewhere(self) -> BoolArray:
        """Whether a direction is more than a resolution cell from the other, (path, other)."""
        rate = self.manifold.rates(self.angle_rad)
        return np.asarray((self._apart_rad() * rate > CELL).any(axis=2))

    def _apart_rad(self) -> FloatArray:
        return np.asarray(np.abs(wrap_angle(self.angle_rad[:, None] - self.angle_rad)))
