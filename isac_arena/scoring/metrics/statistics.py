"""Summary statistics that ignore NaN entries; they are NaN, without a warning, where no entry is finite."""

from itertools import pairwise
from typing import Any

import numpy as np

from scenes.record import FloatArray, IntArray


def finite_entries(values: Any) -> FloatArray:
    """The finite entries (n,) as floats."""
    array = np.asarray(values, float).ravel()
    return np.asarray(array[np.isfinite(array)])


def mean(values: Any) -> float:
    """Arithmetic mean."""
    kept = finite_entries(values)
    return float(kept.mean()) if len(kept) else float("nan")


def rms(values: Any) -> float:
    """Root mean square."""
    return float(np.sqrt(mean(np.square(np.asarray(values, float)))))


def quantile(values: Any, level: float) -> float:
    """Quantile in [0, 1], linear between order statistics."""
    kept = finite_entries(values)
    return float(np.quantile(kept, level)) if len(kept) else float("nan")


def maximum(values: Any) -> float:
    """Largest entry."""
    return quantile(values, 1.0)


def ratio(part: float, whole: float) -> float:
    """Part over whole; NaN where the whole is zero."""
    return float(part) / float(whole) if whole else float("nan")


def squared_mahalanobis(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Squared Mahalanobis distance e' C^-1 e (n,) of errors (n, k) with covariances (n, k, k).

    Errors are normalised by their standard deviations first, because parameters of very different size (seconds
    and radians) make the inverse inaccurate. NaN where a variance is not positive.
    """
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    usable = (variance > 0).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    usable &= np.isfinite(error).all(axis=1)
    result = np.full(len(error), np.nan)
    std = np.sqrt(variance[usable])
    correlation = covariance[usable] / (std[:, :, None] * std[:, None, :])
    normalised = error[usable] / std
    inverse = np.linalg.pinv(correlation, hermitian=True)
    result[usable] = np.einsum("ni,nij,nj->n", normalised, inverse, normalised)
    return result


def rows_of_groups(label: IntArray, n_groups: int) -> list[IntArray]:
    """Rows (member,) of each group in their order, of labels (row,); negative labels are of no group.

    One sort for all groups: a mask of all rows for each group costs their product.
    """
    order = np.argsort(label, kind="stable")
    bounds = np.searchsorted(label[order], np.arange(n_groups + 1))
    return [order[first:last] for first, last in pairwise(bounds)]
