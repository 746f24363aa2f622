"""The bordered banded solver against dense linear algebra."""

import numpy as np
import pytest

from estimation.inference.arrow import ArrowSystem


def random_system(rng, n: int, shared: int) -> tuple[ArrowSystem, np.ndarray]:
    """A system and its dense information matrix."""
    rows = []
    for k in range(n):
        for _ in range(12):
            row = np.zeros(4 * n + shared)
            row[4 * k : 4 * min(k + 3, n)] = rng.normal(size=4 * (min(k + 3, n) - k))
            row[4 * n :] = rng.normal(size=shared)
            rows.append(row)
    dense = np.array(rows).T @ np.array(rows)
    block = dense[: 4 * n, : 4 * n].reshape(n, 4, n, 4).swapaxes(1, 2)
    k = np.arange(n)
    gradient = rng.normal(size=4 * n + shared)
    return (
        ArrowSystem(
            block[k, k],
            block[k[:-1], k[1:]],
            block[k[:-2], k[2:]],
            dense[: 4 * n, 4 * n :].reshape(n, 4, shared),
            dense[4 * n :, 4 * n :],
            gradient[: 4 * n].reshape(n, 4),
            gradient[4 * n :],
        ),
        dense,
    )


@pytest.mark.parametrize("n", [1, 2, 3, 6, 9])
@pytest.mark.parametrize("shared", [0, 5])
def test_solution_and_marginals_are_those_of_the_dense_matrix(n, shared):
    system, dense = random_system(np.random.default_rng(n), n, shared)
    gradient = np.concatenate([system.gradient.ravel(), system.shared_gradient])
    states, rest = system.solve()
    np.testing.assert_allclose(np.concatenate([states.ravel(), rest]), -np.linalg.solve(dense, gradient))
    inverse = np.linalg.inv(dense)
    blocks, corner, across = system.covariance()
    for k in range(n):
        np.testing.assert_allclose(blocks[k], inverse[4 * k : 4 * k + 4, 4 * k : 4 * k + 4], rtol=1e-6)
        np.testing.assert_allclose(across[k], inverse[4 * k : 4 * k + 4, 4 * n :], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(corner, inverse[4 * n :, 4 * n :], rtol=1e-6)
    assert system.log_determinant() == pytest.approx(np.linalg.slogdet(dense)[1])


def one_strong_row(strength: float) -> ArrowSystem:
    """The state of a stop that a single path observes, beside a weak prior."""
    row = np.array([0.6, -0.5, 0.6, 0.2])
    block = np.eye(4) * 1e-2 + strength * np.outer(row, row)
    none = np.empty((0, 4, 4))
    return ArrowSystem(
        block[None], none, none, np.empty((1, 4, 0)), np.empty((0, 0)), row[None], np.empty(0)
    )  # fmt: skip


@pytest.mark.parametrize("strength", [1e15, 1e16, 1e17, 1e18])
def test_a_path_of_far_more_information_than_the_rest_breaks_no_solution(strength):
    system = one_strong_row(strength)
    states, _ = system.solve()
    assert np.abs(system.diagonal[0] @ states[0] + system.gradient[0]).max() < 1e-2
    assert np.isfinite(system.log_determinant())


def test_a_matrix_that_is_indefinite_by_more_than_rounding_is_refused():
    system = one_strong_row(-1.0)
    with pytest.raises(np.linalg.LinAlgError, match="stop 0 is not positive definite"):
        system.solve()
