import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.shape.config import CentroidBias
from estimation.shape.gp.clustering import apply_biases, centroids, cluster_points, radial_variance, to_polar


def blobs(rng):
    """Clusters of 12, 8 and 8 points and two lone points, shuffled."""
    parts = [(3.0, 1.0, 12), (-4.0, 2.0, 8), (-4.0, -6.0, 8), (20.0, 20.0, 1), (-20.0, 5.0, 1)]
    position = np.concatenate([(x, y) + 0.1 * rng.standard_normal((n, 2)) for x, y, n in parts])
    return rng.permutation(position)


def brute_force_dbscan(position, eps_m, min_samples):
    """The clusters of core points by their definition: connected components of the core points' eps graph."""
    near = np.linalg.norm(position[:, None] - position[None], axis=-1) <= eps_m
    core = near.sum(axis=1) >= min_samples
    reach = near & core[:, None] & core[None, :]
    for _ in position:
        reach = reach | (reach.astype(int) @ reach.astype(int) > 0)
    is_noise = ~(near[:, core].any(axis=1))
    return core, reach, is_noise


def test_clusters_are_numbered_by_size_then_position():
    position = blobs(np.random.default_rng(1))
    label = cluster_points(position, 0.6, 5)
    assert np.bincount(label + 1).tolist() == [2, 12, 8, 8]
    x_order = centroids(position, label)[1:, 0]
    assert x_order[0] < x_order[1]
    np.testing.assert_allclose(centroids(position, label)[0], [3, 1], atol=0.15)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_numbering_does_not_depend_on_the_order_of_the_points(seed):
    rng = np.random.default_rng(seed)
    position = blobs(rng)
    shuffle = rng.permutation(len(position))
    label = cluster_points(position, 0.6, 5)
    np.testing.assert_array_equal(cluster_points(position[shuffle], 0.6, 5), label[shuffle])


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 30), min_samples=st.integers(1, 5))
@settings(max_examples=40, deadline=None)
def test_labels_meet_the_definition_of_dbscan(seed, n, min_samples):
    position = np.random.default_rng(seed).uniform(0, 4, (n, 2))
    label = cluster_points(position, 0.6, min_samples)
    core, reach, is_noise = brute_force_dbscan(position, 0.6, min_samples)
    np.testing.assert_array_equal(label == -1, is_noise)
    same = label[:, None] == label[None, :]
    np.testing.assert_array_equal(same[np.ix_(core, core)], reach[np.ix_(core, core)])
    size = np.bincount(label[label >= 0])
    assert np.all(np.diff(size) <= 0)
    assert np.all(size > 0)


def test_no_points_and_only_noise_are_valid():
    assert cluster_points(np.zeros((0, 2)), 0.6, 5).shape == (0,)
    far = np.array([[0.0, 0.0], [9.0, 0.0]])
    assert cluster_points(far, 0.6, 2).tolist() == [-1, -1]
    assert centroids(far, np.array([-1, -1])).shape == (0, 2)
    assert apply_biases(np.zeros((0, 2)), [CentroidBias(near_m=(0, 0), bias_m=(1, 0))]).shape == (0, 2)


def test_bias_goes_to_the_cluster_near_its_place_whatever_its_number():
    bias = CentroidBias(near_m=(5.1, 0.2), bias_m=(-1.0, 0.5))
    centroid = np.array([[0.0, 0.0], [5.0, 0.0], [9.0, 9.0]])
    for order in ([0, 1, 2], [2, 0, 1]):
        shift = apply_biases(centroid[order], [bias]) - centroid[order]
        np.testing.assert_allclose(shift[order.index(1)], [-1.0, 0.5])
        assert np.count_nonzero(shift) == 2


def test_bias_of_a_missing_cluster_is_not_used_and_biases_add_up():
    centroid = np.array([[0.0, 0.0]])
    far = CentroidBias(near_m=(5.0, 0.0), bias_m=(1.0, 0.0))
    np.testing.assert_array_equal(apply_biases(centroid, [far]), centroid)
    near = CentroidBias(near_m=(0.5, 0.0), bias_m=(1.0, 2.0))
    np.testing.assert_allclose(apply_biases(centroid, [near, near]), [[2.0, 4.0]])


@given(x=st.floats(-20, 20), y=st.floats(-20, 20), angle=st.floats(-np.pi, np.pi), radius=st.floats(1e-3, 20))
def test_polar_form_inverts(x, y, angle, radius):
    center = np.array([x, y])
    point = center + radius * np.array([np.cos(angle), np.sin(angle)])
    found_angle, found_radius = to_polar(point[None], center)
    assert found_radius[0] == pytest.approx(radius, abs=1e-12, rel=1e-9)
    np.testing.assert_allclose(np.exp(1j * (found_angle[0] - angle)), 1, atol=1e-9)


def test_radial_variance_of_an_ellipse():
    along, across = 0.3**2, 0.1**2
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    covariance = np.tile(turn @ np.diag([along, across]) @ turn.T, (3, 1, 1))
    variance = radial_variance(covariance, np.array([0.7, 0.7 + np.pi / 2, 0.7 + np.pi / 4]))
    np.testing.assert_allclose(variance, [along, across, (along + across) / 2])
