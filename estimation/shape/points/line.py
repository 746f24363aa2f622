"""Walls from incidence points: a line with unequal noise, and the posterior of its two ends.

The place of point i is uniform along the segment from end a to end b of the line n'p = d; its error has the
covariance Sigma_i times s^2. 5 % of the points are outliers. Given the line, the density factorises exactly into
the distance from it, N(n'p - d; 0, n' Sigma n), and the place along it given that distance.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ive, logsumexp, ndtr

from estimation.execution import one_blas_thread
from estimation.shape.fit import OK, PRIOR, ShapeFit
from estimation.shape.points.cluster import PointCluster
from estimation.shape.points.line_evidence import importance_evidence, segment_log_likelihood
from scenes.record import FloatArray

N_ENDS = 48  # grid values of either end
N_SAMPLES = 100
END_STDS = 4.0
DIFFERENCE_STEP = 1e-6
LOG_SCALE_BOUNDS = (-2.0, 2.0)
PROPOSAL_STD = (0.15, 0.25, 0.25, 0.4)  # at first; of offset in m, log noise scale, middle in m, log length


@dataclass(frozen=True)
class LinePrior:
    """Prior of a wall."""

    length_m: tuple[float, float] = (0.5, 25.0)  # log-uniform
    offset_std_m: float = 0.5  # of the line about the middle of the points
    middle_range_m: float = 1.25  # the prior density of the middle of the wall is one over this
    log_noise_scale_std: float = 0.3
    facing_concentration: float = 3.5  # of its normal about the direction of the sensor
    outlier_share: float = 0.05
    outlier_margin_m: float = 0.5


WALL_PRIOR = LinePrior()


class Line(NamedTuple):
    """A line n'p = d through a cluster, relative to the middle of its points, with its covariance."""

    origin_m: FloatArray  # (xy,) the middle of the points
    parameter: FloatArray  # (3,): azimuth of the line in rad, its offset d in m, log noise scale
    covariance: FloatArray  # (3, 3)
    inlier_share: FloatArray  # (ip,) probability that the point belongs to the line

    @property
    def axes(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors (xy,) along the line and along its normal."""
        return _axes(self.parameter[0])


class SegmentEnds(NamedTuple):
    """Posterior of the two ends along a line."""

    median_m: FloatArray  # (2,); it has the least absolute error, since the posterior is skewed outwards
    covariance_m2: FloatArray  # (2, 2) about the medians
    log_evidence: float  # of the places of the points along the line


def fit_line(points: PointCluster, prior: LinePrior = WALL_PRIOR) -> ShapeFit:
    """Segment through a cluster of points; `extent_m` is its length. The status is `prior` for a single point."""
    with one_blas_thread():
        line = robust_line(points, prior)
        ends = end_posterior(points, line, prior)
        log_evidence = _log_evidence(points, line, ends, prior)
    at = np.linspace(ends.median_m[0], ends.median_m[1], N_SAMPLES)
    along, normal = line.axes
    contour = line.origin_m + at[:, None] * along + line.parameter[1] * normal
    jacobian = np.stack([at, np.ones(N_SAMPLES)], axis=1)
    std = np.sqrt(np.einsum("sp,pq,sq->s", jacobian, line.covariance[:2, :2], jacobian))
    covariance = np.zeros((5, 5))
    covariance[:3, :3], covariance[3:, 3:] = line.covariance, ends.covariance_m2
    difference = np.array([-1.0, 1.0])
    return ShapeFit(
        kind="wall",
        status=OK if len(points) > 1 else PRIOR,
        is_closed=False,
        contour_m=contour,
        std_m=std,
        log_evidence=log_evidence,
        parameter=np.concatenate([line.parameter, ends.median_m]),
        parameter_covariance=covariance,
        parameter_name=np.array(["azimuth_rad", "offset_m", "log_noise_scale", "end_a_m", "end_b_m"]),
        extent_m=float(np.diff(ends.median_m)[0]),
        extent_std_m=float(np.sqrt(difference @ ends.covariance_m2 @ difference)),
    )


def _log_evidence(points: PointCluster, line: Line, ends: SegmentEnds, prior: LinePrior) -> float:
    """Log evidence of the segment, by importance sampling about the fitted line and ends."""
    log_outlier_density = -float(np.log(points.area_m2(prior.outlier_margin_m)))
    log_length = np.log(prior.length_m)
    offset = points.position_m - line.origin_m
    covariance = np.array(points.covariance_m2, order="C")  # not read-only, a type of its own to compile for

    def log_density(segment: FloatArray) -> FloatArray:
        """Log of likelihood times prior (draw,) of segments (draw, 5); minus infinity outside the prior."""
        azimuth, distance, log_scale, _, length = segment.T
        held = np.abs(azimuth - line.parameter[0]) < np.pi / 2
        held &= (length > log_length[0]) & (length < log_length[1])
        value = np.full(len(segment), -np.inf)
        value[held] = segment_log_likelihood(
            segment[held], offset, covariance, prior.outlier_share, log_outlier_density
        )
        facing = _log_facing(azimuth, points.away, prior.facing_concentration)
        spread = (distance / prior.offset_std_m) ** 2 + (log_scale / prior.log_noise_scale_std) ** 2
        constant = 2 * np.pi * prior.offset_std_m * prior.log_noise_scale_std
        constant *= (log_length[1] - log_length[0]) * prior.middle_range_m
        return np.asarray(value + facing - 0.5 * spread - np.log(constant))

    start, end = ends.median_m
    within = np.clip(np.log(max(end - start, prior.length_m[0])), *(log_length + np.array([0.1, -0.1])))
    mean = np.array([*line.parameter, (start + end) / 2, within])
    azimuth_std = min(1.3 * float(np.sqrt(line.covariance[0, 0])), 0.4)
    return importance_evidence(log_density, mean, np.diag([azimuth_std, *PROPOSAL_STD]) ** 2)


def robust_line(points: PointCluster, prior: LinePrior) -> Line:
    """The most probable line, by the distances of its points, from the best of four azimuths."""
    from scipy.optimize import approx_fprime, minimize  # noqa: PLC0415  (slow to import)

    origin = points.middle_m
    offset = points.position_m - origin
    length = float(np.hypot(*np.ptp(points.position_m, axis=0))) + prior.length_m[0]
    reach = END_STDS * prior.offset_std_m + length
    background = (
        np.log(prior.outlier_share) - float(np.log(points.area_m2(prior.outlier_margin_m))) + np.log(length)
    )

    def terms(parameter: FloatArray) -> tuple[FloatArray, FloatArray]:
        _, normal = _axes(parameter[0])
        distance = offset @ normal - parameter[1]
        variance = np.exp(2 * parameter[2]) * np.einsum("i,nij,j->n", normal, points.covariance_m2, normal)
        inlier = np.log1p(-prior.outlier_share) - 0.5 * (distance**2 / variance + np.log(2 * np.pi * variance))
        return inlier, np.logaddexp(inlier, background)

    def negative(parameter: FloatArray) -> float:
        scale = parameter[2] / prior.log_noise_scale_std
        log_prior = -0.5 * scale**2 - np.log(prior.log_noise_scale_std * np.sqrt(2 * np.pi))
        log_prior -= 0.5 * (parameter[1] / prior.offset_std_m) ** 2
        log_prior -= np.log(prior.offset_std_m * np.sqrt(2 * np.pi))
        log_prior += float(_log_facing(parameter[0], points.away, prior.facing_concentration))
        return -float(terms(parameter)[1].sum() + log_prior)

    def gradient(parameter: FloatArray) -> FloatArray:
        steps = [approx_fprime(parameter, negative, s * DIFFERENCE_STEP) for s in (1, -1)]
        return np.asarray(sum(steps) / 2)

    axis = np.linalg.svd(offset, full_matrices=False)[2][0]
    first = np.arctan2(axis[1], axis[0])
    found = [
        minimize(
            negative,
            [azimuth, 0.0, 0.0],
            jac=gradient,
            method="L-BFGS-B",
            bounds=[(azimuth - np.pi, azimuth + np.pi), (-reach, reach), LOG_SCALE_BOUNDS],
            options={"gtol": 1e-3},
        )
        for azimuth in first + np.arange(4) * np.pi / 4
    ]
    best = min(found, key=lambda result: float(result.fun))
    rows = [(gradient(best.x + s) - gradient(best.x - s)) / 2e-4 for s in 1e-4 * np.eye(3)]
    hessian = (np.array(rows) + np.array(rows).T) / 2
    value, vector = np.linalg.eigh(hessian)
    value = np.maximum(value, 1.0)  # the standard deviations are at most 1 rad and 1 m
    inlier, total = terms(best.x)
    covariance = (vector / value) @ vector.T
    # Given the scale s the covariance of the line is s^2 C. With the line integrated out, the mode of log s is
    # higher by two of its variances v; the mean of s^2 is therefore exp(6 v) times that at the optimum.
    spread = np.exp(np.array([3.0, 3.0, 0.0]) * covariance[2, 2])
    covariance = covariance * np.outer(spread, spread)
    return Line(origin, np.asarray(best.x), covariance, np.exp(inlier - total))


def end_posterior(points: PointCluster, line: Line, prior: LinePrior) -> SegmentEnds:
    """Posterior of the ends on a grid: p(points | a, b) = prod [Phi((t - a) / s) - Phi((t - b) / s)] / (b - a).

    Outliers are weighted by their inlier share. The prior is log-uniform in the length and uniform in the
    middle.
    """
    along, normal = line.axes
    place, std = places_along(points, line, along, normal)
    weight = line.inlier_share
    likely = place[weight > 0.5] if (weight > 0.5).any() else place
    low, high, margin = likely.min(), likely.max(), END_STDS * float(std.max())
    seen = max(high - low, prior.length_m[0])
    beyond = margin + min(seen * np.expm1(6.0 / max(len(likely), 1)), prior.length_m[1])
    inside = min(margin, seen / 2)
    a = np.linspace(low - beyond, low + inside, N_ENDS)
    b = np.linspace(high - inside, high + beyond, N_ENDS)
    length = np.maximum(b[None, :] - a[:, None], prior.length_m[0])
    above = ndtr((place[:, None] - a) / std[:, None])
    below = ndtr((place[:, None] - b) / std[:, None])
    inside_share = np.maximum(above[:, :, None] - below[:, None, :], 1e-12)
    log_density = np.einsum("i,iab->ab", weight, np.log(inside_share) - np.log(length))
    log_prior = -np.log(length) - np.log(np.log(prior.length_m[1] / prior.length_m[0]) * prior.middle_range_m)
    log_cell = np.log((a[1] - a[0]) * (b[1] - b[0]))
    log_posterior = log_density + log_prior + log_cell
    total = float(logsumexp(log_posterior))
    share = np.exp(log_posterior - total)
    median = np.array([_median(a, share.sum(axis=1)), _median(b, share.sum(axis=0))])
    da, db = a - median[0], b - median[1]
    cross = da @ share @ db
    covariance = np.array([[share.sum(axis=1) @ da**2, cross], [cross, share.sum(axis=0) @ db**2]])
    return SegmentEnds(median, covariance, total)


def places_along(
    points: PointCluster, line: Line, along: FloatArray, normal: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Place and its standard deviation (ip,) in m along the line, given each point's distance from the line."""
    offset = points.position_m - line.origin_m
    covariance = np.exp(2 * line.parameter[2]) * points.covariance_m2
    across = np.einsum("i,nij,j->n", normal, covariance, normal)
    mixed = np.einsum("i,nij,j->n", along, covariance, normal)
    lengthwise = np.einsum("i,nij,j->n", along, covariance, along)
    place = offset @ along - mixed / across * (offset @ normal - line.parameter[1])
    return place, np.sqrt(lengthwise - mixed**2 / across)


def _median(at_m: FloatArray, share: FloatArray) -> float:
    """Median in m of a density on an even grid; each value is the probability of the cell about it."""
    step = at_m[1] - at_m[0]
    edge = np.append(at_m - step / 2, at_m[-1] + step / 2)
    return float(np.interp(0.5, np.append(0.0, np.cumsum(share)), edge))


def _log_facing(azimuth_rad: ArrayLike, away: FloatArray, concentration: float) -> FloatArray:
    """Log density per rad of the azimuth of a wall: von Mises of its normal about the sensor, else uniform."""
    azimuth = np.asarray(azimuth_rad, float)
    if not away.any():
        return np.full(azimuth.shape, -np.log(np.pi))
    cosine = np.abs(away[1] * np.cos(azimuth) - away[0] * np.sin(azimuth))
    return np.asarray(concentration * (cosine - 1) - np.log(2 * np.pi * ive(0, concentration)))


def _axes(azimuth_rad: float) -> tuple[FloatArray, FloatArray]:
    cosine, sine = np.cos(azimuth_rad), np.sin(azimuth_rad)
    return np.array([cosine, sine]), np.array([-sine, cosine])
