"""Evidence of a straight wall: closed forms, quadrature along the segment, and draws from the prior."""

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, vonmises

from estimation.shape.points.cluster import PointCluster
from estimation.shape.points.line import WALL_PRIOR, fit_line
from estimation.shape.points.line_evidence import importance_evidence, segment_log_likelihood


def test_integral_of_a_correlated_normal_far_from_its_proposal():
    covariance = np.array([[0.5, 0.3, 0.0], [0.3, 0.4, 0.1], [0.0, 0.1, 0.2]])
    target = multivariate_normal([1.0, -0.5, 0.3], covariance)
    found = importance_evidence(lambda at: target.logpdf(at) + 3.0, np.zeros(3), np.eye(3))
    assert found == pytest.approx(3.0, abs=0.05)


def test_likelihood_is_the_integral_along_the_segment():
    rng = np.random.default_rng(3)
    root = rng.standard_normal((4, 2, 2))
    covariance = 0.1 * (root @ np.swapaxes(root, 1, 2) + 0.2 * np.eye(2))
    offset = rng.standard_normal((4, 2))
    azimuth, distance, log_scale, middle, log_length = segment = np.array([0.7, 0.2, 0.1, -0.3, 0.4])
    along = np.array([np.cos(azimuth), np.sin(azimuth)])
    place = middle + np.exp(log_length) * (np.arange(4000) + 0.5 - 2000) / 4000
    on_wall = place[:, None] * along + distance * np.array([-along[1], along[0]])
    inlier = [
        multivariate_normal(point, np.exp(2 * log_scale) * of).pdf(on_wall).mean()
        for point, of in zip(offset, covariance, strict=True)
    ]
    expected = np.sum(np.log(0.9 * np.array(inlier) + 0.1 * np.exp(-2.0)))
    found = segment_log_likelihood(segment[None], offset, covariance, 0.1, -2.0)
    assert found[0] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("noise_std_m", [0.1, 0.3])
def test_evidence_against_draws_from_the_prior(noise_std_m):
    rng = np.random.default_rng(7)
    position = np.stack([rng.uniform(-0.6, 0.6, 5), np.zeros(5)], axis=1)
    position += noise_std_m * rng.standard_normal((5, 2))
    covariance = np.tile(noise_std_m**2 * np.eye(2), (5, 1, 1))
    points = PointCluster(position, covariance, np.array([0.3, -6.0]))
    prior, n, reach = WALL_PRIOR, 400_000, 4.0
    away = np.arctan2(points.away[1], points.away[0])
    normal = vonmises(prior.facing_concentration).rvs(n, random_state=rng) + away
    draws = np.stack(
        [
            normal - np.pi / 2,
            prior.offset_std_m * rng.standard_normal(n),
            prior.log_noise_scale_std * rng.standard_normal(n),
            rng.uniform(-reach, reach, n),
            rng.uniform(*np.log(prior.length_m), n),
        ],
        axis=1,
    )
    size = np.ptp(position, axis=0) + 2 * prior.outlier_margin_m
    value = segment_log_likelihood(
        draws, position - points.middle_m, covariance, prior.outlier_share, -np.log(np.prod(size))
    )
    expected = logsumexp(value) - np.log(n) + np.log(2 * reach / prior.middle_range_m)
    assert fit_line(points).log_evidence == pytest.approx(expected, abs=0.1)
