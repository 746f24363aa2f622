"""One recess in a wall against dense Gaussians, and that depth lines with it keep their word."""

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from estimation.shape.points.depth_line import fit_depth_line
from estimation.shape.points.recess import N_EDGES, DepthPoints, fit_recess
from isac_arena.validation.scenarios.point_clusters import walls
from isac_arena.validation.shape.points import wall_scores

LINE_STD = (1.0, 0.5)


def made_points(n, seed, place_std=1e-9, recess=(1.0, 3.0, 0.4)):
    rng = np.random.default_rng(seed)
    place = np.sort(rng.uniform(-4, 6, n))
    depth = 0.2 + 0.05 * place + recess[2] * ((place > recess[0]) & (place < recess[1]))
    std = rng.uniform(0.02, 0.08, n)
    return DepthPoints(place, np.full(n, place_std), depth + std * rng.standard_normal(n), std**2)


def test_recess_against_dense_gaussians_over_all_pairs():
    points, at, sigma = made_points(9, 1), np.linspace(-4.5, 6.5, 23), 0.3
    found = fit_recess(points, at, sigma, LINE_STD)
    edge = np.linspace(-4.5, 6.5, N_EDGES)
    place = np.concatenate([points.place_m, at])
    log_likelihood, means, variances = [], [], []
    for k in range(N_EDGES):
        for j in range(k + 1, N_EDGES):
            # A jump is uniform over half a cell about its place, so the recess begins evenly at the samples.
            ramp = [np.clip((at - edge[i]) / (edge[1] - edge[0]) + 0.5, 0, 1) for i in (k, j)]
            hard = [(points.place_m > edge[i]).astype(float) for i in (k, j)]
            inside = np.concatenate([hard[0] - hard[1], ramp[0] - ramp[1]])
            prior = LINE_STD[0] ** 2 + LINE_STD[1] ** 2 * np.outer(place, place)
            prior += sigma**2 * np.outer(inside, inside)
            n = len(points.place_m)
            seen = prior[:n, :n] + np.diag(points.variance_m2)
            gain = np.linalg.solve(seen, prior[:n, n:]).T
            log_likelihood.append(multivariate_normal(np.zeros(n), seen).logpdf(points.depth_m))
            means.append(gain @ points.depth_m)
            jump = sigma**2 * inside[:n] @ np.linalg.solve(seen, points.depth_m)
            doubt = jump**2 * inside[n:] * (1 - inside[n:])
            variances.append(np.diagonal(prior[n:, n:] - gain @ prior[:n, n:]) + doubt)
    share = np.exp(log_likelihood - logsumexp(log_likelihood))
    mean = share @ np.array(means)
    assert found.log_likelihood == pytest.approx(logsumexp(log_likelihood) - np.log(len(share)), abs=1e-6)
    np.testing.assert_allclose(found.mean_m, mean, atol=1e-6)
    spread = share @ (np.array(variances) + (np.array(means) - mean) ** 2)
    np.testing.assert_allclose(found.variance_m2, spread, atol=1e-6)


def test_recess_finds_its_places_and_its_depth():
    found = fit_recess(made_points(60, 2), np.linspace(-4, 6, 201), 0.3, LINE_STD)
    at = np.linspace(-4, 6, 201)
    true = 0.2 + 0.05 * at + 0.4 * ((at > 1) & (at < 3))
    away = (np.abs(at - 1) > 0.4) & (np.abs(at - 3) > 0.4)
    assert np.abs(found.mean_m - true)[away].max() < 0.08


def test_places_with_errors_widen_the_band_where_the_recess_begins():
    at = np.linspace(-4, 6, 201)
    sure, unsure = (fit_recess(made_points(60, 3, std), at, 0.3, LINE_STD) for std in (1e-9, 0.4))
    near = np.abs(at - 1) < 0.5
    assert unsure.variance_m2[near].mean() > 1.5 * sure.variance_m2[near].mean()


def test_depth_lines_keep_their_word_on_straight_and_recessed_walls():
    for recess, least in ((0.0, 0.9), (0.3, 0.8)):
        scores = wall_scores(fit_depth_line, walls(np.random.default_rng(9), 1, recess_m=recess))
        assert scores.coverage.mean() > least
