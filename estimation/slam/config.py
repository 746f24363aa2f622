"""Settings of mapping and SLAM."""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from estimation.channel.record import ChannelEstimate
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray
from scenes.toml_config import ConfigModel


class PathNoise(ConfigModel):
    """Covariance R of a path's (delay, departure, arrival).

    `fixed` is diag(delay_std, angle_std, angle_std)^2 for every path, as in the paper after equation (2).
    `estimate` is the covariance of the channel estimate plus diag(floor)^2 for errors it does not contain: of the
    model, of the survey, of the third dimension.
    """

    source: Literal["estimate", "fixed"] = Field(
        "estimate", description="covariances of the channel estimate, or fixed ones"
    )
    delay_std_ns: float = Field(1.0, gt=0, description="fixed: standard deviation of a delay")
    angle_std_deg: float = Field(1.0, gt=0, description="fixed: standard deviation of an azimuth")
    floor_delay_std_ns: float = Field(0.1, ge=0, description="estimate: added in quadrature to delays")
    floor_angle_std_deg: float = Field(0.2, ge=0, description="estimate: added in quadrature to angles")

    def covariance(self, estimate: ChannelEstimate) -> FloatArray:
        """R (path, 3, 3) in (m, rad, rad)^2 of the paths of one stop."""
        if self.source == "fixed":
            return np.tile(_diagonal(self.delay_std_ns, self.angle_std_deg), (len(estimate), 1, 1))
        from estimation.laws.plane import range_covariance  # noqa: PLC0415  (compiles, slow to import)

        return range_covariance(estimate.plane_covariance) + self.floor

    def with_floors(self, share: float) -> Self:
        """The noise with a share of the floors."""
        lower = {name: share * getattr(self, name) for name in ("floor_delay_std_ns", "floor_angle_std_deg")}
        return self.model_copy(update=lower)

    @property
    def floor(self) -> FloatArray:
        """The part (3, 3) of every R in (m, rad, rad)^2 that is a floor; zero for `fixed`."""
        if self.source == "fixed":
            return np.zeros((3, 3))
        return _diagonal(self.floor_delay_std_ns, self.floor_angle_std_deg)


class HeightConfig(ConfigModel):
    """What is made of the surveyed heights of TX and receiver where the beams show no elevation."""

    use: bool = Field(True, description="cone angles: see paths from above, as level between the known heights")
    std_m: float = Field(0.02, ge=0, description="standard deviation of the height of TX above receiver")


class MappingConfig(ConfigModel):
    """Mapping by equation (4) and the gate for single bounces.

    A path counts as a single bounce where J is below the chi-square quantile (1 degree of freedom) of
    `gate_probability`, the IP is off both devices, and its largest standard deviation is at most
    `max_position_std_m` (nearly parallel rays do not fix the IP along them).
    """

    noise: PathNoise = PathNoise()
    gate_probability: float = Field(
        0.99, gt=0, lt=1, description="probability that a single bounce passes the gate"
    )
    use_elevation: bool = Field(True, description="map in space where elevations were estimated")
    max_position_std_m: float = Field(1.0, gt=0, description="a less certain incidence point is no inlier")


class PathLoss(ConfigModel):
    """Power of a line of sight: intercept + slope * log10(d / 1 m), with a Gaussian spread.

    A path is no credible line of sight where the log-likelihood of its power is below `min_log_likelihood`.
    The defaults are those of the measured campaign, arXiv 2404.10291.

    All other paths lose `reflection_loss_db` more, with standard deviations `reflection_std_db` per path and
    `level_std_db` common to all. Power against length is weak evidence of the clock bias (statistical method).
    """

    intercept_dbm: float = Field(
        -13.0, description="line-of-sight power at 1 m; by default that of the campaign's link"
    )
    slope_db: float = Field(-17.0, description="line-of-sight power per decade of distance; by default free space")
    std_db: float = Field(1.8, gt=0, description="standard deviation of the line-of-sight power")
    min_log_likelihood: float = Field(
        -10.8, description="a path whose power is less likely is no credible line of sight"
    )
    reflection_loss_db: float = Field(10.0, description="what all other paths lose beyond the line of sight")
    reflection_std_db: float = Field(5.0, gt=0, description="its standard deviation per path")
    level_std_db: float = Field(3.0, gt=0, description="its standard deviation common to all paths of a stop")

    def expected_dbm(self, distance_m: FloatArray) -> FloatArray:
        """Power of a line of sight of that length."""
        return np.asarray(self.intercept_dbm + self.slope_db * np.log10(np.maximum(distance_m, 1e-3)))

    def log_density(self, power_dbm: FloatArray, distance_m: FloatArray) -> FloatArray:
        """Log density of the power of a line of sight of that length."""
        deviation = (power_dbm - self.expected_dbm(distance_m)) / self.std_db
        return np.asarray(-0.5 * deviation**2 - np.log(np.sqrt(2 * np.pi) * self.std_db))

    def is_credible(self, power_dbm: float, distance_m: float) -> bool:
        """Whether a received power fits a line of sight of that length."""
        density = self.log_density(np.asarray(power_dbm), np.asarray(distance_m))
        return bool(density >= self.min_log_likelihood)

    def log_density_of_others(self, power_dbm: FloatArray, length_m: FloatArray) -> FloatArray:
        """Log density (...) of the powers of all other paths (path,) of lengths (..., path)."""
        n = power_dbm.shape[-1]
        excess = power_dbm - self.expected_dbm(length_m) + self.reflection_loss_db
        level = excess.mean(axis=-1, keepdims=True) if n else np.zeros((*length_m.shape[:-1], 1))
        own, common = self.reflection_std_db**2, self.level_std_db**2
        square = np.sum((excess - level) ** 2, axis=-1) / own + n * level[..., 0] ** 2 / (own + n * common)
        spread = n * np.log(2 * np.pi * own) + np.log1p(n * common / own)
        return np.asarray(-0.5 * (square + spread))


