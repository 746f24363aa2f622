"""Solutions and inverses of normal equations whose columns have different units, by Cholesky factors."""

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotri

from scenes.record import FloatArray

TINY = 1e-12  # relative ridge that keeps normal equations of coinciding paths solvable
SMALLEST = 1e-150  # diagonal of an unobservable parameter


def solve_positive(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of normal equations by Cholesky, or by elimination if rounding makes them indefinite."""
    _, solution, failed = dposv(matrix.T, right)  # symmetric: its transpose is in the order of LAPACK
    return np.asarray(np.linalg.solve(matrix, right) if failed else solution)


def regular_inverse(information: FloatArray) -> FloatArray:
    """Inverse of a positive semidefinite matrix; directions without information become large, but finite."""
    scale = unit_scale(np.diagonal(information))
    root, failed = dpotrf(scaled_matrix(information, scale, TINY).T, overwrite_a=True)
    if failed or not len(scale):
        return scaled_matrix(np.asarray(np.linalg.inv(scaled_matrix(information, scale, TINY))), scale)
    half, _ = dpotri(root, overwrite_c=True)  # the upper triangle, above zeros
    np.fill_diagonal(half, np.diagonal(half) / 2)
    return scaled_matrix(half + half.T, scale)


def scaled_matrix(matrix: FloatArray, scale: FloatArray, added: float = 0.0) -> FloatArray:
    """A matrix with rows and columns scaled; `added` to its diagonal then."""
    scaled = matrix * scale
    scaled *= scale[:, None]
    scaled[np.diag_indices_from(scaled)] += added
    return scaled


def unit_scale(diagonal: FloatArray) -> FloatArray:
    """Scale that makes the diagonal of a matrix one: units of the columns differ as amplitudes and angles do."""
    return np.asarray(1 / np.sqrt(np.maximum(diagonal, SMALLEST)))
