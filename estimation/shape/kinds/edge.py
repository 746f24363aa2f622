"""Edge points: corners and door jambs, which send every ray on from the same place."""

from __future__ import annotations

import numpy as np

from estimation.laws.contour import EDGE
from estimation.shape.fit import OK, ShapeFit, failed_fit
from estimation.shape.reflection.posterior import Optimum, Prior, best_start, maximise
from estimation.shape.reflection.reflections import ReflectionConfig, Reflections, ray_points

_N_STARTS = 8


def fit_edge(data: Reflections, config: ReflectionConfig) -> ShapeFit:
    """Fit one point to the paths of one object; `parameter` is [x, y] in m, the contour the point itself.

    `std_m` is the root of the mean variance of x and y. The status is `failed` where there is no path.
    """
    if len(data) == 0:
        return failed_fit("edge", "no paths")
    found = fit_point(data, config)
    if found is None:
        return failed_fit("edge", "singular information")
    return edge_shape(found)


def edge_shape(found: Optimum) -> ShapeFit:
    """The record of a fitted edge point."""
    covariance = found.parameter_covariance
    return ShapeFit(
        kind="edge",
        status=OK,
        is_closed=False,
        contour_m=found.parameter[None],
        std_m=np.array([np.sqrt(np.trace(covariance) / 2)]),
        log_evidence=found.log_evidence,
        parameter=found.parameter,
        parameter_covariance=covariance,
        parameter_name=np.array(["x_m", "y_m"]),
        extent_m=0.0,
        extent_std_m=0.0,
    )


def fit_point(data: Reflections, config: ReflectionConfig) -> Optimum | None:
    """The most likely edge point, from the best of the median of the rays' points and some of those points."""
    prior = point_prior(config)
    point, _ = ray_points(data)
    some = point[np.unique(np.linspace(0, len(point) - 1, _N_STARTS).astype(int))]
    starts = np.vstack([np.median(point, axis=0), some])
    return maximise(EDGE, best_start(EDGE, starts, prior, data, config), prior, data, config)


def point_prior(config: ReflectionConfig) -> Prior:
    """Prior of [x, y]: anywhere in the area."""
    return Prior(np.zeros(2), np.zeros(2), np.full(2, np.sqrt(config.area_m2)))
