"""Marginalised-incidence contour (MIC): a free-centre contour of points seen from one side.

The contour is star-convex: x(t) = c + R exp(sum_k>=2 a_k cos k t + b_k sin k t) (cos t, sin t). Its centre and
mean radius replace the harmonics 1 and 0 of a radial Gaussian process; the others have the spectrum of its
periodic kernel. The unknown place of a point on the contour is integrated out over a von Mises density about the
direction of the sensor. The share of outliers and the scale of the covariances are learned.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, ive, log_expit, logit, logsumexp

from estimation.execution import one_blas_thread
from estimation.shape.fit import OK, PRIOR, ShapeFit
from estimation.shape.points.cluster import PointCluster, ring_normals
from estimation.shape.points.mic_likelihood import log_likelihood
from scenes.record import FloatArray

N_NODES = 90
START_RADII_M = (0.3, 0.7)
N_RADII = 5
GRADIENT_TOLERANCE_NAT = 1e-2  # per standard deviation of the parameters, about
DIFFERENCE_STEP = 1e-4
CENTER_X, CENTER_Y, LOG_RADIUS, LOG_SCALE, LOG_VISIBLE, LOGIT_OUTLIER, FIRST_HARMONIC = range(7)


@dataclass(frozen=True)
class MicPrior:
    """Prior of a pillar."""

    radius_m: float = 0.5
    log_radius_std: float = 0.3
    behind_radii: float = 0.8  # centre behind the middle of the points, in radii of the prior
    center_std_m: float = 0.5
    highest_harmonic: int = 6
    shape_std: float = 0.07  # of the log radius, all harmonics of the kernel together
    length_scale: float = 0.5
    log_noise_scale_std: float = 0.3
    visible_concentration: float = 3.5  # of the von Mises density over the visible side: about +-60 deg
    log_concentration_std: float = 0.4
    outlier_share: float = 0.05
    logit_outlier_share_std: float = 1.0
    outlier_margin_m: float = 0.5  # outliers are uniform over the bounding box of the points with this margin


class _Mode(NamedTuple):
    """The most probable parameters at one node, their covariance, and the log of the probability mass."""

    parameter: FloatArray
    covariance: FloatArray
    log_mass: float


def fit_mic(points: PointCluster, prior: MicPrior = MicPrior()) -> ShapeFit:
    """Posterior mean contour of a cluster of points.

    Gauss-Hermite quadrature integrates over the log radius about its most probable value, Laplace's method over
    the other parameters at each node, because the centre and the radius of a short arc are far from jointly
    normal. The status is `prior` where the points do not reduce the uncertainty of the radius. Without a sensor
    position the whole contour is visible.
    """
    model = _Model(points, prior)
    with one_blas_thread():
        best = min((_minimise(model, start) for start in model.starts()), key=lambda found: found[0])[1]
        return _mixed(model, _radius_modes(model, best))


def _minimise(model: _Model, start: FloatArray, fixed: bool = False) -> tuple[float, FloatArray]:
    """Least negative log posterior and its parameters, with the log radius `fixed` if asked."""
    bounds = [(value, value) if fixed and k == LOG_RADIUS else (None, None) for k, value in enumerate(start)]
    found = minimize(
        model.negative_log_posterior,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"gtol": GRADIENT_TOLERANCE_NAT},
    )
    return float(found.fun), np.asarray(found.x)


def _radius_modes(model: _Model, best: FloatArray) -> list[_Mode]:
    """The posterior as a mixture over the nodes of the log radius; the sum of the masses is the evidence."""
    covariance = np.linalg.inv(_hessian(model, best))
    std = float(np.sqrt(covariance[LOG_RADIUS, LOG_RADIUS]))
    others = np.flatnonzero(np.arange(len(best)) != LOG_RADIUS)
    modes = []
    for node, weight in zip(*np.polynomial.hermite_e.hermegauss(N_RADII), strict=True):
        start = best + node / std * covariance[LOG_RADIUS]
        value, parameter = _minimise(model, start, fixed=True)
        hessian = _hessian(model, parameter)[np.ix_(others, others)]
        conditional = np.zeros_like(covariance)
        conditional[np.ix_(others, others)] = np.linalg.inv(hessian)
        log_volume = 0.5 * (len(others) * np.log(2 * np.pi) - float(np.linalg.slogdet(hessian)[1]))
        log_width = np.log(std * weight) + 0.5 * node**2
        modes.append(_Mode(parameter, conditional, log_volume + log_width - value))
    return modes


class _Model:
    """Log posterior of the parameters (c_x, c_y, log R, log s, log kappa, logit q, a_2, b_2, ..)."""

    def __init__(self, points: PointCluster, prior: MicPrior) -> None:
        self.points, self.prior = points, prior
        self.angle_rad = np.arange(N_NODES) * (2 * np.pi / N_NODES)
        self.unit = np.stack([np.cos(self.angle_rad), np.sin(self.angle_rad)], axis=1)
        harmonic = np.arange(2.0, prior.highest_harmonic + 1)
        turns = self.angle_rad[:, None] * harmonic
        self.feature = np.stack([np.cos(turns), np.sin(turns)], axis=2).reshape(N_NODES, -1)
        self.mean, self.std = self._prior_moments(harmonic)
        self.precision: FloatArray = np.asarray(np.linalg.inv(points.covariance_m2), np.float64)
        self.log_constant = 0.5 * np.linalg.slogdet(self.precision)[1] - np.log(2 * np.pi)
        self.facing = -self.unit @ points.away  # cosine of the angle to the sensor's direction
        self.log_area = float(np.log(points.area_m2(prior.outlier_margin_m)))

    def _prior_moments(self, harmonic: FloatArray) -> tuple[FloatArray, FloatArray]:
        prior = self.prior
        spectrum = np.repeat(2 * ive(harmonic, 1 / prior.length_scale**2), 2)
        center = self.points.middle_m + prior.behind_radii * prior.radius_m * self.points.away
        logs = [np.log(prior.radius_m), 0.0, np.log(prior.visible_concentration), logit(prior.outlier_share)]
        mean = np.concatenate([center, logs, np.zeros(len(spectrum))])
        std = [prior.center_std_m, prior.center_std_m, prior.log_radius_std, prior.log_noise_scale_std]
        std += [prior.log_concentration_std, prior.logit_outlier_share_std]
        return mean, np.concatenate([std, prior.shape_std * np.sqrt(spectrum)])

    def starts(self) -> list[FloatArray]:
        """Circles of a small and a large radius behind the points."""
        starts = []
        for radius in START_RADII_M:
            start = self.mean.copy()
            start[:2] = self.points.middle_m + self.prior.behind_radii * radius * self.points.away
            start[LOG_RADIUS] = np.log(radius)
            starts.append(start)
        return starts

    def contour(self, parameter: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The contour (node, xy) in m, and the distance (node,) in m of its nodes from the centre."""
        radius = np.exp(parameter[LOG_RADIUS] + self.feature @ parameter[FIRST_HARMONIC:])
        return parameter[:LOG_RADIUS] + radius[:, None] * self.unit, radius

    def contour_jacobian(self, radius_m: FloatArray) -> FloatArray:
        """Derivatives (node, xy, parameter) of the contour."""
        jacobian = np.zeros((N_NODES, 2, len(self.mean)))
        jacobian[:, 0, CENTER_X] = jacobian[:, 1, CENTER_Y] = 1
        outward = radius_m[:, None] * self.unit
        jacobian[:, :, LOG_RADIUS] = outward
        jacobian[:, :, FIRST_HARMONIC:] = outward[:, :, None] * self.feature[:, None, :]
        return jacobian

    def negative_log_posterior(self, parameter: FloatArray) -> tuple[float, FloatArray]:
        """Minus the log of likelihood times prior, both normalised, and its gradient (parameter,)."""
        node, radius = self.contour(parameter)
        concentration = float(np.exp(parameter[LOG_VISIBLE]))
        log_weight = concentration * (self.facing - 1)
        log_weight -= logsumexp(log_weight)
        weight = np.exp(log_weight)
        value, by_node, by_scale, n_at_node = log_likelihood(
            np.array(self.points.position_m),  # read-only is a type of its own to compile for
            self.precision,
            self.log_constant,
            np.asarray(log_weight + log_expit(-parameter[LOGIT_OUTLIER])),
            node,
            parameter[LOG_SCALE],
            float(log_expit(parameter[LOGIT_OUTLIER])) - self.log_area,
        )
        by_log_radius = radius * np.sum(by_node * self.unit, axis=1)
        by_visible = concentration * (n_at_node @ self.facing - n_at_node.sum() * (weight @ self.facing))
        by_outlier = len(self.points) * expit(-parameter[LOGIT_OUTLIER]) - n_at_node.sum()
        others = [by_log_radius.sum(), by_scale, by_visible, by_outlier]
        gradient = np.concatenate([by_node.sum(axis=0), others, by_log_radius @ self.feature])
        deviation = (parameter - self.mean) / self.std
        log_prior = -0.5 * deviation @ deviation - np.sum(np.log(self.std * np.sqrt(2 * np.pi)))
        return -float(value + log_prior), deviation / self.std - gradient


