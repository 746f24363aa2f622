"""Recessed or gently curved walls: depth along a line as a Gaussian process.

depth(t) ~ GP(0, sigma^2 k(t)) about the wall's line, k the Matern kernel of order 3/2, whose functions may bend
sharply, or of order 1/2, whose functions may jump as a recess does. Order, standard deviation and length are
integrated over a grid, the ends are those of the line.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.special import logsumexp

from estimation.shape.fit import OK, PRIOR, ShapeFit
from estimation.shape.line import WALL_PRIOR, Line, LinePrior, end_posterior, places_along, robust_line
from estimation.shape.points import PointCluster
from estimation.shape.threads import one_blas_thread
from scenes.record import FloatArray

N_SAMPLES = 100
DEPTH_STD_M = np.geomspace(0.03, 1.0, 6)
LENGTH_M = np.geomspace(0.3, 10.0, 6)
LINE_OFFSET_STD_M, LINE_AZIMUTH_STD_RAD = 1.0, 0.5  # the line itself is relearned with the depth


class _Cell(NamedTuple):
    """Posterior of the depth for one kernel."""

    log_likelihood: float
    mean_m: FloatArray
    variance_m2: FloatArray


class _Kernel(NamedTuple):
    """Covariance of the depth: a Matern kernel plus the unknown offset and azimuth of the line."""

    std_m: float
    length_m: float
    is_rough: bool  # of order 1/2, else 3/2

    def between(self, a_m: FloatArray, b_m: FloatArray) -> FloatArray:
        distance = np.abs(a_m[:, None] - b_m) / self.length_m
        line = LINE_OFFSET_STD_M**2 + LINE_AZIMUTH_STD_RAD**2 * a_m[:, None] * b_m
        if self.is_rough:
            return np.asarray(self.std_m**2 * np.exp(-distance) + line)
        scaled = np.sqrt(3) * distance
        return np.asarray(self.std_m**2 * (1 + scaled) * np.exp(-scaled) + line)


def fit_depth_line(points: PointCluster, prior: LinePrior = WALL_PRIOR) -> ShapeFit:
    """Wall whose depth varies along it, sampled from end to end; parameters as those of `fit_line`.

    Points count as far as they belong to the line or its surroundings: the outlier share widens their noise.
    """
    with one_blas_thread():
        line = robust_line(points, LinePrior(outlier_share=prior.outlier_share, log_noise_scale_std=1.0))
        told = line._replace(parameter=np.append(line.parameter[:2], 0.0), inlier_share=np.ones(len(points)))
        ends = end_posterior(points, told, prior)
        at = np.linspace(ends.median_m[0], ends.median_m[1], N_SAMPLES)
        mean, variance, log_evidence = _depth(points, told, at)
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
    """Mean and variance (sample,) of the depth in m over all kernels, and the log evidence of the distances."""
    along, normal = line.axes
    place, _ = places_along(points, line, along, normal)
    depth = (points.position_m - line.origin_m) @ normal
    noise = np.einsum("i,nij,j->n", normal, points.covariance_m2, normal)
    cells = [
        _depth_cell(place, depth - line.parameter[1], noise, at_m, _Kernel(std, length, is_rough))
        for is_rough in (False, True)
        for std in DEPTH_STD_M
        for length in LENGTH_M
    ]
    log_likelihood = np.array([cell.log_likelihood for cell in cells])
    total = float(logsumexp(log_likelihood))
    share = np.exp(log_likelihood - total)
    mean = share @ np.array([cell.mean_m for cell in cells])
    variance = share @ np.array([cell.variance_m2 + (cell.mean_m - mean) ** 2 for cell in cells])
    return line.parameter[1] + mean, variance, total - float(np.log(len(cells)))


def _depth_cell(
    place_m: FloatArray,
    depth_m: FloatArray,
    noise_m2: FloatArray,
    at_m: FloatArray,
    kernel: _Kernel,
) -> _Cell:
    covariance = kernel.between(place_m, place_m) + np.diag(noise_m2)
    cross = kernel.between(place_m, at_m)
    factor = cholesky(covariance, lower=True)
    solved = cho_solve((factor, True), depth_m)
    log_determinant = 2 * np.log(np.diagonal(factor)).sum()
    log_likelihood = -0.5 * (depth_m @ solved + log_determinant + len(depth_m) * np.log(2 * np.pi))
    whitened = solve_triangular(factor, cross, lower=True)
    prior = kernel.std_m**2 + LINE_OFFSET_STD_M**2 + (LINE_AZIMUTH_STD_RAD * at_m) ** 2
    return _Cell(
        float(log_likelihood), cross.T @ solved, np.maximum(prior - np.sum(whitened**2, axis=0), 0.0)
    )
