import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime
from scipy.stats import multivariate_normal

from estimation.shape.fit import PRIOR
from estimation.shape.points.cluster import PointCluster
from estimation.shape.points.mic import MicPrior, _Model, fit_mic
from estimation.shape.points.mic_likelihood import log_likelihood
from isac_arena.validation.scenarios.point_clusters import partial_pillars, with_outliers
from isac_arena.validation.shape.points import closed_scores


def made(seed):
    return partial_pillars(np.random.default_rng(seed), 1)


def test_likelihood_is_the_mixture_written_out():
    rng = np.random.default_rng(0)
    position, node = rng.standard_normal((5, 2)), rng.standard_normal((7, 2))
    root = rng.standard_normal((5, 2, 2))
    covariance = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(2)
    weight = rng.dirichlet(np.ones(7))
    constant = -0.5 * np.linalg.slogdet(covariance)[1] - np.log(2 * np.pi)
    found = log_likelihood(
        position, np.linalg.inv(covariance), constant, np.log(weight), node, np.log(1.3), np.log(0.02)
    )
    expected = sum(
        np.log(
            sum(w * multivariate_normal(x, 1.3**2 * c).pdf(p) for w, x in zip(weight, node, strict=True)) + 0.02
        )
        for p, c in zip(position, covariance, strict=True)
    )
    assert found[0] == pytest.approx(expected, rel=1e-12)


@given(seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_gradient_against_differences(seed):
    rng = np.random.default_rng(seed)
    model = _Model(made(1)[seed % 12].points, MicPrior())
    at = model.mean + 0.5 * model.std * rng.standard_normal(len(model.mean))

    def value(parameter):
        return model.negative_log_posterior(parameter)[0]

    numerical = (approx_fprime(at, value, 1e-6) + approx_fprime(at, value, -1e-6)) / 2
    analytic = model.negative_log_posterior(at)[1]
    np.testing.assert_allclose(analytic, numerical, atol=1e-6 * np.max(np.abs(analytic)) + 1e-6)


def test_contour_jacobian_against_differences():
    model = _Model(made(2)[0].points, MicPrior())
    at = model.mean + 0.3 * model.std
    jacobian = model.contour_jacobian(model.contour(at)[1])
    for k in range(len(at)):
        step = 1e-6 * np.eye(len(at))[k]
        numerical = (model.contour(at + step)[0] - model.contour(at - step)[0]) / 2e-6
        np.testing.assert_allclose(jacobian[:, :, k], numerical, atol=1e-8)


def test_a_single_point_leaves_the_prior():
    point = PointCluster(np.array([[3.0, 0.0]]), 0.01 * np.eye(2)[None], np.zeros(2))
    fit = fit_mic(point)
    assert fit.status == PRIOR
    assert fit.extent_m == pytest.approx(0.5, abs=0.08)
    assert fit.contour_m[:, 0].mean() > 3.2  # behind the point as seen from the sensor
    assert np.max(fit.std_m) > 0.2


def test_coverage_and_outliers():
    rng = np.random.default_rng(5)
    objects = [one for seed in range(2) for one in made(seed)]
    clean = closed_scores(fit_mic, objects)
    dirty = closed_scores(fit_mic, [with_outliers(one, 0.1, rng) for one in objects])
    assert clean.iou.mean() > 0.55
    assert clean.coverage.mean() > 0.85
    assert dirty.iou.mean() > clean.iou.mean() - 0.1
