"""Made-up halls, walks and paths for Monte Carlo runs of mapping and SLAM.

A hall has four walls and round pillars. Single bounces meet them at their specular points, double bounces go off
two walls, clutter has any delay and angles. Everything drawn is exact; Gaussian errors of a stated covariance are
added to delay and angles of every path that is no clutter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.laws.plane import predict_bounce, predict_los
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

_CLEARANCE_M = 1.0  # of devices and pillars from each other and from the walls
_MAX_DISTANCE_M = 9.0  # of the receiver from the TX
_POWER_STD_DB = 1.0


@dataclass(frozen=True)
class ScenarioConfig:
    """What is drawn. `n_paths` counts all paths of a stop but the line of sight.

    `outlier_share` of them are no single bounce, and `double_share` of those go off two walls. The errors
    are those that remain in the measured campaign once the receiver is known. Stops of a walk stand off its line
    by `placement_std_m` per coordinate, and are spaced unevenly by `spacing_std` of the mean.
    """

    n_paths: int = 10
    has_los: bool = True
    outlier_share: float = 0.0
    double_share: float = 0.5
    delay_std_ns: float = 0.6
    angle_std_deg: float = 0.6
    n_pillars: int = 10
    is_noisy: bool = True
    placement_std_m: float = 0.0
    spacing_std: float = 0.0

    @property
    def covariance(self) -> FloatArray:
        """R (3, 3) of a path in (m, rad, rad)^2."""
        angle = np.deg2rad(self.angle_std_deg)
        return np.diag([1e-9 * SPEED_OF_LIGHT_M_S * self.delay_std_ns, angle, angle]) ** 2


@dataclass(frozen=True)
class Hall:
    """A rectangular hall (0, 0) to `size_m` with round pillars and a TX."""

    size_m: FloatArray  # (xy,)
    pillar_m: FloatArray  # (pillar, xy)
    radius_m: float
    tx: Pose


@dataclass(frozen=True)
class TrueWalk:
    """Where a receiver stood in a hall, and from where it saw the TX."""

    hall: Hall
    state: FloatArray  # (stop, 4)
    has_los: BoolArray  # (stop,)


@dataclass(frozen=True)
class Scenario:
    """One stop: what the receiver estimated, and what was true. All paths in the order of the estimate."""

    tx: Pose
    estimate: ChannelEstimate
    state: FloatArray  # (4,) x, y, heading, bias in m, m, rad, m
    is_los: BoolArray  # (path,)
    is_single: BoolArray  # (path,)
    point_m: FloatArray  # (path, xy), NaN but for single bounces
    landmark: IntArray  # (path,) walls 0 to 3, pillars from 4; -1 but for single bounces


def draw_hall(rng: np.random.Generator, config: ScenarioConfig) -> Hall:
    """A hall of 12 to 20 m by 9 to 14 m with its pillars and the TX near one of its walls."""
    size = rng.uniform([12.0, 9.0], [20.0, 14.0])
    tx = np.array([rng.uniform(0.3, 0.7) * size[0], size[1] - rng.uniform(1.0, 2.0), 0.0])
    pillars: list[FloatArray] = []
    while len(pillars) < config.n_pillars:
        place = rng.uniform(_CLEARANCE_M, size - _CLEARANCE_M)
        near = [np.hypot(*(place - other)) < 2 * _CLEARANCE_M for other in [tx[:2], *pillars]]
        if not any(near):
            pillars.append(place)
    heading = -np.pi / 2 + rng.uniform(-0.2, 0.2)
    return Hall(size, np.reshape(pillars, (-1, 2)), 0.2, Pose(tx, heading))


def draw_stop(rng: np.random.Generator, config: ScenarioConfig, stop: int = 0) -> Scenario:
    """A receiver anywhere in a hall of its own."""
    hall = draw_hall(rng, config)
    state = np.array(
        [*_free_place(rng, hall), rng.uniform(-np.pi, np.pi), rng.uniform(-5.0, 15.0)],
    )
    return observe_stop(rng, config, hall, state, stop)


def draw_trajectory(rng: np.random.Generator, config: ScenarioConfig, n_stops: int) -> list[Scenario]:
    """The stops of `draw_walk`, each observed on its own."""
    walk = draw_walk(rng, config, n_stops)
    return [
        observe_stop(
            rng, config if clear else replace(config, has_los=False), walk.hall, walk.state[stop], stop
        )
        for stop, clear in enumerate(walk.has_los)
    ]


def draw_walk(rng: np.random.Generator, config: ScenarioConfig, n_stops: int) -> TrueWalk:
    """A smooth closed walk through one hall, stops about 0.5 m apart, with a clock that walks 1 m per stop.

    With `has_los` a stretch of about a third of the stops has no line of sight all the same.
    """
    hall = draw_hall(rng, config)
    uneven = config.spacing_std * rng.standard_normal(n_stops) if config.spacing_std else np.zeros(n_stops)
    position = _loop(hall, np.arange(n_stops) + uneven)
    if config.placement_std_m:
        position = position + config.placement_std_m * rng.standard_normal(position.shape)
    clear = _length(hall.pillar_m[:, None] - position).min(axis=(1, 2)) >= _CLEARANCE_M
    hall = replace(hall, pillar_m=hall.pillar_m[clear])
    bias = 10.0 + np.cumsum(rng.standard_normal(n_stops))
    heading = np.full(n_stops, rng.uniform(-np.pi, np.pi))
    first_hidden = rng.integers(n_stops)
    hidden = (np.arange(n_stops) - first_hidden) % n_stops < n_stops // 3
    return TrueWalk(hall, np.column_stack([position, heading, bias]), config.has_los & ~hidden)


def observe_stop(
    rng: np.random.Generator, config: ScenarioConfig, hall: Hall, state: FloatArray, stop: int
) -> Scenario:
    """The paths of one receiver state (4,): single bounces off random objects, then outliers, then noise."""
    points, objects = bounce_points(hall, state[:2])
    n_outliers = round(config.outlier_share * config.n_paths)
    n_single = min(config.n_paths - n_outliers, len(points))
    chosen = rng.choice(len(points), n_single, replace=False)
    single = predict_bounce(hall.tx, state, points[chosen])
    n_double = round(config.double_share * n_outliers)
    double = double_bounces(hall, state)[rng.choice(12, n_double, replace=n_double > 12)]
    clutter = _clutter(rng, hall, state, n_outliers - n_double)
    los = predict_los(hall.tx, state[None]) if config.has_los else np.zeros((0, 3))
    exact = np.concatenate([los, single, double, clutter])
    noise = rng.standard_normal(exact.shape) @ np.linalg.cholesky(config.covariance).T
    measured = exact + noise if config.is_noisy else exact.copy()
    measured[:, 1:] = wrap_angle(measured[:, 1:])
    n_los, n = len(los), len(exact)
    power = _power_dbm(rng, exact[:, 0] - state[3], n_los, objects[chosen] >= 4, n_outliers)
    is_los, is_single = np.arange(n) < n_los, (np.arange(n) >= n_los) & (np.arange(n) < n_los + n_single)
    point, landmark = np.full((n, 2), np.nan), np.full(n, -1)
    point[is_single], landmark[is_single] = points[chosen], objects[chosen]
    order = np.argsort(measured[:, 0], kind="stable")
    return Scenario(
        tx=hall.tx,
        estimate=channel_estimate(stop, measured[order], power[order], config.covariance, is_los[order]),
        state=state,
        is_los=is_los[order],
        is_single=is_single[order],
        point_m=point[order],
        landmark=landmark[order],
    )


def channel_estimate(
    stop: int, measured: FloatArray, power_dbm: FloatArray, covariance: FloatArray, is_los: BoolArray
) -> ChannelEstimate:
    """A channel estimate of paths (path, m) in m and rad that share one covariance (m, m).

    m is 3, or 5 with the elevations of departure and arrival.
    """
    n, size = measured.shape
    to_seconds = np.array([1 / SPEED_OF_LIGHT_M_S, *(size - 1) * [1.0]])
    elevations = dict(zip(("aod_elevation_rad", "aoa_elevation_rad"), measured.T[3:], strict=False))
    return ChannelEstimate(
        stop=stop,
        delay_s=measured[:, 0] / SPEED_OF_LIGHT_M_S,
        aod_azimuth_rad=measured[:, 1],
        aoa_azimuth_rad=measured[:, 2],
        power_dbm=power_dbm,
        beam_loss_db=np.zeros(n),
        snr_db=np.full(n, 20.0),
        covariance=np.tile(covariance * np.outer(to_seconds, to_seconds), (n, 1, 1)),
        is_los=is_los,
        **elevations,
    )


def bounce_points(hall: Hall, rx_m: FloatArray) -> tuple[FloatArray, IntArray]:
    """Specular points (point, xy) of all walls, then of all pillars, and the landmark of each.

    On a circle the normal halves the angle between the two legs: a contraction for circles that are small against
    the distance of both devices.
    """
    tx = hall.tx.position_m[:2]
    walls = [tx + _cut(tx, _mirror(rx_m, axis, level), axis, level) for axis, level in _walls(hall)]
    normal = (tx - hall.pillar_m) / _length(tx - hall.pillar_m)
    for _ in range(60):
        point = hall.pillar_m + hall.radius_m * normal
        halving = (tx - point) / _length(tx - point) + (rx_m - point) / _length(rx_m - point)
        normal = halving / _length(halving)
    points = np.concatenate([np.reshape(walls, (-1, 2)), hall.pillar_m + hall.radius_m * normal])
    return points, np.arange(len(points))


def double_bounces(hall: Hall, state: FloatArray) -> FloatArray:
    """Measurements (12, 3) of the paths off every ordered pair of walls, by images of the TX."""
    tx = hall.tx.position_m[:2]
    rows = []
    walls = _walls(hall)
    for first in walls:
        for second in walls:
            if first == second:
                continue
            image = _mirror(_mirror(tx, *first), *second)
            ray = state[:2] - image
            departure = _mirror(_mirror(ray, second[0], 0.0), first[0], 0.0)
            rows.append(
                [
                    np.hypot(*ray) + state[3],
                    np.arctan2(departure[1], departure[0]) - hall.tx.heading_rad,
                    np.arctan2(-ray[1], -ray[0]) - state[2],
                ]
            )
    return np.array(rows)


def _walls(hall: Hall) -> list[tuple[int, float]]:
    """Axis and level of the four walls: axis 0 stands at an x, axis 1 at a y."""
    return [(0, 0.0), (0, float(hall.size_m[0])), (1, 0.0), (1, float(hall.size_m[1]))]


def _mirror(point: FloatArray, axis: int, level: float) -> FloatArray:
    mirrored = np.array(point, float)
    mirrored[axis] = 2 * level - mirrored[axis]
    return mirrored


def _cut(start: FloatArray, end: FloatArray, axis: int, level: float) -> FloatArray:
    """Vector from `start` to where the line to `end` meets a wall."""
    return np.asarray((level - start[axis]) / (end - start)[axis] * (end - start))


def _length(vector: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vector, axis=-1, keepdims=True))


def _clutter(rng: np.random.Generator, hall: Hall, state: FloatArray, n: int) -> FloatArray:
    """Paths (n, 3) of any directions, up to 25 m longer than the line of sight."""
    shortest = np.hypot(*(state[:2] - hall.tx.position_m[:2])) + state[3]
    angles = rng.uniform([-np.pi / 2, -np.pi], [np.pi / 2, np.pi], (n, 2))
    return np.column_stack([shortest + rng.uniform(0.5, 25.0, n), angles])


def _power_dbm(
    rng: np.random.Generator, length_m: FloatArray, n_los: int, is_pillar: BoolArray, n_outliers: int
) -> FloatArray:
    """Powers as in the measured hall: -13 - 17 log10(d), walls 6 dB and pillars 15 dB less, outliers 12 dB."""
    loss = np.concatenate([np.zeros(n_los), np.where(is_pillar, 15.0, 6.0), np.full(n_outliers, 12.0)])
    spread = _POWER_STD_DB * rng.standard_normal(len(loss))
    return np.asarray(-13.0 - 17.0 * np.log10(np.maximum(length_m, 0.1)) - loss + spread)


def _free_place(rng: np.random.Generator, hall: Hall) -> FloatArray:
    """A place within reach of the TX that keeps clear of it, of walls and of pillars."""
    while True:
        place = rng.uniform(_CLEARANCE_M, hall.size_m - _CLEARANCE_M)
        others = np.vstack([hall.pillar_m, hall.tx.position_m[:2]])
        distance = np.hypot(*(others - place).T)
        if distance.min() >= _CLEARANCE_M and distance[-1] <= _MAX_DISTANCE_M:
            return np.asarray(place)


def _loop(hall: Hall, step: FloatArray) -> FloatArray:
    """Stops (stop, xy) on an ellipse in the middle of the hall at steps (stop,) of at most 0.5 m along it."""
    axes = 0.3 * hall.size_m
    turn = min(2 * np.pi, 0.5 * len(step) / float(axes.max()))
    angle = turn / len(step) * step
    return np.asarray(0.45 * hall.size_m + axes * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
