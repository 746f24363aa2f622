"""Recessed or gently curved walls: depth along a line as a Gaussian process or as one recess.

depth(t) ~ GP(0, sigma^2 k(t)) about the line of the wall. k is the Matern kernel of order 3/2, whose functions
may bend sharply, or of order 1/2, whose functions may jump; or the line has one recess
(`estimation.shape.points.recess`). The three have equal priors. Kernel order, standard deviation and length are
integrated over a grid. The ends are those of the line.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.special import logsumexp

from estimation.execution import one_blas_thread
from estimation.shape.fit import OK, PRIOR, ShapeFit
from estimation.shape.points.cluster import PointCluster
from estimation.shape.points.line import WALL_PRIOR, Line, LinePrior, end_posterior, places_along, robust_line
from estimation.shape.points.recess import DepthPoints, DepthPosterior, fit_recess
from scenes.record import FloatArray

N_SAMPLES = 100
DEPTH_STD_M = np.geomspace(0.03, 1.0, 6)
LENGTH_M = np.geomspace(0.3, 10.0, 6)
LINE_OFFSET_STD_M, LINE_AZIMUTH_STD_RAD = 1.0, 0.5  # prior of the line, which is fitted again with the depth


class DepthKernel(NamedTuple):
    """Covariance of the depth: a Matern kernel plus what is unknown of offset and azimuth of the line."""

    std_m: float
    length_m: float
    is_rough: bool  # of order 1/2, else 3/2
    curvature_std_per_m: float = 0.0  # of a parabola beside
    line_std: tuple[float, float] = (LINE_OFFSET_STD_M, LINE_AZIMUTH_STD_RAD)

    def between(self, a_m: FloatArray, b_m: FloatArray) -> FloatArray:
        """Covariance (a, b) of the depths at two sets of places."""
        distance = np.abs(a_m[:, None] - b_m) / self.length_m
        line = self.line_std[0] ** 2 + self.line_std[1] ** 2 * a_m[:, None] * b_m
        line += (self.curvature_std_per_m / 2) ** 2 * a_m[:, None] ** 2 * b_m**2
        if self.is_rough:
            return np.asarray(self.std_m**2 * np.exp(-distance) + line)
        scaled = np.sqrt(3) * distance
        return np.asarray(self.std_m**2 * (1 + scaled) * np.exp(-scaled) + line)


def fit_depth_line(points: PointCluster, prior: LinePrior = WALL_PRIOR) -> ShapeFit:
    """Wall whose depth varies along it, sampled from end to end; parameters as those of `fit_line`.

    Every point has full weight: a point far from the line may be in a recess.
    """
    with one_blas_thread():
        line = robust_line(points, LinePrior(outlier_share=prior.outlier_share, log_noise_scale_std=1.0))
        every = line._replace(parameter=np.append(line.parameter[:2], 0.0), inlier_share=np.ones(len(points)))
        ends = end_posterior(points, every, prior)
        at = np.linspace(ends.median_m[0], ends.median_m[1], N_SAMPLES)
        mean, variance, log_evidence = _depth(points, every, at)
    along, normal = line.axes
    contour = line.origin_m + at[:, None] * along + mean[:, None] * normal
    covariance = np.zeros((4, 4))
    covariance[:2, :2], covariance[2:, 2:] = line.covariance[:2, :2], ends.covariance_m2
    difference = np.array([-1.0, 1.0])
    return ShapeFit(
        kind="depth_line",
        status=OK if len(points) > 1 else PRIOR,
        is_closed=False,
        contour_m=contour,
        std_m=np.sqrt(variance),
        log_evidence=log_evidence + ends.log_evidence,
        parameter=np.concatenate([line.parameter[:2], ends.median_m]),
        parameter_covariance=covariance,
        parameter_name=np.array(["azimuth_rad", "offset_m", "end_a_m", "end_b_m"]),
        extent_m=float(np.diff(ends.median_m)[0]),
        extent_std_m=float(np.sqrt(difference @ ends.covariance_m2 @ difference)),
    )


def _depth(points: PointCluster, line: Line, at_m: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Mean and variance (sample,) of the depth in m over all models, and the log evidence of the distances."""
    along, normal = line.axes
    place, place_std = places_along(points, line, along, normal)
    seen = DepthPoints(
        place,
        place_std,
        (points.position_m - line.origin_m) @ normal - line.parameter[1],
        np.einsum("i,nij,j->n", normal, points.covariance_m2, normal),
    )
    grid = list(product(DEPTH_STD_M, LENGTH_M))
    models = [[fit_kernel(seen, at_m, DepthKernel(*at, rough)) for at in grid] for rough in (False, True)]
    line_std = (LINE_OFFSET_STD_M, LINE_AZIMUTH_STD_RAD)
    models.append([fit_recess(seen, at_m, std, line_std) for std in DEPTH_STD_M])
    members = [member for model in models for member in model]
    share = -np.log(np.repeat([len(model) for model in models], [len(model) for model in models]) * len(models))
    depth = average(members, share)
    return line.parameter[1] + depth.mean_m, depth.variance_m2, depth.log_likelihood


def average(members: Sequence[DepthPosterior], log_prior: FloatArray) -> DepthPosterior:
    """The depth over all models, of the prior shares `log_prior` (model,), with their evidence."""
    log_share = np.array([member.log_likelihood for member in members]) + log_prior
    total = float(logsumexp(log_share))
    share = np.exp(log_share - total)
    mean = share @ np.array([member.mean_m for member in members])
    variance = share @ np.array([member.variance_m2 + (member.mean_m - mean) ** 2 for member in members])
    return DepthPosterior(total, mean, variance)


def fit_kernel(points: DepthPoints, at_m: FloatArray, kernel: DepthKernel) -> DepthPosterior:
    """Posterior of the depth at the places `at_m` (sample,) under one kernel."""
    covariance = kernel.between(points.place_m, points.place_m) + np.diag(points.variance_m2)
    cross = kernel.between(points.place_m, at_m)
    factor = cholesky(covariance, lower=True)
    solved = cho_solve((factor, True), points.depth_m)
    log_determinant = 2 * np.log(np.diagonal(factor)).sum()
    n = len(points.depth_m)
    log_likelihood = -0.5 * (points.depth_m @ solved + log_determinant + n * np.log(2 * np.pi))
    whitened = solve_triangular(factor, cross, lower=True)
    prior = kernel.std_m**2 + kernel.line_std[0] ** 2 + (kernel.line_std[1] * at_m) ** 2
    prior += (kernel.curvature_std_per_m / 2 * at_m**2) ** 2
    return DepthPosterior(
        float(log_likelihood), cross.T @ solved, np.maximum(prior - np.sum(whitened**2, axis=0), 0.0)
    )
