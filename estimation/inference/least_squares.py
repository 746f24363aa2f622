"""Damped Gauss-Newton (Levenberg-Marquardt): one loop for every fit that is not compiled.

A caller gives a function `attempt` that takes the present point and a damping and returns the next point and its
cost. The loop decides which points to keep, how to damp the next attempt and when to stop. A problem may be a
batch of independent members with one damping each. It may solve its system in any way, such as by a Schur
complement.

Source: Madsen, Nielsen and Tingleff, "Methods for Non-Linear Least Squares Problems", 2004, section 3.2.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Generic, TypeVar

import numpy as np
from scipy.special import gammaln

from scenes.record import BoolArray, FloatArray

Point = TypeVar("Point")
_FLOOR = 1e-12  # added to the diagonal of a damped matrix, for parameters without information


@dataclass(frozen=True)
class Schedule:
    """How `minimise` damps, and when it stops."""

    max_steps: int
    first: float = 1e-3  # damping of the first attempt
    least: float = 1e-9
    largest: float = 1e8  # a member whose attempt fails at a larger damping has converged
    factor: float = 10.0  # the damping falls by it after a good attempt and rises by it after a poor one
    absolute: float = -np.inf  # a member has converged where its gain is at most this
    relative: float = 0.0  # plus this share of its cost
    good: float = 0.0  # an attempt is good above this share of the expected gain,
    poor: float = 0.0  # and poor below this share


@dataclass(frozen=True)
class Attempt(Generic[Point]):
    """A trial point with the costs before and after: a float, or (member,) of a batch.

    Both costs are of the same problem: weights that depend on the point are those of the present point.
    """

    point: Point
    before: Any
    after: Any
    expected: Any = None  # gain by the local model; None: every fall of the cost is good


def minimise(start: Point, attempt: Callable[[Point, Any], Attempt[Point] | None], schedule: Schedule) -> Point:
    """The point of least cost that damped steps from `start` reach.

    An attempt that increases the cost, or gives NaN, is not kept. So the cost never increases. The point of a
    batch is an array (member, ...) or nested tuples of such arrays.

    Parameters
    ----------
    attempt
        Takes the present point and the damping, a float or (member,). It returns None to end the loop where the
        step is negligible.
    """
    now, damping = start, np.asarray(schedule.first)
    for _ in range(schedule.max_steps):
        tried = attempt(now, damping)
        if tried is None:
            break
        gain = np.asarray(tried.before - tried.after)
        share = np.sign(gain) if tried.expected is None else gain / tried.expected
        better = gain >= 0
        now = _by_member(better, tried.point, now)
        tolerance = schedule.absolute + schedule.relative * np.abs(tried.before)
        converged = np.where(better, gain <= tolerance, damping > schedule.largest)
        eased = np.where(share <= schedule.good, damping, np.maximum(damping / schedule.factor, schedule.least))
        tightened = np.where(share >= schedule.poor, damping, damping * schedule.factor)
        damping = np.where(better & (share >= schedule.poor), eased, tightened)
        if converged.all():
            break
    return now


def _by_member(is_better: BoolArray, new: Any, now: Any) -> Any:
    """Members of `new` where the mask () or (member,) is true, else of `now`."""
    if is_better.ndim == 0:
        return new if is_better else now
    if isinstance(new, tuple):
        parts = [_by_member(is_better, *pair) for pair in zip(new, now, strict=True)]
        return type(new)(*parts) if hasattr(new, "_fields") else tuple(parts)
    return np.where(is_better.reshape(-1, *(1,) * (new.ndim - 1)), new, now)


def damped_step(information: FloatArray, gradient: FloatArray, damping: FloatArray | float) -> FloatArray:
    """Step (..., n) that zeroes a gradient (..., n) under the damped information (..., n, n).

    The share `damping` (...) of the diagonal is added to it, so that the step does not depend on units.
    """
    diagonal = np.einsum("...ii->...i", information)
    added = np.asarray(damping)[..., None] * diagonal + _FLOOR
    matrix = information + added[..., None] * np.eye(diagonal.shape[-1])
    return -np.linalg.solve(matrix, gradient[..., None])[..., 0]


@cache
def student_t_efficiency(degrees_of_freedom: float, dimension: int) -> float:
    """Information of a Student-t estimate of whitened Gaussian errors over that of least squares.

    (E[div psi] / d)^2 / (E|psi|^2 / d) of psi(z) = z / (nu + |z|^2) for a standard normal z in d dimensions: the
    asymptotic variance of Huber, Robust Statistics, section 3.2.
    """
    nu, d = degrees_of_freedom, dimension
    radius = np.linspace(0.0, 9.0 + np.sqrt(d), 4001)
    square, share = radius**2, radius ** (d - 1) * np.exp(-(radius**2) / 2)
    share = share / share.sum()
    slope = np.sum(share * (nu + square - 2 * square / d) / (nu + square) ** 2)
    return float(slope**2 / np.sum(share * square / d / (nu + square) ** 2))


@cache
def student_t_log_peak(degrees_of_freedom: float, dimension: int) -> float:
    """Log density at zero of the Student-t law of unit scale."""
    nu, d = degrees_of_freedom, dimension
    return float(gammaln((nu + d) / 2) - gammaln(nu / 2) - 0.5 * d * np.log(nu * np.pi))
