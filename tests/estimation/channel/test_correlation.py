"""Pairs of paths with correlated errors: what is kept, renumbering, and back to a dense matrix."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from estimation.channel.correlation import LEAST_CORRELATION, correlated_paths


def joint_covariance(seed: int, n_paths: int = 6, n_parameters: int = 3) -> np.ndarray:
    """A joint covariance (path, parameter, path, parameter) with strong and weak correlations."""
    root = np.random.default_rng(seed).standard_normal((n_paths * n_parameters, 4 * n_paths * n_parameters))
    root[: 2 * n_parameters, :3] *= 30.0
    return (root @ root.T).reshape(n_paths, n_parameters, n_paths, n_parameters)


def test_the_correlated_pairs_come_back_and_no_others() -> None:
    joint = joint_covariance(1)
    dense = correlated_paths(joint).dense(6)
    std = np.sqrt(np.einsum("papa->pa", joint))
    for one in range(6):
        for two in range(6):
            block = joint[one, :, two]
            largest = np.abs(block / (std[one][:, None] * std[two])).max()
            expected = block if one != two and largest > LEAST_CORRELATION else np.zeros((3, 3))
            np.testing.assert_array_equal(dense[one, two], expected)


@given(seed=st.integers(0, 20), order=st.permutations(range(6)), n_kept=st.integers(0, 6))
def test_pairs_follow_their_paths_whatever_the_order(seed: int, order: list[int], n_kept: int) -> None:
    pairs, index = correlated_paths(joint_covariance(seed)), np.array(order[:n_kept], int)
    taken = pairs.of_paths(6, index)
    assert (taken.first < taken.second).all()
    np.testing.assert_array_equal(taken.dense(n_kept), pairs.dense(6)[index][:, index])


def test_a_mask_takes_pairs_as_indices_do() -> None:
    pairs, mask = correlated_paths(joint_covariance(3)), np.array([True, False, True, True, False, True])
    one, two = pairs.of_paths(6, mask), pairs.of_paths(6, np.flatnonzero(mask))
    np.testing.assert_array_equal(one.dense(4), two.dense(4))
