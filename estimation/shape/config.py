"""Settings of clustering, of the Gaussian-process shapes of the paper, and of our contours."""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field

from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray
from scenes.toml_config import ConfigModel, Pair


class CentroidBias(ConfigModel):
    """A shift of the centre of one cluster, set by hand: it moves the centre of a wall off the wall (section IV).

    It applies to the cluster whose centroid is nearest to `near_m`, if that is within `within_m`. A place and
    not a number names the cluster, because numbers change with the other clusters.
    """

    near_m: Pair = Field(description="place of the cluster, x and y in m")
    bias_m: Pair = Field(description="added to the centroid, x and y in m")
    within_m: float = Field(2.0, gt=0, description="largest distance from near_m to the centroid in m")


class ShapeConfig(ConfigModel):
    """Clusters of incidence points (IPs) by DBSCAN, and a radial Gaussian process for each.

    The defaults correct three weaknesses of the printed method; `start`, `mean_uncertainty` and `noise_floor`
    switch the corrections off, `ShapeConfig.paper` all of them.
    """

    eps_m: float = Field(0.6, gt=0, description="neighbourhood radius of DBSCAN in m")
    min_samples: int = Field(5, ge=1, description="IPs within eps_m, itself included, that make a core point")
    biases: Annotated[tuple[CentroidBias, ...], Field(strict=False)] = Field(
        (), description="shifts of cluster centres, set by hand"
    )
    start: Literal["paper", "data"] = Field(
        "data",
        description="start of the likelihood search: 'paper' is l = sigma_f = sigma_n = 2, which often ends "
        "where everything is noise; 'data' keeps the best of three starts taken from the data",
    )
    mean_uncertainty: bool = Field(
        True, description="add the variance of the learned mean radius to the predicted variance"
    )
    noise_floor: bool = Field(
        True, description="keep sigma_n at or above the radial standard deviation the IP covariances give"
    )
    n_samples: int = Field(360, ge=3, description="samples of each contour on the full circle")

    @classmethod
    def paper(cls, **changes: object) -> Self:
        """The method exactly as printed in section III; `changes` set the other fields."""
        printed: dict[str, object] = {"start": "paper", "mean_uncertainty": False, "noise_floor": False}
        return cls.model_validate(printed | changes)


class ReflectionConfig(ConfigModel):
    """Priors of the fits by the reflection law. A standard deviation of 0 fixes that unknown."""

    radius_median_m: float = Field(0.45, gt=0, description="median of the log-normal prior of the radius in m")
    radius_log_std: float = Field(0.5, gt=0, description="standard deviation of the logarithm of the radius")
    axis_ratio_log_std: float = Field(
        0.6, gt=0, description="ellipse: standard deviation of either part of the log axis ratio"
    )
    round_share_median: float = Field(
        0.25, gt=0, lt=1, description="rounded square: median of the corner radius over half the width"
    )
    round_share_log_odds_std: float = Field(1.0, gt=0, description="rounded square: of its log odds")
    pillars_resemble: bool = Field(
        True, description="the other pillars of the scene give the prior of the radius and kind of a pillar"
    )
    bend_radius_median_m: float = Field(6.0, gt=0, description="curved wall: median of the log-normal radius")
    bend_radius_log_std: float = Field(0.8, gt=0, description="curved wall: of the logarithm of the radius")
    wall_relief_m: float = Field(
        0.03, gt=0, description="standard deviation in m of the places of a rough wall about its line"
    )
    area_m2: float = Field(400.0, gt=0, description="area in m^2 over which centres and edges are uniform")
    delay_offset_std_ns: float = Field(1.0, ge=0, description="common error of all delays in ns")
    aod_offset_std_deg: float = Field(3.0, ge=0, description="common error of a session's departures in deg")
    aoa_offset_std_deg: float = Field(3.0, ge=0, description="common error of all arrivals in deg")
    ghost_share: float = Field(0.05, ge=0, lt=1, description="prior share of paths that belong to no object")
    ghost_range_m: float = Field(20.0, gt=0, description="ghosts: uniform over this window of range in m")
    ghost_angle_deg: float = Field(60.0, gt=0, le=360, description="ghosts: uniform over this window of angles")

    @property
    def log_path_share(self) -> float:
        """Logarithm of the prior share of paths that are no ghosts."""
        return float(np.log1p(-self.ghost_share))

    @property
    def log_ghost_density(self) -> float:
        """Log density of a ghost's range and angles, times its share, per m rad^2; -inf without ghosts."""
        if self.ghost_share == 0:
            return -np.inf
        return float(np.log(self.ghost_share)) + self.log_window_density

    @property
    def log_window_density(self) -> float:
        """Log density of the range and angles of a path that may be anywhere, per m rad^2."""
        return -float(np.log(self.ghost_range_m * np.deg2rad(self.ghost_angle_deg) ** 2))


class ContourConfig(ConfigModel):
    """Contours of objects, in addition to the shapes of the paper.

    `method`
        `reflection`: contours fitted to delays and angles by the reflection law, with all objects, poses and
        common offsets together; kind and class by evidence; ghosts are rejected. `points`: from incidence points
        only; per cluster the marginalised-incidence contour, a line or a line of varying depth, by evidence.
        `none`: no contours. Any other name: that method for points, for comparisons.
    """

    method: Literal[
        "reflection",
        "points",
        "mic",
        "line",
        "depth_line",
        "paper_gp",
        "prior_only",
        "convex_hull",
        "random_matrix",
        "circle",
        "recursive_gp",
        "star_convex_rhm",
        "none",
    ] = Field(
        "reflection",
        description="from delays and angles of all paths at once, or from incidence points by evidence; others: "
        "one model a cluster, to compare with, see docs/method.md",
    )
    eps_m: float = Field(0.6, gt=0, description="neighbourhood radius of DBSCAN in m, for candidate objects")
    min_samples: int = Field(5, ge=1, description="IPs within eps_m, itself included, that make a core point")
    reflection: ReflectionConfig = ReflectionConfig()
    learn_noise: bool = Field(
        True,
        description="scale covariances: of paths by their residuals, over all paths and per object; "
        "of given poses by lines of sight",
    )
    survey_position_std_m: float = Field(
        0.05, gt=0, description="given poses: standard deviation of x and y, at first"
    )
    survey_heading_std_deg: float = Field(1.0, gt=0, description="of their heading")
    survey_clock_std_ns: float = Field(0.1, gt=0, description="of their clock bias")
    slam_widening: float = Field(
        3.0, ge=1, description="factor on the standard deviations of poses found from the same paths by SLAM"
    )

    @property
    def survey_std(self) -> FloatArray:
        """Standard deviations (4,) of a given state in m, m, rad, m."""
        clock_m = 1e-9 * SPEED_OF_LIGHT_M_S * self.survey_clock_std_ns
        position = self.survey_position_std_m
        return np.array([position, position, np.deg2rad(self.survey_heading_std_deg), clock_m])
