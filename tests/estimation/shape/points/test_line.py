import numpy as np
import pytest
from scipy.stats import norm

from estimation.shape.points.cluster import PointCluster
from estimation.shape.points.depth_line import fit_depth_line
from estimation.shape.points.line import LinePrior, end_posterior, fit_line, places_along, robust_line
from isac_arena.validation.scenarios.point_clusters import walls
from isac_arena.validation.shape.points import wall_scores


def wall_points(n, seed, length=6.0, std=(0.05, 0.1)):
    """Points of a wall along x from -length / 2 to length / 2, seen from below."""
    rng = np.random.default_rng(seed)
    place = length * (rng.random(n) - 0.5)
    position = np.stack([place + std[1] * rng.standard_normal(n), std[0] * rng.standard_normal(n)], axis=1)
    covariance = np.broadcast_to(np.diag([std[1] ** 2, std[0] ** 2]), (n, 2, 2))
    return PointCluster(position, covariance, np.array([0.0, -6.0]))


def test_line_is_within_its_uncertainty():
    normalised = []
    for seed in range(60):
        points = wall_points(20, seed)
        line = robust_line(points, LinePrior())
        azimuth = (line.parameter[0] + np.pi / 2) % np.pi - np.pi / 2
        normal = line.axes[1]
        error = np.array([azimuth, line.parameter[1] + line.origin_m[1] * normal[1]])  # the wall is y = 0
        normalised.append(error @ np.linalg.solve(line.covariance[:2, :2], error))
    assert 1.2 < np.mean(normalised) < 3.0  # two degrees of freedom, 60 draws


@pytest.mark.parametrize("n", [8, 16, 64])
def test_the_line_of_few_points_counts_that_their_noise_is_unknown(n):
    """Against the posterior of azimuth, offset and noise scale on a grid."""
    points, prior = wall_points(n, 5), LinePrior(outlier_share=1e-12)
    line = robust_line(points, prior)
    reach = 6 * np.sqrt(np.diagonal(line.covariance)[:2])
    azimuth, offset = (at + r * np.linspace(-1, 1, 61) for at, r in zip(line.parameter[:2], reach, strict=True))
    scale = np.linspace(-1.2, 1.2, 49)
    normal = np.stack([-np.sin(azimuth), np.cos(azimuth)])
    variance = np.einsum("ia,nij,ja->na", normal, points.covariance_m2, normal)
    distance = ((points.position_m - line.origin_m) @ normal)[:, :, None] - offset
    square = np.sum(distance**2 / variance[:, :, None], axis=0)
    log_posterior = -0.5 * square[..., None] * np.exp(-2 * scale) - n * scale
    log_posterior += -0.5 * np.log(variance).sum(axis=0)[:, None, None]
    log_posterior += -0.5 * (scale / prior.log_noise_scale_std) ** 2
    log_posterior += -0.5 * (offset / prior.offset_std_m)[:, None] ** 2
    share = np.exp(log_posterior - log_posterior.max())
    share /= share.sum()
    for k, (values, axes) in enumerate(((azimuth, (1, 2)), (offset, (0, 2)))):
        density = share.sum(axis=axes)
        spread = density @ (values - density @ values) ** 2
        assert line.covariance[k, k] == pytest.approx(spread, rel=0.1)


def test_end_posterior_against_a_fine_grid():
    points, prior = wall_points(6, 3, length=4.0), LinePrior()
    line = robust_line(points, prior)._replace(inlier_share=np.ones(6))
    place, std = places_along(points, line, *line.axes)
    a = np.linspace(place.min() - 12, place.min() + 0.5, 600)
    b = np.linspace(place.max() - 0.5, place.max() + 12, 600)
    length = b - a[:, None]
    above, below = (norm.cdf((place[:, None] - at) / std[:, None]) for at in (a, b))
    density = np.prod((above[:, :, None] - below[:, None, :]) / length, axis=0) / length
    density *= (length > prior.length_m[0]) * (a[1] - a[0]) * (b[1] - b[0])
    constant = np.log(np.log(prior.length_m[1] / prior.length_m[0]) * prior.middle_range_m)
    ends = end_posterior(points, line, prior)
    assert ends.log_evidence == pytest.approx(np.log(density.sum()) - constant, abs=0.05)
    for at, axis, found in ((a, 1, ends.median_m[0]), (b, 0, ends.median_m[1])):
        share = np.cumsum(density.sum(axis=axis)) / density.sum()
        assert found == pytest.approx(np.interp(0.5, share, at), abs=0.05)


def test_length_is_within_its_uncertainty():
    error = []
    for seed in range(40):
        fit = fit_line(wall_points(12, seed))
        error.append((fit.extent_m - 6.0) / fit.extent_std_m)
    assert abs(np.mean(error)) < 0.6
    assert 0.6 < np.std(error) < 1.5


def test_an_outlier_does_not_turn_the_line():
    points = wall_points(20, 1)
    position = points.position_m.copy()
    position[0] = [2.5, 1.5]
    fit = fit_line(PointCluster(position, points.covariance_m2, points.sensor_m))
    assert np.max(np.abs(fit.contour_m[:, 1])) < 0.15


def test_depth_line_follows_a_recess_and_the_line_does_not():
    made = walls(np.random.default_rng(4), 1, (5.0, 10.0), recess_m=0.4)
    depth, line = wall_scores(fit_depth_line, made), wall_scores(fit_line, made)
    assert depth.perpendicular_rmse_m.mean() < 0.7 * line.perpendicular_rmse_m.mean()
    assert depth.coverage.mean() > 0.8


def test_depth_line_has_more_evidence_on_a_clear_recess_only():
    rng = np.random.default_rng(6)
    gain = {
        recess: np.mean(
            [
                fit_depth_line(one.points).log_evidence - fit_line(one.points).log_evidence
                for one in walls(rng, 1, (6.0, 10.0), recess_m=recess)
            ]
        )
        for recess in (0.0, 0.5)
    }
    assert gain[0.5] > gain[0.0] + 3
