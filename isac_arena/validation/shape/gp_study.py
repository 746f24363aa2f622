"""The paper's synthetic study of the radial Gaussian process: basic shapes, known centre (paper, Fig. 1)."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from estimation.shape.gp.exact import chord
from estimation.shape.gp.radial import RadialGp, fit_radial_gp
from scenes.record import BoolArray, FloatArray

NOISE_STD_M = 0.1
N_POINTS = (4, 8, 16, 32, 64, 128)
STUCK_NOISE_STD_M = 0.2  # a fit that learned twice the true noise took the contour for noise
EXAMPLE_N_POINTS = 64
EXAMPLE_MEAN_M = 1.0  # the printed beta = [4.0, 4.0, 1.0, 0.01] read as [l^2, sigma_f^2, mu, sigma_n^2]
EXAMPLE_BETA = (4.0, 4.0, 0.01)  # sigma_f^2, l^2, sigma_n^2
EXAMPLE_SMALLEST_RADIUS_M = 0.3
EXAMPLE_N_ANGLES = 720

RadialFunction = Callable[[FloatArray], FloatArray]


def _rectangle(angle_rad: FloatArray) -> FloatArray:
    return np.asarray(1 / np.maximum(np.abs(np.cos(angle_rad)) / 2, np.abs(np.sin(angle_rad)) / 1.5))


# Radius in m by polar angle: circle R 2, ellipse with half-axes 2.5 and 1.5, rectangle 4 x 3, five-pointed star.
SHAPES: Mapping[str, RadialFunction] = {
    "circle": lambda angle: np.full_like(angle, 2.0),
    "ellipse": lambda angle: np.asarray(1 / np.hypot(np.cos(angle) / 2.5, np.sin(angle) / 1.5)),
    "rectangle": _rectangle,
    "star": lambda angle: np.asarray(2 + 0.4 * np.cos(5 * angle)),
}

MODES: Mapping[str, Mapping[str, Any]] = {
    "paper": {"start": "paper", "mean_uncertainty": False},
    "data-driven": {"start": "data", "mean_uncertainty": True},
    "with noise floor": {"start": "data", "mean_uncertainty": True, "noise_floor_std_m": NOISE_STD_M},
}


class Runs(NamedTuple):
    """Results of the runs of one mode, shape and number of points."""

    rmse_m: FloatArray  # (run,) at the training angles
    coverage: FloatArray  # (run,) share of the training angles where +-2 standard deviations hold the truth
    is_stuck: BoolArray  # (run,) whether the contour was taken for noise


@dataclass(frozen=True)
class StudyCell:
    """One mode, shape and number of points of the study, averaged over the runs."""

    mode: str
    shape: str
    n_points: int
    n_runs: int
    rmse_m: float
    rmse_error_m: float  # standard error of the mean RMSE
    coverage: float
    stuck_share: float


@dataclass(frozen=True)
class Example:
    """One contour drawn from the prior of the printed parameters, and its fit from 64 points."""

    angle_rad: FloatArray
    true_radius_m: FloatArray  # at angle_rad
    point_angle_rad: FloatArray
    point_radius_m: FloatArray
    mean_m: FloatArray  # fitted, at angle_rad
    std_m: FloatArray
    fit: RadialGp


def draw_points(shape: str, n_points: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Angle and radius (point,) of points of a basic shape: uniform angles, noise of 0.1 m along the radius."""
    angle = rng.uniform(-np.pi, np.pi, n_points)
    return angle, SHAPES[shape](angle) + NOISE_STD_M * rng.standard_normal(n_points)


def run_cell(mode: str, shape: str, n_points: int, n_runs: int, seed: int) -> Runs:
    """Fit `n_runs` draws of a shape; all modes see the same draws of a seed."""
    rng = np.random.default_rng([seed, list(SHAPES).index(shape), n_points])
    runs = [_run(MODES[mode], shape, n_points, rng) for _ in range(n_runs)]
    rmse, coverage, noise_std = np.array(runs).T
    return Runs(rmse, coverage, np.asarray(noise_std > STUCK_NOISE_STD_M))


def _run(
    mode: Mapping[str, Any], shape: str, n_points: int, rng: np.random.Generator
) -> tuple[float, float, float]:
    angle, radius = draw_points(shape, n_points, rng)
    gp = fit_radial_gp(angle, radius, **mode)
    mean, std = gp.predict(angle)
    error = mean - SHAPES[shape](angle)
    return float(np.sqrt(np.mean(error**2))), float(np.mean(np.abs(error) <= 2 * std)), gp.noise_std_m


def study(
    n_runs: int, seed: int, n_points: Sequence[int] = N_POINTS, modes: Iterable[str] = tuple(MODES)
) -> Iterator[StudyCell]:
    """Fig. 1c: RMSE against the number of points for every shape and mode, cell by cell."""
    for mode in modes:
        for shape in SHAPES:
            for n in n_points:
                runs = run_cell(mode, shape, n, n_runs, seed)
                rmse_m, coverage, stuck_share = (float(values.mean()) for values in runs)
                rmse_error_m = float(runs.rmse_m.std() / np.sqrt(n_runs))
                yield StudyCell(mode, shape, n, n_runs, rmse_m, rmse_error_m, coverage, stuck_share)


def example(seed: int, mode: str) -> Example:
    """Fig. 1a and 1b: a star-convex contour with the printed parameters seen through 64 noisy points.

    The contour is drawn from the prior, again until it stays 0.3 m from its centre.
    """
    rng = np.random.default_rng(seed)
    angle = np.linspace(-np.pi, np.pi, EXAMPLE_N_ANGLES, endpoint=False)
    signal_variance, length_squared, noise_variance = EXAMPLE_BETA
    covariance = signal_variance * np.exp(-chord(angle, angle) / length_squared)
    value, vector = np.linalg.eigh(covariance)
    root = vector * np.sqrt(np.maximum(value, 0))
    radius = np.zeros(len(angle))
    while radius.min() < EXAMPLE_SMALLEST_RADIUS_M:
        radius = EXAMPLE_MEAN_M + root @ rng.standard_normal(len(angle))
    chosen = rng.choice(len(angle), EXAMPLE_N_POINTS, replace=False)
    measured = radius[chosen] + np.sqrt(noise_variance) * rng.standard_normal(EXAMPLE_N_POINTS)
    fit = fit_radial_gp(angle[chosen], measured, **MODES[mode])
    mean, std = fit.predict(angle)
    return Example(angle, radius, angle[chosen], measured, mean, std, fit)
