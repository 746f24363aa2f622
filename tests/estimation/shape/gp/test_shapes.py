import warnings
from dataclasses import fields

import numpy as np
import pytest
from pydantic import ValidationError

from estimation.shape.config import CentroidBias, ShapeConfig
from estimation.shape.gp.estimate import estimate_shapes
from estimation.slam.record import IncidencePoints


def incidence_points(position, std_m=0.05, is_inlier=None):
    n = len(position)
    return IncidencePoints(
        stop=np.arange(n),
        path=np.zeros(n),
        position_m=np.reshape(position, (n, 2)),
        covariance_m2=np.tile(std_m**2 * np.eye(2), (n, 1, 1)),
        cost=np.zeros(n),
        is_inlier=np.ones(n, bool) if is_inlier is None else is_inlier,
    )


def ring(center, radius, n, rng, noise_m=0.05):
    angle = rng.uniform(-np.pi, np.pi, n)
    distance = radius + noise_m * rng.standard_normal(n)
    return np.array(center) + distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def two_rings(rng):
    return np.concatenate([ring((5.0, 1.0), 0.5, 20, rng), ring((-3.0, 0.0), 0.8, 40, rng)])


def test_two_round_objects_are_found_with_their_radii():
    ips = incidence_points(two_rings(np.random.default_rng(1)))
    shapes = estimate_shapes(ips, ShapeConfig())
    assert shapes.label.tolist() == [1] * 20 + [0] * 40
    np.testing.assert_allclose(shapes.center_m, [[-3, 0], [5, 1]], atol=0.2)
    np.testing.assert_allclose(shapes.mean_m, [0.8, 0.5], atol=0.1)
    outline = shapes.center_m[0] + shapes.radius_m[0][:, None] * np.stack(
        [np.cos(shapes.angle_rad), np.sin(shapes.angle_rad)], axis=-1
    )
    assert np.max(np.abs(np.linalg.norm(outline - [-3.0, 0.0], axis=1) - 0.8)) < 0.15
    assert np.all(shapes.noise_std_m >= 0.05 * (1 - 1e-12))
    assert shapes.angle_rad[0] == -np.pi
    assert shapes.angle_rad[-1] < np.pi


def test_same_points_give_the_same_bits():
    ips = incidence_points(two_rings(np.random.default_rng(1)))
    first, second = (estimate_shapes(ips, ShapeConfig()) for _ in range(2))
    for spec in fields(first):
        np.testing.assert_array_equal(getattr(first, spec.name), getattr(second, spec.name))


def test_outliers_are_not_clustered_and_do_not_matter():
    rng = np.random.default_rng(2)
    clean = two_rings(rng)
    position = np.concatenate([clean, ring((5.0, 1.0), 0.2, 15, rng), [[np.nan, np.nan]]])
    is_inlier = np.arange(len(position)) < len(clean)
    expected = estimate_shapes(incidence_points(clean), ShapeConfig())
    found = estimate_shapes(incidence_points(position, is_inlier=is_inlier), ShapeConfig())
    np.testing.assert_array_equal(found.label[is_inlier], expected.label)
    assert np.all(found.label[~is_inlier] == -1)
    np.testing.assert_array_equal(found.radius_m, expected.radius_m)


def test_bias_moves_the_center_but_not_the_contour():
    angle = np.linspace(-np.pi, np.pi, 60, endpoint=False)
    ips = incidence_points(np.stack([2 * np.cos(angle), 2 * np.sin(angle)], axis=-1))
    bias = CentroidBias(near_m=(0.3, 0.0), bias_m=(0.5, -0.2))
    shapes = estimate_shapes(ips, ShapeConfig(biases=(bias,), noise_floor=False))
    np.testing.assert_allclose(shapes.center_m, [[0.5, -0.2]], atol=1e-12)
    outline = shapes.center_m[0] + shapes.radius_m[0][:, None] * np.stack(
        [np.cos(shapes.angle_rad), np.sin(shapes.angle_rad)], axis=-1
    )
    np.testing.assert_allclose(np.linalg.norm(outline, axis=1), 2.0, atol=0.01)


def test_a_bias_behind_a_wall_makes_a_better_contour():
    """About its own centroid a straight wall is no star-convex contour; from behind it is."""
    rng = np.random.default_rng(4)
    wall = np.stack([np.linspace(-2, 2, 40), 0.05 * rng.standard_normal(40)], axis=-1)
    ips = incidence_points(wall)
    bias = CentroidBias(near_m=(0.0, 0.0), bias_m=(0.0, -1.5))

    def height_error(config):
        shapes = estimate_shapes(ips, config)
        seen = np.linspace(-1.8, 1.8, 30) - shapes.center_m[0, 0], -shapes.center_m[0, 1] * np.ones(30)
        radius = np.interp(np.arctan2(seen[1], seen[0]), shapes.angle_rad, shapes.radius_m[0])
        return np.sqrt(np.mean((radius - np.hypot(*seen)) ** 2))

    assert height_error(ShapeConfig(biases=(bias,))) < 0.05
    assert height_error(ShapeConfig()) > 0.2


def test_paper_configuration_is_as_printed():
    config = ShapeConfig.paper(eps_m=1.0)
    assert (config.start, config.mean_uncertainty, config.noise_floor) == ("paper", False, False)
    assert config.eps_m == 1.0
    shapes = estimate_shapes(incidence_points(two_rings(np.random.default_rng(6))), config)
    assert shapes.radius_m.shape == (2, config.n_samples)


@pytest.mark.parametrize("n", [0, 1, 2, 3, 6])
@pytest.mark.parametrize("spread_m", [0.0, 0.1])
def test_few_points_are_valid(n, spread_m):
    position = np.array([4.0, -1.0]) + spread_m * np.random.default_rng(n).standard_normal((n, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        shapes = estimate_shapes(incidence_points(position), ShapeConfig(min_samples=1, n_samples=12))
        none = estimate_shapes(incidence_points(position), ShapeConfig(min_samples=50, n_samples=12))
    assert shapes.radius_m.shape == (min(n, 1), 12)
    assert np.all(np.isfinite(shapes.radius_m))
    assert np.all(np.isfinite(shapes.radius_std_m))
    assert none.label.tolist() == [-1] * n
    assert none.radius_m.shape == (0, 12)


@pytest.mark.parametrize(
    "wrong", [{"eps_m": 0}, {"min_samples": 0}, {"start": "guess"}, {"n_samples": 2}, {"epsilon": 1}]
)
def test_wrong_configuration_names_the_field(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        ShapeConfig(**wrong)
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        ShapeConfig.paper(**wrong)
