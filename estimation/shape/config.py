"""Settings of clustering, of the Gaussian-process shapes of the paper, and of our contours."""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field

from estimation.shape.reflection.reflections import ReflectionConfig
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
    ] = Field("reflection", description="method of the contours; none for none")
    eps_m: float = Field(0.6, gt=0, description="neighbourhood radius of DBSCAN in m, for candidate objects")
    min_samples: int = Field(5, ge=1, description="IPs within eps_m, itself included, that make a core point")
    reflection: ReflectionConfig = ReflectionConfig()
    learn_noise: bool = Field(
        True, description="scale the covariances of the paths by their residuals, over all paths and per object"
    )
    survey_position_std_m: float = Field(0.05, gt=0, description="given poses: standard deviation of x and y")
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
