"""Parameters of mapping and snapshot SLAM."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from estimation.channel.record import ChannelEstimate
from estimation.geometry import range_covariance
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray
from scenes.toml_config import ConfigModel


class PathNoise(ConfigModel):
    """Which covariance R a path's (delay, departure, arrival) is given.

    `fixed` is diag(delay_std, angle_std, angle_std)^2 for every path, as in the paper after equation (2).
    `estimate` is the covariance of the channel estimate plus diag(floor)^2 for what it leaves out: model
    errors, survey errors, the third dimension.
    """

    source: Literal["estimate", "fixed"] = "estimate"
    delay_std_ns: float = Field(1.0, gt=0)
    angle_std_deg: float = Field(1.0, gt=0)
    floor_delay_std_ns: float = Field(0.1, ge=0)
    floor_angle_std_deg: float = Field(0.2, ge=0)

    def covariance(self, estimate: ChannelEstimate) -> FloatArray:
        """R (path, 3, 3) in (m, rad, rad)^2 of the paths of one stop."""
        if self.source == "fixed":
            return np.tile(_diagonal(self.delay_std_ns, self.angle_std_deg), (len(estimate), 1, 1))
        floor = _diagonal(self.floor_delay_std_ns, self.floor_angle_std_deg)
        return range_covariance(estimate.covariance) + floor


class MappingConfig(ConfigModel):
    """Mapping by equation (4) and the gate for single bounces.

    A path counts as a single bounce where J is below the chi-square quantile (1 degree of freedom) of
    `gate_probability`, the IP lies ahead of both devices at `min_leg_m` or more, and its largest standard
    deviation is at most `max_position_std_m` (nearly parallel rays leave the IP free along them).
    """

    noise: PathNoise = PathNoise()
    gate_probability: float = Field(0.99, gt=0, lt=1)
    max_position_std_m: float = Field(1.0, gt=0)
    min_leg_m: float = Field(0.2, ge=0)
    max_iterations: int = Field(30, ge=1)
    relative_tolerance: float = Field(1e-9, gt=0)


class PathLoss(ConfigModel):
    """Power of a line of sight: intercept + slope * log10(d / 1 m), with a Gaussian spread.

    A path is no credible line of sight where the log-likelihood of its power is below `min_log_likelihood`.
    The defaults are those of the measured campaign, arXiv 2404.10291.
    """

    intercept_dbm: float = -13.0
    slope_db: float = -17.0
    std_db: float = Field(1.8, gt=0)
    min_log_likelihood: float = -10.8

    def is_credible(self, power_dbm: float, distance_m: float) -> bool:
        """Whether a received power fits a line of sight of that length."""
        expected = self.intercept_dbm + self.slope_db * np.log10(max(distance_m, 1e-3))
        deviation = (power_dbm - expected) / self.std_db
        log_likelihood = -0.5 * deviation**2 - np.log(np.sqrt(2 * np.pi) * self.std_db)
        return bool(log_likelihood >= self.min_log_likelihood)


class Mixture(ConfigModel):
    """Model of a path's residual in the statistical method: a single bounce or clutter.

    A single bounce has a Student-t residual with the standard deviation its covariance gives; clutter is
    spread evenly over `clutter_width_m`.
    """

    clutter_share: float = Field(0.3, gt=0, lt=1)
    clutter_width_m: float = Field(30.0, gt=0)
    degrees_of_freedom: float = Field(4.0, gt=0)


class SnapshotConfig(ConfigModel):
    """Robust snapshot SLAM; the defaults are the published algorithm and its parameters.

    `method`
        `reference`: heading grid, power weights, distance gate, as published.
        `statistical`: closed-form headings, each path gated and weighted by its own covariance.
    `refine`
        Maximum-likelihood refinement of the reference solution on its inliers; the statistical method always
        refines.
    """

    method: Literal["reference", "statistical"] = "reference"
    refine: bool = False
    path_loss: PathLoss = PathLoss()
    max_hypothesis_paths: int = Field(12, ge=4)
    min_los_inliers: int = Field(3, ge=2)
    min_nlos_inliers: int = Field(4, ge=4)

    n_headings: int = Field(361, ge=2)
    gate_m2: float = Field(0.1, gt=0)
    parallel_gate: float = Field(0.1, ge=0)

    noise: PathNoise = PathNoise()
    mixture: Mixture = Mixture()
    gate_probability: float = Field(0.997, gt=0, lt=1)
    n_modes: int = Field(16, ge=1)
    max_iterations: int = Field(25, ge=1)


def _diagonal(delay_std_ns: float, angle_std_deg: float) -> FloatArray:
    angle = np.deg2rad(angle_std_deg)
    return np.diag([SPEED_OF_LIGHT_M_S * 1e-9 * delay_std_ns, angle, angle]) ** 2