def _hessian(model: _Model, parameter: FloatArray) -> FloatArray:
    """Hessian of the negative log posterior by central differences of its gradient, made positive definite.

    No direction is less certain than under the prior.
    """
    step = DIFFERENCE_STEP * model.std
    rows = []
    for k in range(len(parameter)):
        shift = np.zeros(len(parameter))
        shift[k] = step[k]
        above, below = (model.negative_log_posterior(parameter + s * shift)[1] for s in (1, -1))
        rows.append((above - below) / (2 * step[k]))
    scaled = np.array(rows) * model.std * model.std[:, None]  # in standard deviations of the prior
    value, vector = np.linalg.eigh((scaled + scaled.T) / 2)
    return np.asarray((vector * np.maximum(value, 1.0)) @ vector.T / model.std / model.std[:, None])


def _mixed(model: _Model, modes: list[_Mode]) -> ShapeFit:
    """Mean and covariance over the modes, of the parameters and of the contour at each polar angle."""
    log_mass = np.array([mode.log_mass for mode in modes])
    log_evidence = float(logsumexp(log_mass))
    share = np.exp(log_mass - log_evidence)
    parameter = share @ np.array([mode.parameter for mode in modes])
    node = np.einsum("m,mnx->nx", share, [model.contour(mode.parameter)[0] for mode in modes])
    normal = ring_normals(node)
    covariance, variance = np.zeros((len(parameter), len(parameter))), np.zeros(N_NODES)
    for part, mode in zip(share, modes, strict=True):
        deviation = mode.parameter - parameter
        covariance += part * (mode.covariance + np.outer(deviation, deviation))
        at, radius = model.contour(mode.parameter)
        by_parameter = np.einsum("nx,nxp->np", normal, model.contour_jacobian(radius))
        within = np.einsum("np,pq,nq->n", by_parameter, mode.covariance, by_parameter)
        variance += part * (within + np.sum(normal * (at - node), axis=1) ** 2)
    harmonics = range(2, model.prior.highest_harmonic + 1)
    names = ["center_x_m", "center_y_m", "log_radius", "log_noise_scale", "log_concentration"]
    names.append("logit_outlier_share")
    names += [f"{part}_{k}" for k in harmonics for part in ("cosine", "sine")]
    radius_std = float(np.sqrt(covariance[LOG_RADIUS, LOG_RADIUS]))
    extent = float(np.linalg.norm(node - parameter[:2], axis=1).mean())
    return ShapeFit(
        kind="star_convex",
        status=PRIOR if radius_std > 0.9 * model.prior.log_radius_std else OK,
        is_closed=True,
        contour_m=node,
        std_m=np.sqrt(variance),
        log_evidence=log_evidence,
        parameter=parameter,
        parameter_covariance=covariance,
        parameter_name=np.array(names),
        extent_m=extent,
        extent_std_m=extent * radius_std,
    )
