"""Made-up stops and walks in space: the halls of `halls.py` with floor, ceiling and heights.

Walls and pillars stand upright: their specular points are those of the plane, at the height that grows evenly
along the unfolded path. Floor and ceiling reflect at their own specular points. Rough places on the walls scatter
at any height.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.laws.space import predict_bounce, predict_los
from isac_arena.validation.scenarios.halls import (
    Hall,
    ScenarioConfig,
    bounce_points,
    channel_estimate,
    draw_hall,
    draw_walk,
)
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle
from scenes.record import BoolArray, FloatArray

_CEILING_M = 4.0
_TX_HEIGHT_M, _RX_HEIGHT_M = 2.6, 1.5
_N_ROUGH = 6


@dataclass(frozen=True)
class SpatialScenario:
    """One stop: what the receiver estimated, and what was true, in the order of the estimate."""

    tx: Pose
    estimate: ChannelEstimate
    state: FloatArray  # (5,) x, y, z, heading, bias in m, m, m, rad, m
    is_los: BoolArray  # (path,)
    is_single: BoolArray  # (path,)
    point_m: FloatArray  # (path, xyz), NaN but for single bounces


def covariance_of(config: ScenarioConfig) -> FloatArray:
    """R (5, 5) of a path in (m, rad, ...)^2."""
    angle = np.deg2rad(config.angle_std_deg)
    return np.diag([1e-9 * SPEED_OF_LIGHT_M_S * config.delay_std_ns, *4 * [angle]]) ** 2


def draw_spatial_stop(rng: np.random.Generator, config: ScenarioConfig) -> SpatialScenario:
    """A receiver anywhere in a hall of its own."""
    hall = draw_hall(rng, config)
    tx = Pose(np.array([*hall.tx.position_m[:2], _TX_HEIGHT_M]), hall.tx.heading_rad)
    place = rng.uniform([1.0, 1.0], hall.size_m - [1.0, 2.5])
    state = np.array([*place, _RX_HEIGHT_M, rng.uniform(-np.pi, np.pi), rng.uniform(-5.0, 15.0)])
    return observe(rng, config, hall, tx, state, 0)


def draw_spatial_walk(
    rng: np.random.Generator, config: ScenarioConfig, n_stops: int
) -> list[SpatialScenario]:
    """A walk through one hall, the receiver at one height."""
    walk = draw_walk(rng, config, n_stops)
    tx = Pose(np.array([*walk.hall.tx.position_m[:2], _TX_HEIGHT_M]), walk.hall.tx.heading_rad)
    states = np.insert(walk.state, 2, _RX_HEIGHT_M, axis=1)
    return [
        observe(rng, config if clear else replace(config, has_los=False), walk.hall, tx, states[stop], stop)
        for stop, clear in enumerate(walk.has_los)
    ]


def observe(
    rng: np.random.Generator, config: ScenarioConfig, hall: Hall, tx: Pose, state: FloatArray, stop: int
) -> SpatialScenario:
    """The paths of one receiver state (5,): single bounces, clutter of any directions, and noise."""
    points = spatial_points(rng, hall, tx, state[:3])
    n_outliers = round(config.outlier_share * config.n_paths)
    n_single = min(config.n_paths - n_outliers, len(points))
    points = points[rng.choice(len(points), n_single, replace=False)]
    shortest = float(predict_los(tx, state)[0])
    clutter = np.column_stack(
        [
            shortest + rng.uniform(0.5, 25.0, n_outliers),
            rng.uniform([-np.pi / 2, -np.pi, -0.5, -0.5], [np.pi / 2, np.pi, 0.5, 0.5], (n_outliers, 4)),
        ]
    )
    los = predict_los(tx, state[None]) if config.has_los else np.zeros((0, 5))
    exact = np.concatenate([los, predict_bounce(tx, state, points), clutter])
    noise = rng.standard_normal(exact.shape) @ np.linalg.cholesky(covariance_of(config)).T
    measured = exact + noise if config.is_noisy else exact.copy()
    measured[:, 1:3] = wrap_angle(measured[:, 1:3])
    n_los, n = len(los), len(exact)
    loss = np.where(np.arange(n) < n_los, 0.0, 10.0) + rng.standard_normal(n)
    power = -13.0 - 17.0 * np.log10(np.maximum(exact[:, 0] - state[4], 0.1)) - loss
    order = np.argsort(measured[:, 0], kind="stable")
    is_los = np.arange(n) < n_los
    is_single = ~is_los & (np.arange(n) < n_los + n_single)
    point = np.full((n, 3), np.nan)
    point[is_single] = points
    estimate = channel_estimate(stop, measured[order], power[order], covariance_of(config), is_los[order])
    return SpatialScenario(tx, estimate, state, is_los[order], is_single[order], point[order])


def spatial_points(rng: np.random.Generator, hall: Hall, tx: Pose, rx_m: FloatArray) -> FloatArray:
    """IPs (point, xyz): walls and pillars, floor and ceiling, rough places on the walls."""
    flat, _ = bounce_points(hall, rx_m[:2])
    before = np.linalg.norm(flat - tx.position_m[:2], axis=1)
    after = np.linalg.norm(flat - rx_m[:2], axis=1)
    upright = np.column_stack(
        [flat, tx.position_m[2] + before / (before + after) * (rx_m[2] - tx.position_m[2])]
    )
    level = []
    for height in (0.0, _CEILING_M):
        share = (tx.position_m[2] - height) / (tx.position_m[2] + rx_m[2] - 2 * height)
        level.append([*(tx.position_m[:2] + share * (rx_m[:2] - tx.position_m[:2])), height])
    rough = np.column_stack(
        [rng.uniform(0, 1, (_N_ROUGH, 2)) * hall.size_m, rng.uniform(0.3, _CEILING_M - 0.3, _N_ROUGH)]
    )
    axis, side = rng.integers(0, 2, _N_ROUGH), rng.integers(0, 2, _N_ROUGH)
    rough[np.arange(_N_ROUGH), axis] = side * hall.size_m[axis]
    return np.concatenate([upright, level, rough])
