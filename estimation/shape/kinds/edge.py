"""Edge points: corners and door jambs, which reflect every ray at the same point."""

import numpy as np

from estimation.laws.contour import EDGE
from estimation.shape.config import ReflectionConfig
from estimation.shape.fit import OK, ShapeFit
from estimation.shape.reflection.posterior import Optimum, Prior, best_start, maximise_posterior
from estimation.shape.reflection.reflections import Reflections, ray_points
from scenes.record import FloatArray

_N_STARTS = 8


def edge_shape(found: Optimum, data: Reflections, config: ReflectionConfig) -> ShapeFit:
    """The record of a fitted edge point; `std_m` is the root of the mean variance of x and y."""
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


def fit_edge(data: Reflections, config: ReflectionConfig) -> Optimum | None:
    """The most likely [x, y]. It starts at the best of some points of the rays and their median."""
    point, _ = ray_points(data)
    some = point[np.unique(np.linspace(0, len(point) - 1, _N_STARTS).astype(int))]
    starts = np.vstack([np.median(point, axis=0), some])
    prior = edge_prior(starts[0], config)
    return maximise_posterior(EDGE, best_start(EDGE, starts, prior, data, config), prior, data, config)


def edge_prior(start: FloatArray, config: ReflectionConfig) -> Prior:
    """Prior of [x, y]: uniform over the area."""
    return Prior(np.zeros(2), np.zeros(2), np.full(2, np.sqrt(config.area_m2)))
