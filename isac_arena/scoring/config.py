"""Settings of the scores: what counts as the same path and as a found object."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from scenes.record import FloatArray


class Gate(BaseModel):
    """Largest error per parameter at which an estimated path can still be a true one.

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
    """Which true paths an estimator had a fair chance to detect."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    dynamic_range_db: float = Field(gt=0, description="of the estimator, below the strongest path of a stop")
    noise_threshold_dbm: float = Field(description="weakest path the estimator can tell from noise")


class ScoringConfig(BaseModel):
    """Settings of all scores that are a matter of definition."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    gate: Gate = Gate()
    weak_margin_db: float = Field(6.0, ge=0, description="true energy may lie this far below an estimate")
    near_gates: float = Field(
        2.0, ge=1, description="an estimate this many gates off is a poor one of a path"
    )
    threshold_margin_db: float = Field(3.0, ge=0, description="chance decides this far above a threshold")
    outside_beams_db: float = Field(
        10.0, gt=0, description="no beam points where the best gain is this far below the highest"
    )
    found_distance_m: float = Field(0.5, gt=0, description="an IP this close to its object speaks for it")
    found_points: int = Field(3, ge=1, description="such IPs needed to call an object found")
    found_share: float = Field(0.5, gt=0, le=1, description="share of a cluster that must stem from it")
    seen_margin_deg: float = Field(10.0, gt=0, description="contour this close to a training angle is seen")
