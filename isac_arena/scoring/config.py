"""Settings of the scores: the gate within which an estimate can be a true path, and the significance of paths."""

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from scenes.record import FloatArray


class Gate(BaseModel):
    """Largest error in each parameter at which an estimated path can still be assigned to a true path.

    The defaults are about one resolution cell of 400 MHz and of a 16-element row.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    delay_ns: float = Field(3.0, gt=0)
    aod_deg: float = Field(5.0, gt=0)
    aoa_deg: float = Field(5.0, gt=0)

    @property
    def half_width(self) -> FloatArray:
        """Limits (3,) in (s, rad, rad)."""
        return np.array([self.delay_ns * 1e-9, np.deg2rad(self.aod_deg), np.deg2rad(self.aoa_deg)])


class Significance(BaseModel):
    """Which true paths an estimator can detect."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    dynamic_range_db: float = Field(gt=0, description="of the estimator, below the strongest path of a stop")
    noise_threshold_dbm: float = Field(description="power of the weakest path that the estimator can detect")


DEFAULT_GATE = Gate()
