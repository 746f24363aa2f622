"""Settings of the scores: the gate within which an estimate can be a true path, and the significance of paths."""

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from scenes.record import FloatArray


class Gate(BaseModel):
    """Largest error in each parameter at which an estimated path can still be assigned to a true path.

    The defaults are about one resolution cell of 400 MHz and of a 16-element row. The limit of an azimuth is also
    that of the elevation at the same device.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    delay_ns: float = Field(3.0, gt=0)
    aod_deg: float = Field(5.0, gt=0)
    aoa_deg: float = Field(5.0, gt=0)

    @property
    def half_width(self) -> FloatArray:
        """Limits (3,) in (s, rad, rad) of delay and both azimuths."""
        return np.array([self.delay_ns * 1e-9, np.deg2rad(self.aod_deg), np.deg2rad(self.aoa_deg)])

    @property
    def half_width_in_space(self) -> FloatArray:
        """Limits (5,) in (s, rad, rad, rad, rad): the same, then both elevations."""
        return self.half_width[[0, 1, 2, 1, 2]]


class Significance(BaseModel):
    """Which true paths an estimator can detect."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    dynamic_range_db: float = Field(gt=0, description="of the estimator, below the strongest path of a stop")
    noise_threshold_dbm: float = Field(description="power of the weakest path that the estimator can detect")


class Separability(BaseModel):
    """How well the joint bound must know a path that an estimator is expected to find.

    The default is the bound of a lone path that a detector finds with probability .98. A false alarm in any of
    some N = 5e4 resolution cells may have the probability P = 3e-4, so the threshold on energy over noise is
    ln(N / P) = 19, and the path needs an SNR, over all samples, of (sqrt(2 x 19) + 2.05)^2 / 2 = 34 (15 dB). Its
    bound is then sqrt(3) / (pi sqrt(2 SNR)) = .067 of the Rayleigh cell of a uniform aperture. A neighbour that
    raises the bound beyond this costs as much as the noise that hides a lone path.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    share_of_cell: float = Field(0.067, gt=0, description="largest joint bound over a resolution cell")


DEFAULT_GATE = Gate()
DEFAULT_SEPARABILITY = Separability()
