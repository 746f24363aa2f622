"""Gently bent walls: the lit arc of a large circle, its convex side to the devices."""

from __future__ import annotations

import numpy as np

from estimation.laws.support import CIRCLE, contour_points, normal_std_m
from estimation.shape.fit import OK, ShapeFit, failed_fit
from estimation.shape.kinds.closed import circle_starts
from estimation.shape.reflection.posterior import Optimum, Prior, best_start, maximise
from estimation.shape.reflection.reflections import ReflectionConfig, Reflections

_START_RADII_M = np.geomspace(1.0, 30.0, 8)


def fit_arc(data: Reflections, config: ReflectionConfig) -> ShapeFit:
    """Fit a bent wall to the paths of one object; its contour runs over the lit part, end to end.

    `parameter` is [x, y, log R] of its circle in m. The status is `failed` where there is no path.
    """
    if len(data) == 0:
        return failed_fit("arc", "no paths")
    found = fit_bent(data, config)
    return failed_fit("arc", "singular information") if found is None else arc_shape(found, config)


def arc_shape(found: Optimum, config: ReflectionConfig) -> ShapeFit:
    """The record of a fitted bent wall over the part that its paths light."""
    member = (found.inlier > 0.5) & found.paths.is_lit
    normal = found.paths.normal_rad[member if member.any() else slice(None)]
    middle = np.arctan2(np.sin(normal).mean(), np.cos(normal).mean())
    turn = (normal - middle + np.pi) % (2 * np.pi) - np.pi
    psi = middle + np.linspace(turn.min(), turn.max(), config.n_samples)
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


def fit_bent(data: Reflections, config: ReflectionConfig) -> Optimum | None:
    """The most likely [x, y, log R] of a bent wall's circle."""
    prior = arc_prior(config)
    start = best_start(CIRCLE, circle_starts(data, _START_RADII_M), prior, data, config)
    return maximise(CIRCLE, start, prior, data, config)


def arc_prior(config: ReflectionConfig) -> Prior:
    """Prior of [x, y, log R]: the circle anywhere in the area, its radius log-normal and large."""
    mean = np.array([0.0, 0.0, np.log(config.bend_radius_median_m)])
    width = np.array([*2 * [np.sqrt(config.area_m2)], 1.0])
    return Prior(mean, np.array([0.0, 0.0, config.bend_radius_log_std**-2]), width)
