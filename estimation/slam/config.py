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
        return range_covariance(estimate.plane_covariance) + floor


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
    degrees_of_freedom: float = Field(3.0, gt=0)


class Consider(ConfigModel):
    """Errors of the set-up that a stop cannot see and that only widen its covariance (consider-parameters).

    A pointing error of the TX turns the whole solution about the TX; the survey error is the TX's position; the
    heading error is how well a receiver's heading is known where states are compared.
    """

    pointing_std_deg: float = Field(0.0, ge=0)
    survey_std_m: float = Field(0.0, ge=0)
    heading_std_deg: float = Field(0.0, ge=0)

    def covariance(self, from_tx_m: FloatArray) -> FloatArray:
        """What to add (..., 4, 4) to the covariance of states [x, y, heading, bias] at offsets from the TX."""
        x, y = from_tx_m[..., 0], from_tx_m[..., 1]
        turn = np.stack([-y, x, np.ones_like(x), np.zeros_like(x)], axis=-1)
        pointing = np.deg2rad(self.pointing_std_deg) ** 2 * turn[..., :, None] * turn[..., None, :]
        heading = np.deg2rad(self.heading_std_deg)
        rest = np.diag([self.survey_std_m, self.survey_std_m, heading, 0.0]) ** 2
        return np.asarray(pointing + rest)


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
    n_ranked: int = Field(6, ge=2)
    ambiguous_gap: float = Field(4.0, ge=0)
    consider: Consider = Consider()
    max_iterations: int = Field(25, ge=1)
    max_clock_bias_ns: float = Field(300.0, gt=0, description="a larger clock bias is not credible")

    @property
    def max_clock_bias_m(self) -> float:
        """Largest credible clock bias as a length."""
        return self.max_clock_bias_ns * 1e-9 * SPEED_OF_LIGHT_M_S


class TrajectoryConfig(ConfigModel):
    """The smoother over all stops.

    The motion prior is a Student-t law of the second difference of the position, in m per stop squared:
    `cross_track_std_m` across the walk, `along_track_std_m` along it, so that neither the spacing of the stops
    need be known nor that it is even.

    `use_landmarks`, `use_double_bounces`, `use_sessions`
        Share walls and objects between stops; take paths by way of two known walls as information; look for
        jumps of the TX heading offset.
    """

    use_landmarks: bool = True
    use_double_bounces: bool = True
    use_sessions: bool = True
    degrees_of_freedom: float = Field(4.0, gt=0)
    cross_track_std_m: float = Field(0.1, gt=0)
    along_track_std_m: float = Field(0.5, gt=0)
    motion_degrees_of_freedom: float = Field(2.0, gt=0)
    spacing_m: float | None = Field(None, gt=0)
    heading_step_deg: float = Field(10.0, gt=0)
    clock_step_ns: float = Field(3.3, gt=0)
    n_modes: int = Field(6, ge=1)
    gate_probability: float = Field(0.997, gt=0, lt=1)

    confirm_probability: float = Field(0.99, gt=0, lt=1)

    cluster_eps_m: float = Field(0.6, gt=0)
    cluster_min_samples: int = Field(5, ge=2)
    min_wall_length_m: float = Field(1.0, gt=0)
    max_object_extent_m: float = Field(1.5, gt=0)
    wall_roughness_m: float = Field(0.03, ge=0)
    object_roughness_m: float = Field(0.08, ge=0)
    object_radius_m: float = Field(0.2, ge=0)
    object_radius_std_m: float = Field(0.2, gt=0)

    offset_std_deg: float = Field(5.0, gt=0)
    min_session_stops: int = Field(4, ge=2)
    min_session_gain: float = Field(10.0, gt=0)

    rounds: int = Field(10, ge=1)
    max_iterations: int = Field(20, ge=1)
    relative_tolerance: float = Field(1e-5, gt=0)

    @property
    def heading_step_rad(self) -> float:
        """Scale of the heading's step between stops, in rad."""
        return float(np.deg2rad(self.heading_step_deg))

    @property
    def clock_step_m(self) -> float:
        """Scale of the clock bias's step between stops, in m."""
        return self.clock_step_ns * 1e-9 * SPEED_OF_LIGHT_M_S

    @property
    def offset_std_rad(self) -> float:
        """Standard deviation of a session's TX heading offset, in rad."""
        return float(np.deg2rad(self.offset_std_deg))


def _diagonal(delay_std_ns: float, angle_std_deg: float) -> FloatArray:
    angle = np.deg2rad(angle_std_deg)
    return np.diag([SPEED_OF_LIGHT_M_S * 1e-9 * delay_std_ns, angle, angle]) ** 2
