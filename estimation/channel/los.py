"""Is the earliest path the line of sight? A decision from delays and powers, with the clock unknown."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import BoolArray, FloatArray
from scenes.toml_config import ConfigModel


class LosConfig(ConfigModel):
    """The nominal line-of-sight power over distance and the tolerances of the decision."""

    power_at_1m_dbm: float = Field(-13.0, description="LOS power at 1 m between the peaks of two beams")
    tolerance_db: float = Field(3.0, gt=0, description="how far a path may exceed what its length allows")
    max_clock_bias_ns: float = Field(150.0, gt=0, description="largest clock bias that is credible")


def line_of_sight(delay_s: FloatArray, power_dbm: FloatArray, config: LosConfig) -> BoolArray:
    """Mask (path,) with at most the earliest path set, for paths sorted by delay.

    `power_dbm` (path,) is what the peaks of two beams would receive: without the loss of the beams' gain there.

    If the earliest path is the LOS, its power tells its length d0 by free-space loss, the unknown clock drops out,
    and a path that comes later by dt cannot be stronger than free space allows at d0 + c dt (a perfect mirror).
    One that is stronger, beyond the tolerance, shows that the earliest path was itself attenuated: no LOS. Nor is
    it where its delay and length differ by more than any credible clock bias.
    """
    is_los = np.zeros(len(delay_s), bool)
    if not len(delay_s):
        return is_los
    length_m = 10 ** ((config.power_at_1m_dbm - power_dbm[0]) / 20)
    later_m = length_m + SPEED_OF_LIGHT_M_S * (delay_s - delay_s[0])
    allowed_dbm = config.power_at_1m_dbm - 20 * np.log10(later_m)
    clock_bias_s = delay_s[0] - length_m / SPEED_OF_LIGHT_M_S
    is_weak_enough = (power_dbm <= allowed_dbm + config.tolerance_db).all()
    is_los[0] = bool(is_weak_enough and abs(clock_bias_s) <= config.max_clock_bias_ns * 1e-9)
    return is_los
