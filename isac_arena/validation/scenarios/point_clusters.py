"""Synthetic clusters of incidence points with known contours: partial pillars, square columns and walls."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from estimation.shape.points.cluster import PointCluster
from scenes.record import FloatArray

RADIUS_M = (0.3, 0.8)
HALF_SIDE_M = (0.3, 0.6)
ARC_DEG = (60.0, 160.0)
COUNTS = (8, 16, 32)
NOISE_STD_M = ((0.05, 0.05), (0.05, 0.15), (0.1, 0.2), (0.15, 0.3))  # along and across the line of sight
SENSOR_DISTANCE_M = (3.0, 8.0)
N_CONTOUR = 360

Noise = tuple[float, float]


@dataclass(frozen=True)
class MadeObject:
    """A true contour and the points seen of it."""

    points: PointCluster
    contour_m: FloatArray  # (sample, xy): closed for pillars, the two ends of a wall's line, or its steps
    lit_m: FloatArray  # (sample, xy) the part of the contour the points were drawn from


def partial_pillars(rng: np.random.Generator, draws: int) -> list[MadeObject]:
    """Round pillars R 0.3-0.8 m: `draws` for each number of points and noise level; 36 make the 432 sets."""
    return _drawn(draws, COUNTS, lambda n, noise: _seen(rng, _circle(rng.uniform(*RADIUS_M)), 0.0, n, noise))


def square_columns(rng: np.random.Generator, draws: int) -> list[MadeObject]:
    """Square columns of half side 0.3-0.6 m turned at random, seen as the pillars are."""

    def column(n: int, noise: Noise) -> MadeObject:
        return _seen(rng, _square(rng.uniform(*HALF_SIDE_M)), rng.uniform(0, np.pi / 2), n, noise)

    return _drawn(draws, COUNTS, column)


def _drawn(draws: int, counts: Sequence[int], draw: Callable[[int, Noise], MadeObject]) -> list[MadeObject]:
    """`draws` objects for each number of points and noise level."""
    return [draw(n, noise) for n, noise in product(counts, NOISE_STD_M) for _ in range(draws)]


def with_outliers(made: MadeObject, share: float, rng: np.random.Generator) -> MadeObject:
    """The same object with a share of its points moved to anywhere within 1 m of the box of the points."""
    position = made.points.position_m.copy()
    moved = rng.random(len(position)) < share
    low, high = position.min(axis=0) - 1.0, position.max(axis=0) + 1.0
    position[moved] = rng.uniform(low, high, (int(moved.sum()), 2))
    return replace(made, points=replace(made.points, position_m=position))


def with_wrong_covariance(made: MadeObject, factor: float) -> MadeObject:
    """The same points with stated covariances wrong by a factor."""
    return replace(made, points=replace(made.points, covariance_m2=made.points.covariance_m2 * factor))


def _circle(radius_m: float) -> FloatArray:
    return np.full(N_CONTOUR, radius_m)


def _square(half_side_m: float) -> FloatArray:
    angle = np.linspace(0, 2 * np.pi, N_CONTOUR, endpoint=False)
    return np.asarray(half_side_m / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle))))


def _seen(
    rng: np.random.Generator, radius_m: FloatArray, turn_rad: float, n_points: int, noise_std_m: Noise
) -> MadeObject:
    """Points uniform in angle over an arc of 60-160 deg facing the sensor, with range and cross-range noise."""
    arc = np.deg2rad(rng.uniform(*ARC_DEG))
    center, side = rng.uniform(-5, 5, 2), rng.uniform(-np.pi, np.pi)
    angle = np.linspace(0, 2 * np.pi, N_CONTOUR, endpoint=False)
    contour = center + _polar(np.interp(angle - turn_rad, angle, radius_m, period=2 * np.pi), angle)
    lit_angle = side + arc * (np.linspace(0, 1, 64) - 0.5)
    at = side + arc * (rng.random(n_points) - 0.5)
    lit, true = (
        center + _polar(np.interp(a - turn_rad, angle, radius_m, period=2 * np.pi), a) for a in (lit_angle, at)
    )
    sensor = center + rng.uniform(*SENSOR_DISTANCE_M) * np.array([np.cos(side), np.sin(side)])
    return MadeObject(_measured(rng, true, sensor, noise_std_m), contour, lit)


def _polar(radius_m: FloatArray, angle_rad: FloatArray) -> FloatArray:
    return np.stack([radius_m * np.cos(angle_rad), radius_m * np.sin(angle_rad)], axis=1)


def _measured(
    rng: np.random.Generator, true_m: FloatArray, sensor_m: FloatArray, noise_std_m: Noise
) -> PointCluster:
    """Points with noise along and across the line of sight from the sensor."""
    sight = true_m - sensor_m
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    axes = np.stack([sight, np.stack([-sight[:, 1], sight[:, 0]], axis=1)], axis=2)  # columns
    scaled = axes * np.array(noise_std_m)
    position = true_m + np.einsum("nij,nj->ni", scaled, rng.standard_normal(true_m.shape))
    covariance = scaled @ np.swapaxes(scaled, 1, 2)
    return PointCluster(position_m=position, covariance_m2=covariance, sensor_m=sensor_m)


def walls(
    rng: np.random.Generator, draws: int, length_m: tuple[float, float] = (3.0, 20.0), recess_m: float = 0.0
) -> list[MadeObject]:
    """Walls seen from one side, 4-8 m away: `draws` for each of 8-64 points and noise level; 15 make 240 sets.

    With a recess the middle third lies that much deeper. The contour is the line end to end, its steps included.
    """
    return _drawn(draws, (8, 16, 32, 64), lambda n, noise: _wall(rng, rng.uniform(*length_m), n, noise, recess_m))


def _wall(
    rng: np.random.Generator, length_m: float, n_points: int, noise_std_m: Noise, recess_m: float
) -> MadeObject:
    azimuth, middle = rng.uniform(-np.pi, np.pi), rng.uniform(-5, 5, 2)
    along = np.array([np.cos(azimuth), np.sin(azimuth)])
    axes = np.stack([along, np.array([-along[1], along[0]])])

    def at(place: FloatArray) -> FloatArray:
        depth = np.where(np.abs(place) < length_m / 6, recess_m, 0.0)
        return np.asarray(middle + np.stack([place, depth], axis=1) @ axes)

    sensor = middle + np.array([rng.uniform(-0.3, 0.3) * length_m, -rng.uniform(4, 8)]) @ axes
    true = at(length_m * (rng.random(n_points) - 0.5))
    contour = at(np.linspace(-length_m / 2, length_m / 2, N_CONTOUR))
    return MadeObject(_measured(rng, true, sensor, noise_std_m), contour, contour)
