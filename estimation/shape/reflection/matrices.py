"""Algebra of small symmetric matrices for compiled code; all write into given arrays."""

import numpy as np

from estimation.execution import compiled
from scenes.record import FloatArray


@compiled
def inverse3(matrix: FloatArray, inverse: FloatArray) -> float:
    """Write the inverse of a symmetric matrix (3, 3) by its cofactors; returns the determinant."""
    a, b, c = matrix[0, 0], matrix[1, 0], matrix[2, 0]
    d, e, f = matrix[1, 1], matrix[2, 1], matrix[2, 2]
    first, second, third = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * first + b * second + c * third
    inverse[0, 0], inverse[1, 1], inverse[2, 2] = first, a * f - c * c, a * d - b * b
    inverse[0, 1] = inverse[1, 0] = second
    inverse[0, 2] = inverse[2, 0] = third
    inverse[1, 2] = inverse[2, 1] = b * c - a * e
    for j in range(3):
        for k in range(3):
            inverse[j, k] /= determinant
    return float(determinant)


@compiled
def cholesky(matrix: FloatArray) -> bool:
    """Replace the lower triangle of a matrix by its Cholesky factor; false where it is not positive definite."""
    for j in range(len(matrix)):
        for i in range(j, len(matrix)):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i > j:
                matrix[i, j] = total / matrix[j, j]
            elif total > 0:
                matrix[j, j] = np.sqrt(total)
            else:
                return False
    return True


@compiled
def solve_lower(factor: FloatArray, right: FloatArray) -> None:
    """Replace a vector by the inverse of a matrix with this Cholesky factor, times the vector."""
    n = len(right)
    for i in range(n):
        for k in range(i):
            right[i] -= factor[i, k] * right[k]
        right[i] /= factor[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            right[i] -= factor[k, i] * right[k]
        right[i] /= factor[i, i]