class Mixture(ConfigModel):
    """Mixture model of the paths that are no line of sight, for the statistical method.

    A single bounce has a Student-t residual, scaled by the covariance of the path. A bounce off two walls that are
    perpendicular or parallel has parallel directions of departure and arrival;
    `double_share` 0 excludes it. Clutter has any angles, and a range uniform over `clutter_width_m`.
    """

    clutter_share: float = Field(0.2, gt=0, lt=1, description="share of the paths that fit nothing")
    double_share: float = Field(
        0.0, ge=0, lt=1, description="share of bounces off two perpendicular or parallel walls; 0 excludes them"
    )
    clutter_width_m: float = Field(30.0, gt=0, description="width of the range of clutter")
    degrees_of_freedom: int = Field(3, ge=1, description="of the Student-t residual of a single bounce")

    @model_validator(mode="after")
    def _check_shares(self) -> Mixture:
        if self.clutter_share + self.double_share >= 1:
            total = self.clutter_share + self.double_share
            raise ValueError(f"clutter_share + double_share = {total:g}: must be below 1")
        return self


class Consider(ConfigModel):
    """Errors of the set-up that no stop can show: they only widen its covariance.

    A pointing error of the TX turns the whole solution about the TX; the survey error is that of the TX position;
    the heading error is that of the true receiver headings which states are compared with.
    """

    pointing_std_deg: float = Field(0.0, ge=0, description="pointing error of the TX")
    survey_std_m: float = Field(0.0, ge=0, description="error of the TX position")
    heading_std_deg: float = Field(
        0.0, ge=0, description="error of the true headings that states are compared with"
    )

    def covariance(self, from_tx_m: FloatArray) -> FloatArray:
        """Covariance (..., state, state) to add to that of states at offsets (..., 2 or 3) from the TX.

        States are [x, y, heading, bias] or [x, y, z, heading, bias].
        """
        x, y = from_tx_m[..., 0], from_tx_m[..., 1]
        if not (self.pointing_std_deg or self.survey_std_m or self.heading_std_deg):
            return np.zeros((*x.shape, from_tx_m.shape[-1] + 2, from_tx_m.shape[-1] + 2))
        survey = np.full(from_tx_m.shape[-1], self.survey_std_m)
        level = np.zeros((*x.shape, len(survey) - 2))
        turn = np.concatenate(
            [np.stack([-y, x], axis=-1), level, np.ones((*x.shape, 1)), np.zeros((*x.shape, 1))], -1
        )
        pointing = np.deg2rad(self.pointing_std_deg) ** 2 * turn[..., :, None] * turn[..., None, :]
        heading = np.deg2rad(self.heading_std_deg)
        rest = np.diag([*survey, heading, 0.0]) ** 2
        return np.asarray(pointing + rest)


