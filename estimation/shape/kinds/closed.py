"""Closed contours fitted directly to delays and angles: contour, TX and RX determine every path.

No incidence points are needed: the contour predicts each delay and both angles, and is fitted to them with their
covariances (`estimation.shape.reflection.posterior`). The kinds are circle, ellipse, rounded square, and a
Gaussian process on the support function, whose harmonics have the variances of the periodic squared-exponential
kernel.
"""

from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ive

from estimation.laws.support import CIRCLE, CLOSED_FAMILY, contour_points, normal_std_m
from estimation.shape.config import ReflectionConfig
from estimation.shape.fit import OK, PRIOR, ShapeFit
from estimation.shape.record import N_CONTOUR_SAMPLES
from estimation.shape.reflection.posterior import Optimum, Prior, best_start, maximise_posterior
from estimation.shape.reflection.reflections import Reflections, ray_points
from scenes.record import FloatArray

START_RADII_M = np.geomspace(0.06, 2.0, 10)
PRIOR_SHARE = 0.9  # of the prior's standard deviation: above it the paths hold no information on the radius
# Support GP: no campaign chooses it, so these are no settings. The values suit pillars of the library scenes.
HARMONIC_STD = 0.15  # of h / R - 1
HARMONIC_LENGTH = 0.8  # length scale of the periodic kernel
N_HARMONICS = 6
_TURN_STEP_RAD = np.pi / 8  # between the starts of a rounded square: four in a quarter turn


def fit_closed(kind: str, data: Reflections, config: ReflectionConfig) -> Optimum | None:
    """The optimum of highest evidence over the starts of one kind; all other kinds start from the circle."""
    circle_prior = closed_prior("circle", np.zeros(3), config)
    start = best_start(CIRCLE, circle_starts(data, START_RADII_M), circle_prior, data, config)
    circle = maximise_posterior(CIRCLE, start, circle_prior, data, config)
    if kind == "circle" or circle is None:
        return circle
    optima = []
    places = (circle.parameter, circle_starts(data, [config.radius_median_m])[0])
    for place, shape in product(places, _shape_starts(kind, config)):
        start = np.concatenate([place, shape])
        prior = closed_prior(kind, start, config)
        found = maximise_posterior(CLOSED_FAMILY[kind], start, prior, data, config, refreshes=1)
        if found is not None:
            optima.append((found, prior))
    if not optima:
        return None
    best, prior = max(optima, key=lambda pair: pair[0].log_evidence)
    if not np.any(data.rx_covariance):
        return best
    return maximise_posterior(CLOSED_FAMILY[kind], best.parameter, prior, data, config)


def refit_closed(kind: str, known: FloatArray, data: Reflections, config: ReflectionConfig) -> Optimum | None:
    """The optimum from that under another prior of the radius; the turn keeps the prior of its start."""
    start = known.copy()
    if kind == "rounded_square":
        start[4] = (np.floor(known[4] / _TURN_STEP_RAD) + 0.5) * _TURN_STEP_RAD
    return maximise_posterior(CLOSED_FAMILY[kind], known, closed_prior(kind, start, config), data, config)


def closed_prior(kind: str, start: FloatArray, config: ReflectionConfig) -> Prior:
    """Prior of [x, y, log R, shape ...]: the centre uniform over the area, the others Gaussian.

    The turn of a rounded square is uniform over a quarter turn; a Gaussian of the same variance about its start
    replaces that.
    """
    mean, std = [np.log(config.radius_median_m)], [config.radius_log_std]
    if kind == "ellipse":
        mean, std = [*mean, 0.0, 0.0], [*std, *2 * [config.axis_ratio_log_std]]
    elif kind == "rounded_square":
        mean = [*mean, _log_odds(config.round_share_median), start[4]]
        std = [*std, config.round_share_log_odds_std, np.pi / 2 / np.sqrt(12)]
    elif kind == "support_gp":
        spread = np.repeat(harmonic_std(), 2)
        mean, std = [*mean, *np.zeros(len(spread))], [*std, *spread]
    return Prior(
        mean=np.array([0.0, 0.0, *mean]),
        precision=np.array([0.0, 0.0, *np.array(std) ** -2.0]),
        flat_width=np.array([*2 * [np.sqrt(config.area_m2)], *np.ones(len(mean))]),
    )


def harmonic_std() -> FloatArray:
    """Standard deviation (harmonic,) of the cosine and sine coefficients of h / R from the second harmonic on.

    The periodic kernel exp(-2 sin^2(d / 2) / l^2) has the Fourier weights 2 I_k(1 / l^2) exp(-1 / l^2). The
    harmonics 0 and 1 are the radius and the centre; the others are scaled to `HARMONIC_STD` in total.
    """
    weight = ive(np.arange(2, N_HARMONICS + 1), HARMONIC_LENGTH**-2.0)
    return np.asarray(HARMONIC_STD * np.sqrt(weight / weight.sum()))


def closed_shape(kind: str, found: Optimum, data: Reflections, config: ReflectionConfig) -> ShapeFit:
    """The record of a fitted closed contour."""
    family, parameter, covariance = CLOSED_FAMILY[kind], found.parameter, found.parameter_covariance
    psi = np.linspace(-np.pi, np.pi, N_CONTOUR_SAMPLES, endpoint=False)
    log_std = float(np.sqrt(covariance[2, 2]))
    radius = float(np.exp(parameter[2]))
    return ShapeFit(
        kind=kind,
        status=OK if log_std < PRIOR_SHARE * config.radius_log_std else PRIOR,
        is_closed=True,
        contour_m=contour_points(family, parameter, psi),
        std_m=normal_std_m(family, parameter, covariance, psi),
        log_evidence=found.log_evidence,
        parameter=parameter,
        parameter_covariance=covariance,
        parameter_name=np.array(parameter_names(kind, len(parameter))),
        extent_m=radius,
        extent_std_m=radius * log_std,
    )


def parameter_names(kind: str, n: int) -> list[str]:
    """Names of the parameters of a closed contour, units included."""
    shape = {
        "circle": [],
        "ellipse": ["log_axis_ratio_cos", "log_axis_ratio_sin"],
        "rounded_square": ["round_share_log_odds", "turn_rad"],
        "support_gp": [f"{part}_{k // 2 + 2}" for k, part in enumerate((n - 3) // 2 * ["cos", "sin"])],
    }
    return ["center_x_m", "center_y_m", "log_radius", *shape[kind]]


def circle_starts(data: Reflections, radii_m: ArrayLike) -> FloatArray:
    """Circles (start, 3) of the given radii (start,), each with the median centre over rays and bisectors.

    A median withstands ghosts up to half of the paths.
    """
    point, normal = ray_points(data)
    outward = np.column_stack([np.cos(normal), np.sin(normal)])
    radius = np.asarray(radii_m, float)
    center = np.median(point - radius[:, None, None] * outward, axis=1)
    return np.column_stack([center, np.log(radius)])


def _shape_starts(kind: str, config: ReflectionConfig) -> list[FloatArray]:
    if kind == "ellipse":
        return [0.4 * np.array([np.cos(turn), np.sin(turn)]) for turn in np.arange(4) * np.pi / 2]
    if kind == "rounded_square":
        odds = _log_odds(config.round_share_median)
        return [np.array([odds, turn]) for turn in (np.arange(4) + 0.5) * _TURN_STEP_RAD]
    return [np.zeros(2 * (N_HARMONICS - 1))]


def _log_odds(share: float) -> float:
    return float(np.log(share / (1 - share)))
