"""Every method on points alone: valid answers on good, few and degenerate points; equivariance; clear errors."""

import warnings

import numpy as np
import pytest

from estimation.shape.points.cluster import PointCluster
from estimation.shape.points.methods import POINT_METHODS
from isac_arena.scoring.metrics.contours import intersection_over_union

CENTER_M, RADIUS_M = np.array([1.0, -2.0]), 0.6


def cluster(position, std=0.05, sensor=(-5.0, -2.0)):
    position = np.asarray(position, float)
    covariance = np.broadcast_to(std**2 * np.eye(2), (len(position), 2, 2))
    return PointCluster(position_m=position, covariance_m2=covariance, sensor_m=np.asarray(sensor))


def circle_points(n, std=0.02, seed=0, arc_rad=2 * np.pi):
    rng = np.random.default_rng(seed)
    angle = np.pi + arc_rad * (rng.random(n) - 0.5)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return CENTER_M + RADIUS_M * unit + std * rng.standard_normal((n, 2))


DEGENERATE = {
    "one": [[1.0, 2.0]],
    "two": [[1.0, 2.0], [1.2, 2.0]],
    "three": [[1.0, 2.0], [1.2, 2.0], [1.1, 2.3]],
    "collinear": [[0.1 * k, 0.2 * k] for k in range(8)],
    "duplicates": [[1.0, 2.0]] * 6,
    "at_the_sensor": [[-5.0, -2.0]] * 4,
    "far_apart": [[0.0, 0.0], [40.0, 0.0], [0.0, 40.0], [40.0, 41.0]],
}


@pytest.mark.parametrize("method", POINT_METHODS)
@pytest.mark.parametrize("case", DEGENERATE)
def test_degenerate_clusters_get_a_status(method, case):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit = POINT_METHODS[method](cluster(DEGENERATE[case]))
    if fit.is_usable:
        assert np.isfinite(fit.contour_m).all()
        assert method == "convex_hull" or (fit.std_m >= 0).all()
    else:
        assert fit.contour_m.shape == (0, 2)


@pytest.mark.parametrize("method", ["mic", "recursive_gp", "star_convex_rhm", "circle"])
def test_a_circle_seen_all_around_is_found(method):
    points = cluster(circle_points(60), std=0.02)
    points = (
        PointCluster(points.position_m, points.covariance_m2, np.full(2, np.nan)) if method == "mic" else points
    )
    fit = POINT_METHODS[method](points)
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    truth = CENTER_M + RADIUS_M * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert intersection_over_union(fit.contour_m, truth) > 0.93


@pytest.mark.parametrize("method", ["mic", "recursive_gp", "prior_only", "random_matrix", "line", "paper_gp"])
def test_closed_contours_run_counter_clockwise_and_turn_with_the_points(method):
    turn = 0.7
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    position = circle_points(25, arc_rad=1.8)
    straight = POINT_METHODS[method](cluster(position))
    turned = POINT_METHODS[method](cluster(position @ rotation.T, sensor=rotation @ [-5.0, -2.0]))
    assert turned.extent_m == pytest.approx(straight.extent_m, rel=0.03)
    if straight.is_closed:
        back = turned.contour_m @ rotation
        assert intersection_over_union(back, straight.contour_m) > 0.97
        x, y = straight.contour_m.T
        assert np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0


@pytest.mark.parametrize(
    ("position", "covariance", "named"),
    [
        (np.zeros((0, 2)), np.zeros((0, 2, 2)), "no point"),
        ([[np.nan, 0.0]], [np.eye(2)], "position_m"),
        ([[0.0, 0.0]], [np.full((2, 2), np.inf)], "covariance_m2"),
        ([[0.0, 0.0]], [np.diag([1.0, -1.0])], "positive definite"),
        ([[0.0, 0.0]], [[[1.0, 0.5], [0.0, 1.0]]], "symmetric"),
    ],
)
def test_bad_points_are_named(position, covariance, named):
    with pytest.raises(ValueError, match=named):
        PointCluster(np.asarray(position, float), np.asarray(covariance, float), np.zeros(2))
