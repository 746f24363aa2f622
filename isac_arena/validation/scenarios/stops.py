"""What a receiver in a hall estimates: single bounces at specular points, outliers and Gaussian errors.

All drawn values are exact. Gaussian errors of a stated covariance are added to delay and angles of every path. The
measurements of given points follow `estimation.laws`, so that the checks test the solvers alone.
"""

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.laws import plane, space
from isac_arena.validation.scenarios import halls
from isac_arena.validation.scenarios.estimates import made_estimate
from isac_arena.validation.scenarios.halls import Hall, ScenarioConfig
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

_POWER_STD_DB = 1.0


@dataclass(frozen=True)
class Scenario:
    """One stop: what the receiver estimated, and what was true. All paths in the order of the estimate."""

    tx: Pose
    estimate: ChannelEstimate
    state: FloatArray  # (4,) x, y, heading, bias in m, m, rad, m; (5,) with z after y in space
    is_los: BoolArray  # (path,)
    is_single: BoolArray  # (path,)
    point_m: FloatArray  # (path, xy or xyz), NaN except for single bounces
    landmark: IntArray  # (path,) walls 0 to 3, pillars from 4; -1 for all other paths


def draw_stop(rng: np.random.Generator, config: ScenarioConfig, stop: int = 0) -> Scenario:
    """A receiver anywhere in a hall of its own."""
    hall = halls.draw_hall(rng, config)
    return observe_stop(rng, config, hall, halls.draw_state(rng, config, hall), stop)


def draw_trajectory(rng: np.random.Generator, config: ScenarioConfig, n_stops: int) -> list[Scenario]:
    """The stops of `draw_walk`, each observed on its own."""
    walk = halls.draw_walk(rng, config, n_stops)
    hidden = replace(config, has_los=False)
    return [
        observe_stop(rng, config if clear else hidden, walk.hall, walk.state[stop], stop)
        for stop, clear in enumerate(walk.has_los)
    ]


def observe_stop(
    rng: np.random.Generator, config: ScenarioConfig, hall: Hall, state: FloatArray, stop: int
) -> Scenario:
    """The paths of one receiver state: single bounces off random objects, then outliers, then noise."""
    flat = not config.in_space
    law = plane if flat else space
    points, objects = halls.bounce_points(hall, state[:2]) if flat else halls.spatial_points(rng, hall, state[:3])
    n_outliers = round(config.outlier_share * config.n_paths)
    n_single = min(config.n_paths - n_outliers, len(points))
    chosen = rng.choice(len(points), n_single, replace=False)
    outliers = _double_bounces_and_clutter if flat else _spatial_clutter
    los = law.predict_los(hall.tx, state[None])
    parts = [
        los[: int(config.has_los)],
        law.predict_bounce(hall.tx, state, points[chosen]),
        outliers(rng, config, hall, state, n_outliers, float(los[0, 0])),
    ]
    exact = np.concatenate(parts)
    kind = np.repeat([0, 1, 2], [len(part) for part in parts])
    noise = rng.standard_normal(exact.shape) @ np.linalg.cholesky(config.covariance).T
    measured = exact + noise if config.is_noisy else exact.copy()
    measured[:, 1:3] = wrap_angle(measured[:, 1:3])
    point, landmark = np.full((len(kind), points.shape[1]), np.nan), np.full(len(kind), -1)
    point[kind == 1], landmark[kind == 1] = points[chosen], objects[chosen]
    power = _power_dbm(rng, config, exact[:, 0] - state[-1], kind, landmark >= 4)
    order = np.argsort(measured[:, 0], kind="stable")
    is_los, is_single = kind[order] == 0, kind[order] == 1
    estimate = channel_estimate(stop, measured[order], power[order], config.covariance, is_los)
    return Scenario(hall.tx, estimate, state, is_los, is_single, point[order], landmark[order])


def channel_estimate(
    stop: int, measured: FloatArray, power_dbm: FloatArray, covariance: FloatArray, is_los: BoolArray
) -> ChannelEstimate:
    """A channel estimate of paths (path, m) in m and rad that share one covariance (m, m).

    m is 3, or 5 with the elevations of departure and arrival.
    """
    to_seconds = np.array([1 / SPEED_OF_LIGHT_M_S, *(measured.shape[1] - 1) * [1.0]])
    parameters = measured.copy()
    parameters[:, 0] /= SPEED_OF_LIGHT_M_S
    in_seconds = covariance * np.outer(to_seconds, to_seconds)
    return made_estimate(stop, parameters, power_dbm, in_seconds, is_los, snr_db=20.0)


def _double_bounces_and_clutter(
    rng: np.random.Generator, config: ScenarioConfig, hall: Hall, state: FloatArray, n: int, shortest_m: float
) -> FloatArray:
    """Outliers (n, 3): paths over two walls, then paths of any directions, up to 25 m longer than the LOS."""
    n_double = round(config.double_share * n)
    double = halls.double_bounces(hall, state)[rng.choice(12, n_double, replace=n_double > 12)]
    angles = rng.uniform([-np.pi / 2, -np.pi], [np.pi / 2, np.pi], (n - n_double, 2))
    clutter = np.column_stack([shortest_m + rng.uniform(0.5, 25.0, n - n_double), angles])
    return np.concatenate([double, clutter])


def _spatial_clutter(
    rng: np.random.Generator, config: ScenarioConfig, hall: Hall, state: FloatArray, n: int, shortest_m: float
) -> FloatArray:
    """Outliers (n, 5): paths of any directions, up to 25 m longer than the LOS."""
    length = shortest_m + rng.uniform(0.5, 25.0, n)
    angles = rng.uniform([-np.pi / 2, -np.pi, -0.5, -0.5], [np.pi / 2, np.pi, 0.5, 0.5], (n, 4))
    return np.column_stack([length, angles])


def _power_dbm(
    rng: np.random.Generator, config: ScenarioConfig, length_m: FloatArray, kind: IntArray, is_pillar: BoolArray,
) -> FloatArray:  # fmt: skip
    """Powers as in the measured hall: -13 - 17 log10(d) less the loss of the kind of path.

    Walls lose 6 dB, pillars 15 dB and outliers 12 dB; in space every path except the line of sight loses 10 dB.
    """
    spread = _POWER_STD_DB * rng.standard_normal(len(kind))
    free = -13.0 - 17.0 * np.log10(np.maximum(length_m, 0.1))
    if config.in_space:
        return np.asarray(free - (np.where(kind == 0, 0.0, 10.0) + spread))
    loss = np.choose(kind, [np.zeros(len(kind)), np.where(is_pillar, 15.0, 6.0), np.full(len(kind), 12.0)])
    return np.asarray(free - loss + spread)
