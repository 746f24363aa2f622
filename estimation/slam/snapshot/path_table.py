"""The paths of one stop and the prior of their kinds, in the form that the compiled functions take."""

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from estimation.inference.least_squares import student_t_efficiency
from estimation.laws.plane import FEASIBLE_STDS
from estimation.slam.config import Mixture
from estimation.slam.snapshot.problem import SnapshotProblem
from scenes.record import FloatArray

WALL_ANGLE_STD_DEG = 0.5  # between walls that count as parallel or perpendicular
_EARLY_STDS = 3.0  # of the range, by which a path may seem shorter than the straight line


class PathTable(NamedTuple):
    """Paths of one stop with all terms that do not depend on the state.

    `mean` and `half` are (departure + arrival) / 2 and (arrival - departure) / 2 for an RX heading of zero.
    """

    range_m: FloatArray  # (path,)
    mean: FloatArray  # (path, 2) sine, cosine
    half: FloatArray  # (path, 2) sine, cosine
    covariance: FloatArray  # (path, 3, 3) in (m, rad, rad)^2
    slack_rad: FloatArray  # (path,) by which an IP may be outside the devices' rays
    early_m: FloatArray  # (path,) by which a path may seem shorter than the straight line
    tilt_variance: FloatArray  # (path,) rad^2, of departure against arrival for a bounce off two walls


class LineOfSight(NamedTuple):
    """The path taken as line of sight: its number, -1 for none, its measurement and inv(chol(R))."""

    path: int
    measured: FloatArray  # (3,) range, departure and arrival; departure in the world frame
    whitening: FloatArray  # (3, 3)


class PathModel(NamedTuple):
    """Prior of the kinds of paths, with densities relative to that of clutter."""

    single_peak: float  # m; share of single bounces times the density of a zero residual of variance 1 m^2
    double_peak: float  # rad; the same of bounces off two walls and the angle between departure and arrival
    clutter_share: float
    degrees_of_freedom: int
    efficiency: float  # of the Student-t estimate under Gaussian errors


def path_table(problem: SnapshotProblem, mixture: Mixture) -> PathTable:
    """The paths of a problem in the form that the compiled functions take."""
    departure, arrival, covariance = problem.departure_rad, problem.measured[:, 2], problem.covariance
    wall = np.deg2rad(WALL_ANGLE_STD_DEG)
    mean, half = (departure + arrival) / 2, (arrival - departure) / 2
    return PathTable(
        np.ascontiguousarray(problem.measured[:, 0]),
        np.column_stack([np.sin(mean), np.cos(mean)]),
        np.column_stack([np.sin(half), np.cos(half)]),
        covariance,
        FEASIBLE_STDS * np.sqrt(covariance[:, 1, 1] + covariance[:, 2, 2]),
        _EARLY_STDS * np.sqrt(covariance[:, 0, 0]),
        covariance[:, 1, 1] + covariance[:, 2, 2] - 2 * covariance[:, 1, 2] + wall**2,
    )


def line_of_sight(problem: SnapshotProblem, los: int) -> LineOfSight:
    """The path of that index as line of sight; -1 for none."""
    if los < 0:
        return LineOfSight(-1, np.zeros(3), np.zeros((3, 3)))
    measured = problem.measured[los].copy()
    measured[1] = problem.departure_rad[los]
    return LineOfSight(los, measured, np.linalg.inv(np.linalg.cholesky(problem.covariance[los])))


def path_model(mixture: Mixture) -> PathModel:
    """Constants of the mixture of single bounces, double bounces and clutter."""
    freedom = mixture.degrees_of_freedom
    share = 1.0 - mixture.clutter_share - mixture.double_share
    return PathModel(
        single_peak=share * mixture.clutter_width_m * student_peak(freedom),
        double_peak=mixture.double_share * float(np.sqrt(np.pi / 2)),
        clutter_share=mixture.clutter_share,
        degrees_of_freedom=freedom,
        efficiency=student_t_efficiency(freedom, 1),
    )


@cache
def student_peak(degrees_of_freedom: int) -> float:
    """Density at zero of the Student-t law of unit scale."""
    nu = degrees_of_freedom
    return float(np.exp(gammaln((nu + 1) / 2) - gammaln(nu / 2)) / np.sqrt(np.pi * nu))
