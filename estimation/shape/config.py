"""Parameters of clustering and Gaussian-process shape estimation."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field

from scenes.toml_config import ConfigModel, Pair


class CentroidBias(ConfigModel):
    """A shift of one cluster's centre, set by hand: it moves a wall's centre off the wall (paper, section IV).

    The cluster is named by a place, not by a number, so that the bias stays with its object when other
    clusters come or go. It is the cluster whose centroid is nearest to `near_m`; where none lies within
    `within_m` the bias is not used.
    """

    near_m: Pair = Field(description="place of the cluster, x and y in m")
    bias_m: Pair = Field(description="added to the centroid, x and y in m")
    within_m: float = Field(2.0, gt=0, description="largest distance from near_m to the centroid in m")


class ShapeConfig(ConfigModel):
    """Clusters of incidence points (IPs) by DBSCAN, a radial Gaussian process for each.

    The defaults correct three weaknesses of the printed method, each with its own switch; `ShapeConfig.paper`
    has them all off.
    """

    eps_m: float = Field(0.6, gt=0, description="neighbourhood radius of DBSCAN in m")
    min_samples: int = Field(5, ge=1, description="IPs within eps_m, itself included, that make a core point")
    biases: Annotated[tuple[CentroidBias, ...], Field(strict=False)] = Field(
        (), description="shifts of cluster centres, set by hand"
    )
    start: Literal["paper", "data"] = Field(
        "data",
        description="start of the likelihood search: 'paper' is l = sigma_f = sigma_n = 2, which often ends "
        "where all is noise; 'data' keeps the best of three starts taken from the data",
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
