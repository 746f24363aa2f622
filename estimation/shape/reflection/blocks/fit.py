"""Models of a group of points - a column, a box, a plate, a spot - and their evidence by Laplace's method.

A column is a square block of the size of a pillar, a box any block, a plate a thin one, a spot a corner or what
else is small. Some of the points are of other origin, anywhere about the group.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import minimize

from estimation.distributions import normal_log_density
from estimation.shape.config import ReflectionConfig
from estimation.shape.reflection.blocks.law import SeenPoints, log_block, log_spot
from scenes.record import FloatArray

_N_TURNS = 8  # directions of the starts
_OTHERS, _AROUND_M = 0.3, 1.0  # share of points of other origin; margin of the area where they are
_STEP = 1e-4  # of the slopes, in m, rad and logarithms
_LIMITS_M = (1e-3, 30.0)  # of sizes
_PLATE_M, _SPOT_M = 0.05, 0.1  # half depth of plates; median spread of spots
# Median and deviation of the logarithm of half the sides of boxes and plates, of the spread of spots.
_BOX_M, _BOX_LOG_STD, _PLATE_LENGTH_M, _PLATE_LOG_STD, _SPOT_LOG_STD = 0.5, 0.6, 1.2, 0.7, 1.0


@dataclass(frozen=True)
class BlockModel:
    """A model: its blocks from its parameters [x, y, logarithms of sizes ..., turn], and the prior of these."""

    size_m: tuple[float, ...]  # medians
    log_std: tuple[float, ...]
    turns_rad: float  # all turns below are different
    block: Callable[[FloatArray], FloatArray]  # (row, parameter) to (row, 5); (row, 3) of a spot

    def log_prior(self, value: FloatArray, area_m2: float) -> FloatArray:
        """Log density (row,) of parameters (row, parameter)."""
        sizes = value[:, 2 : 2 + len(self.size_m)]
        parts = zip(sizes.T, self.size_m, self.log_std, strict=True)
        of_sizes = np.sum([normal_log_density(size, np.log(median), std) for size, median, std in parts], axis=0)
        return np.asarray(of_sizes - np.log(area_m2) - (np.log(self.turns_rad) if self.turns_rad else 0.0))


@dataclass(frozen=True)
class BlockFit:
    """The maximum of the posterior of a model, its covariance and evidence, and its share of every point."""

    value: FloatArray  # (parameter,)
    covariance: FloatArray
    log_evidence: float
    member: FloatArray  # (point,)


def block_models(config: ReflectionConfig) -> dict[str, BlockModel]:
    """The models by name, the column first; its size is that of pillars."""
    side, std = config.radius_median_m, config.radius_log_std

    def square(value: FloatArray) -> FloatArray:
        return np.column_stack([value[:, :2], _sizes_m(value[:, [2, 2]]), value[:, 3]])

    def box(value: FloatArray) -> FloatArray:
        return np.column_stack([value[:, :2], _sizes_m(value[:, 2:4]), value[:, 4]])

    def plate(value: FloatArray) -> FloatArray:
        thin = np.full(len(value), _PLATE_M)
        return np.column_stack([value[:, :2], _sizes_m(value[:, 2]), thin, value[:, 3]])

    def spot(value: FloatArray) -> FloatArray:
        return np.column_stack([value[:, :2], _sizes_m(value[:, 2])])

    return {
        "column": BlockModel((side,), (std,), np.pi / 2, square),
        "spot": BlockModel((_SPOT_M,), (_SPOT_LOG_STD,), 0.0, spot),
        "box": BlockModel((_BOX_M, _BOX_M), (_BOX_LOG_STD, _BOX_LOG_STD), np.pi / 2, box),
        "plate": BlockModel((_PLATE_LENGTH_M,), (_PLATE_LOG_STD,), np.pi, plate),
    }


def _sizes_m(log_size: FloatArray) -> FloatArray:
    """Sizes from their logarithms; a step of the search that goes astray ends at limits."""
    return np.exp(np.clip(log_size, *np.log(_LIMITS_M)))


def fit_block(model: BlockModel, points: SeenPoints, config: ReflectionConfig) -> BlockFit | None:
    """The fit of a model to points; None where they leave a parameter undetermined."""
    log_around = float(np.log(np.ptp(points.position_m, axis=0) + _AROUND_M).sum())

    def terms(value: FloatArray) -> tuple[FloatArray, FloatArray]:
        block = model.block(value)
        own = log_block(block, points, config.wall_relief_m) if model.turns_rad else log_spot(block, points)
        own = own + np.log(1 - _OTHERS)
        return own, np.logaddexp(own, np.log(_OTHERS) - log_around)

    def log_posterior(value: FloatArray) -> FloatArray:
        return np.asarray(terms(value)[1].sum(axis=1) + model.log_prior(value, config.area_m2))

    def downhill(value: FloatArray) -> tuple[float, FloatArray]:
        step = _STEP * np.eye(len(value))
        found = log_posterior(np.concatenate([value[None], value + step, value - step]))
        n = len(value)
        return -float(found[0]), -(found[1 : n + 1] - found[n + 1 :]) / (2 * _STEP)

    starts = _starts(model, points)
    found = minimize(downhill, starts[np.argmax(log_posterior(starts))], jac=True, method="BFGS")
    n = len(found.x)
    step = 10 * _STEP * np.eye(n)
    pairs = np.concatenate([found.x + step, found.x - step])
    slopes = np.array([downhill(value)[1] for value in pairs])
    information = (slopes[:n] - slopes[n:]) / (20 * _STEP)
    information = (information + information.T) / 2
    if not np.isfinite(information).all() or np.linalg.eigvalsh(information)[0] <= 0:
        return None
    own, total = terms(found.x[None])
    covariance = np.linalg.inv(information)
    evidence = -float(found.fun) + 0.5 * float(np.linalg.slogdet(2 * np.pi * covariance)[1])
    return BlockFit(found.x, covariance, evidence, np.exp(own - total)[0])


def _starts(model: BlockModel, points: SeenPoints) -> FloatArray:
    """Starts (start, parameter): a corner, or either face, at the points as seen from the ends of the paths."""
    sizes = np.array(model.size_m) * np.array(list(product((0.25, 0.5, 1.0, 2.0), repeat=len(model.size_m))))
    middle = np.median(points.position_m, axis=0)
    if not model.turns_rad:
        return np.array([[*middle, *np.log(size)] for size in sizes])
    toward, found = np.mean(points.tx_m + points.rx_m, axis=0) - 2 * middle, []
    for turn, size in product(np.arange(_N_TURNS) * model.turns_rad / _N_TURNS, sizes):
        axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        half = model.block(np.array([[0.0, 0.0, *np.log(size), turn]]))[0, 2:4]
        axes = axes * np.where(axes @ toward < 0, -1.0, 1.0)[:, None]
        place = points.position_m @ axes.T
        front, inside = (
            np.quantile(place, 0.85, axis=0) - half,
            np.mean(np.quantile(place, (0.05, 0.95), axis=0), axis=0),
        )
        flat = np.median(place, axis=0) - half
        for center in (front, [flat[0], inside[1]], [inside[0], flat[1]]):
            found.append([*(np.array(center) @ axes), *np.log(size), turn])
    return np.array(found)
