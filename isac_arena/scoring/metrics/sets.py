"""Distances between finite sets of different size: OSPA and GOSPA.

Both take the matrix of base distances between estimates and truths, so one definition serves paths, landmarks and
objects. Their unit is that of the base distance.
"""

from dataclasses import dataclass

import numpy as np

from scenes.record import FloatArray, IntArray


@dataclass(frozen=True)
class Gospa:
    """GOSPA and its parts, in units of the base distance: value^p = localisation^p + missed^p + false^p."""

    value: float
    localisation: float
    missed: float
    false: float
    n_missed: int
    n_false: int
    true_index: IntArray  # (estimate,) truth assigned to each estimate, -1 for none


def gospa(distance: FloatArray, cutoff: float, order: float = 2.0) -> Gospa:
    """Generalised OSPA with alpha = 2 of the base distances (estimate, truth).

    min over one-to-one assignments of sum d^p + (c^p / 2) (missed + false), to the power 1/p. A pair at
    `cutoff` c or beyond costs as much as a miss and a false estimate and is not assigned. Source:
    Rahmathullah, Garcia-Fernandez and Svensson, "Generalized optimal sub-pattern assignment metric", FUSION
    2017, proposition 1.

    Raises `ValueError` for a cutoff that is not positive, an order below 1, or distances that are negative or
    NaN.
    """
    assigned = _assignment(distance, cutoff, order)
    index = np.full(distance.shape[0], -1)
    index[assigned[0]] = assigned[1]
    localisation = float((distance[assigned] ** order).sum())
    n_false = distance.shape[0] - len(assigned[0])
    n_missed = distance.shape[1] - len(assigned[0])
    missed, false = cutoff**order / 2 * n_missed, cutoff**order / 2 * n_false
    root = 1 / order
    return Gospa(
        value=(localisation + missed + false) ** root,
        localisation=localisation**root,
        missed=missed**root,
        false=false**root,
        n_missed=n_missed,
        n_false=n_false,
        true_index=index,
    )


def ospa(distance: FloatArray, cutoff: float, order: float = 2.0) -> float:
    """OSPA of the base distances (estimate, truth): 0 for equal sets, `cutoff` at the most.

    (1/n (min sum min(d, c)^p + c^p |n - m|))^(1/p) with n the larger cardinality; two empty sets are at
    distance 0. Source: Schuhmacher, Vo and Vo, "A consistent metric for performance evaluation of multi-
    object filters", IEEE Trans. Signal Processing 56(8), 2008, equation (3). Raises `ValueError` as `gospa`
    does.
    """
    n_assigned = len(_assignment(distance, cutoff, order)[0])
    larger = max(distance.shape)
    if larger == 0:
        return 0.0
    assigned = _assignment(distance, cutoff, order)
    total = float((distance[assigned] ** order).sum()) + cutoff**order * (larger - n_assigned)
    return float((total / larger) ** (1 / order))


def _assignment(distance: FloatArray, cutoff: float, order: float) -> tuple[IntArray, IntArray]:
    """Rows and columns of the pairs of the best assignment that are closer than the cutoff."""
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415  (slow to import)

    if not cutoff > 0 or not order >= 1:
        raise ValueError(f"cutoff = {cutoff:g}, order = {order:g}: cutoff > 0 and order >= 1 are needed")
    if np.isnan(distance).any() or (distance < 0).any():
        raise ValueError("distance: must be at least 0 and not NaN everywhere")
    rows, columns = linear_sum_assignment(np.minimum(distance, cutoff) ** order)
    close = distance[rows, columns] < cutoff
    return rows[close], columns[close]