class SnapshotConfig(ConfigModel):
    """Robust snapshot SLAM: the statistical method by default, or the published algorithm, arXiv 2404.10291.

    The defaults of the path loss, of the heading grid and of the gates of `reference` are the published ones.

    `method`
        `reference`: heading grid, power weights, distance gate, as published; always in the plane. Smoother and
        filter of a walk need modes ranked by evidence: they use the statistical method in the plane.
        `statistical`: closed-form headings, each path gated and weighted by its own covariance; in space where
        elevations were estimated.
    `refine`
        Maximum-likelihood refinement of the reference solution on its inliers; the statistical method always
        refines.
    `max_position_std_m`
        A stop fails where its best mode is less certain. Nearly parallel paths, as along a corridor, do not
        separate clock bias and distance, and give many false modes. In simulated halls and corridors most gross
        errors, but hardly any correct mode, exceed the default. Overstated path errors increase it in proportion.
    `reach_m`
        Prior standard deviation of the receiver's position about the TX.
    """

    method: Literal["reference", "statistical"] = Field(
        "statistical", description="published algorithm, or mixture model with evidence"
    )
    refine: bool = Field(False, description="reference: maximum-likelihood refinement on the inliers")
    use_elevation: bool = Field(
        True, description="solve in space where elevations were estimated (statistical method only)"
    )
    path_loss: PathLoss = PathLoss()

    n_headings: int = Field(361, ge=2, description="reference: headings tried on the full circle")
    gate_m2: float = Field(0.1, gt=0, description="reference: largest squared residual of an inlier")

    noise: PathNoise = PathNoise()
    mixture: Mixture = Mixture()
    reach_m: float = Field(
        20.0, gt=0, description="prior standard deviation of the receiver's position about the TX"
    )
    gate_probability: float = Field(
        0.997, gt=0, lt=1, description="statistical: probability that a path passes the gate"
    )
    ambiguous_gap: float = Field(
        6.0, ge=0, description="a smaller gap in log evidence to the next mode makes a stop ambiguous"
    )
    consider: Consider = Consider()
    tx_sync_std_ns: float | None = Field(
        None,
        gt=0,
        description="several TX: standard deviation of the clock of each; without it every clock is free",
    )
    max_clock_bias_ns: float = Field(300.0, gt=0, description="a larger clock bias is not credible")
    max_position_std_m: float = Field(1.5, gt=0, description="a stop less certain than this has failed")

    @property
    def solves_in_space(self) -> bool:
        """Whether estimated elevations are used: the published algorithm is planar."""
        return self.use_elevation and self.method == "statistical"

    @property
    def max_clock_bias_m(self) -> float:
        """Largest credible clock bias as a length."""
        return self.max_clock_bias_ns * 1e-9 * SPEED_OF_LIGHT_M_S

    @property
    def prior_std(self) -> FloatArray:
        """Prior standard deviations (4,) in m, m, rad, m from the TX: any heading, any credible clock."""
        uniform = np.array([np.pi, self.max_clock_bias_m]) / np.sqrt(3)
        return np.array([self.reach_m, self.reach_m, *uniform])


class TrajectoryConfig(ConfigModel):
    """All stops of a walk together, by the smoother or by the filter, or every stop alone.

    `method`
        `smooth`: all stops at once, shared landmarks. `filter`: every stop from itself and earlier stops, for
        online use, with modes and motion prior only. `single`: every stop alone. `auto`: `smooth` where the stops
        follow one another, else `single`.

    The motion prior is a Student-t law of the second difference of the position, in m per stop squared:
    `cross_track_std_m` across the walk, `along_track_std_m` along it. So the spacing of the stops need not be
    known, nor be even.

    The scales describe stops placed by hand at uneven distances, turns between them, a free-running clock, and
    surfaces that deviate from a plane or a circle. They are not fitted to measured data: `arena validate slam`
    halves and doubles each on simulated walks, and no such change gains much over the default.

    `wall_roughness_m`, `object_roughness_m`
        Where the evidence allows it, they fall with the floors of `PathNoise`, by the root of the same share.

    `use_landmarks`, `use_double_bounces`, `use_sessions`
        Share walls and objects between stops; use double bounces off two known walls; search for jumps of the TX
        heading offset.
    """

    method: Literal["auto", "smooth", "filter", "single"] = Field(
        "auto",
        description="all stops at once, each from earlier ones, or alone; auto: at once if one follows another",
    )
    use_landmarks: bool = Field(True, description="walls and pillars seen from several stops are shared")
    use_double_bounces: bool = Field(True, description="bounces off two walls are used where both walls are known")
    use_sessions: bool = Field(True, description="the TX may have been turned during the walk")
    degrees_of_freedom: int = Field(4, ge=1, description="of the Student-t residual of a path")
    cross_track_std_m: float = Field(
        0.1, gt=0, description="second difference of the position across the walk, per stop squared"
    )
    along_track_std_m: float = Field(
        0.5, gt=0, description="second difference of the position along the walk, per stop squared"
    )
    motion_degrees_of_freedom: float = Field(2.0, gt=0, description="of the Student-t law of the motion")
    spacing_m: float | None = Field(None, gt=0, description="distance between stops, where it is known")
    heading_step_deg: float = Field(10.0, gt=0, description="scale of the change of heading between stops")
    clock_step_ns: float = Field(3.3, gt=0, description="scale of the change of clock bias between stops")
    gate_probability: float = Field(0.997, gt=0, lt=1, description="probability that a path passes the gate")

    confirm_probability: float = Field(
        0.99, gt=0, lt=1, description="gate of a lone bounce, tested against all other paths"
    )

    cluster_eps_m: float = Field(0.6, gt=0, description="neighbourhood radius of DBSCAN for landmarks")
    cluster_min_samples: int = Field(5, ge=2, description="points within the radius that make a core point")
    max_object_extent_m: float = Field(1.5, gt=0, description="a larger cluster is no small object")
    wall_roughness_m: float = Field(0.03, ge=0, description="standard deviation of a wall about its line")
    object_roughness_m: float = Field(
        0.08, ge=0, description="standard deviation of a small object about its circle"
    )
    object_radius_m: float = Field(0.2, ge=0, description="prior mean of the radius of a small object")
    object_radius_std_m: float = Field(0.2, gt=0, description="prior standard deviation of that radius")

    offset_std_deg: float = Field(
        5.0, gt=0, description="prior of the TX heading offset of a session: stops between turns of the TX"
    )
    min_session_gain: float = Field(10.0, gt=0, description="gain in log evidence that an offset needs")

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
