"""Slightly curved walls: the illuminated arc of a large circle; its convex side faces the devices."""

import numpy as np

from estimation.laws.contour import predict_reflection
from estimation.laws.support import CIRCLE, contour_points, normal_std_m
from estimation.shape.config import ReflectionConfig
from estimation.shape.fit import OK, ShapeFit
from estimation.shape.kinds.closed import circle_starts
from estimation.shape.record import N_CONTOUR_SAMPLES
from estimation.shape.reflection.posterior import Optimum, Prior, best_start, maximise_posterior
from estimation.shape.reflection.reflections import Reflections
from scenes.record import FloatArray

_START_RADII_M = np.geomspace(1.0, 30.0, 8)


def arc_shape(found: Optimum, data: Reflections, config: ReflectionConfig) -> ShapeFit:
    """The record of a fitted curved wall over the part that its paths illuminate."""
    paths = predict_reflection(CIRCLE, found.parameter, data.tx, data.rx_state)
    member = (found.inlier > 0.5) & paths.is_lit
    normal = paths.normal_rad[member if member.any() else slice(None)]
    middle = np.arctan2(np.sin(normal).mean(), np.cos(normal).mean())
    turn = (normal - middle + np.pi) % (2 * np.pi) - np.pi
    psi = middle + np.linspace(turn.min(), turn.max(), N_CONTOUR_SAMPLES)
    radius = float(np.exp(found.parameter[2]))
    angle = float(np.ptp(turn))
    return ShapeFit(
        kind="arc",
        status=OK,
        is_closed=False,
        contour_m=contour_points(CIRCLE, found.parameter, psi),
        std_m=normal_std_m(CIRCLE, found.parameter, found.parameter_covariance, psi),
        log_evidence=found.log_evidence,
        parameter=found.parameter,
        parameter_covariance=found.parameter_covariance,
        parameter_name=np.array(["center_x_m", "center_y_m", "log_radius"]),
        extent_m=radius * angle,
        extent_std_m=radius * angle * float(np.sqrt(found.parameter_covariance[2, 2])),
    )


def fit_arc(data: Reflections, config: ReflectionConfig) -> Optimum | None:
    """The most likely [x, y, log R] of the circle of a curved wall."""
    starts = circle_starts(data, _START_RADII_M)
    prior = arc_prior(starts[0], config)
    start = best_start(CIRCLE, starts, prior, data, config)
    return maximise_posterior(CIRCLE, start, prior, data, config)


def arc_prior(start: FloatArray, config: ReflectionConfig) -> Prior:
    """Prior of [x, y, log R]: the centre uniform over the area, the radius log-normal and large."""
    mean = np.array([0.0, 0.0, np.log(config.bend_radius_median_m)])
    width = np.array([*2 * [np.sqrt(config.area_m2)], 1.0])
    return Prior(mean, np.array([0.0, 0.0, config.bend_radius_log_std**-2]), width)
