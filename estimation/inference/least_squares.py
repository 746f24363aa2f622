"""Damped Gauss-Newton (Levenberg-Marquardt): one loop for every fit that is not compiled.

A caller states its problem as an attempt: from the present point and a damping to the next point and its cost. The
loop decides what to keep, how to damp the next attempt and when to stop. Problems may be batches of independent
members, each with a damping of its own, and may solve their systems in any way, such as by a Schur complement.

Source: Madsen, Nielsen and Tingleff, "Methods for Non-Linear Least Squares Problems", 2004, section 3.2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Generic, TypeVar

import numpy as np

from scenes.record import BoolArray, FloatArray

Point = TypeVar("Point")
_FLOOR = 1e-12  # on the diagonal of a damped matrix, for parameters without any information


@dataclass(frozen=True)
class Schedule:
    """How `minimise` damps, and when it stops."""

    max_steps: int
    first: float = 1e-3  # damping of the first attempt
    least: float = 1e-9
    largest: float = 1e8  # a member whose attempt fails at more damping than this has converged
    factor: float = 10.0  # by which the damping falls after a good attempt and rises after a poor one
    absolute: float = -np.inf  # a member that gains at most this ...
    relative: float = 0.0  # ... plus this share of its cost has converged
    good: float = 0.0  # an attempt is good with more than this share of the expected gain,
    poor: float = 0.0  # and poor with less than this share


@dataclass(frozen=True)
class Attempt(Generic[Point]):
    """A point to go to, with the costs before and after: a float, or (member,) of a batch.

    Both costs are of the same problem: where weights depend on the point, both hold those of the present one.
    """

    point: Point
    before: Any
    after: Any
    expected: Any = None  # gain by the local model; None where no share of it counts


def _whole(is_better: BoolArray, new: Point, now: Point) -> Point:
    return new if is_better else now


def minimise(
    start: Point,
    attempt: Callable[[Point, Any], Attempt[Point] | None],
    schedule: Schedule,
    choose: Callable[[BoolArray, Point, Point], Point] = _whole,
) -> Point:
    """The point of least cost that damped steps from `start` reach.

    An attempt that raises the cost, or gives NaN, is not kept, so that the cost never rises.

    Parameters
    ----------
    attempt
        Called with the present point and the damping, a float or (member,). None ends the loop: the caller has
        seen that the step is too small to matter.
    choose
        Called with a mask (member,), the new and the present point, gives the new point's members where the mask
        is true. Without it the problem has one member.
    """
    now, damping = start, np.asarray(schedule.first)
    for _ in range(schedule.max_steps):
        tried = attempt(now, damping)
        if tried is None:
            break
        gain = np.asarray(tried.before - tried.after)
        share = np.sign(gain) if tried.expected is None else gain / tried.expected
        better = gain >= 0
        now = choose(better, tried.point, now)
        tolerance = schedule.absolute + schedule.relative * np.abs(tried.before)
        converged = np.where(better, gain <= tolerance, damping > schedule.largest)
        eased = np.where(
            share <= schedule.good, damping, np.maximum(damping / schedule.factor, schedule.least)
        )
        tightened = np.where(share >= schedule.poor, damping, damping * schedule.factor)
        damping = np.where(better & (share >= schedule.poor), eased, tightened)
        if converged.all():
            break
    return now


def damped_step(information: FloatArray, gradient: FloatArray, damping: FloatArray | float) -> FloatArray:
    """Step (..., n) that zeroes a gradient (..., n), the diagonal of the information (..., n, n) raised.

    It is raised by the share `damping` (...) of itself, which makes the step independent of the parameters' units.
    """
    diagonal = np.einsum("...ii->...i", information)
    raised = np.asarray(damping)[..., None] * diagonal + _FLOOR
    matrix = information + raised[..., None] * np.eye(diagonal.shape[-1])
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
