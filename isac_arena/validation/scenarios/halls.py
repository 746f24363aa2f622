"""Halls, walks and the points where paths meet their surfaces, for Monte Carlo runs of mapping and SLAM.

A hall has four walls and round pillars. In space it also has a floor, a ceiling and rough places on its walls.
Walls and pillars are vertical, so their specular points are those of the plane, at a height that is linear along
the unfolded path. The points come from images and fixed points, not from the estimators.
"""

from dataclasses import dataclass, replace

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, FloatArray, IntArray

CLEARANCE_M = 1.0  # of devices and pillars from each other and from the walls
_MAX_DISTANCE_M = 9.0  # of the receiver from the TX
_CEILING_M = 4.0
_TX_HEIGHT_M, _RX_HEIGHT_M = 2.6, 1.5
_N_ROUGH = 6


@dataclass(frozen=True)
class ScenarioConfig:
    """What is drawn. `n_paths` counts all paths of a stop except the line of sight.

    `outlier_share` of them are no single bounces, and in the plane `double_share` of those bounce off two walls.
    The default errors are those of the measured campaign with a known receiver. Stops of a walk are
    displaced by `placement_std_m` per coordinate, and their spacing varies by `spacing_std` of its mean. With
    `in_space` paths have elevations and devices have heights.
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
    in_space: bool = False

    @property
    def covariance(self) -> FloatArray:
        """R (m, m) of a path in (m, rad, ...)^2; m is 3 in the plane and 5 in space."""
        angles = (4 if self.in_space else 2) * [np.deg2rad(self.angle_std_deg)]
        return np.diag([1e-9 * SPEED_OF_LIGHT_M_S * self.delay_std_ns, *angles]) ** 2


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
    state: FloatArray  # (stop, 4) x, y, heading, bias in m, m, rad, m; (stop, 5) with z after y in space
    has_los: BoolArray  # (stop,)


def draw_hall(rng: np.random.Generator, config: ScenarioConfig) -> Hall:
    """A hall of 12 to 20 m by 9 to 14 m with its pillars and the TX near one of its walls."""
    size = rng.uniform([12.0, 9.0], [20.0, 14.0])
    height = _TX_HEIGHT_M if config.in_space else 0.0
    tx = np.array([rng.uniform(0.3, 0.7) * size[0], size[1] - rng.uniform(1.0, 2.0), height])
    pillars: list[FloatArray] = []
    while len(pillars) < config.n_pillars:
        place = rng.uniform(CLEARANCE_M, size - CLEARANCE_M)
        near = [np.hypot(*(place - other)) < 2 * CLEARANCE_M for other in [tx[:2], *pillars]]
        if not any(near):
            pillars.append(place)
    heading = -np.pi / 2 + rng.uniform(-0.2, 0.2)
    return Hall(size, np.reshape(pillars, (-1, 2)), 0.2, Pose(tx, heading))


def draw_state(rng: np.random.Generator, config: ScenarioConfig, hall: Hall) -> FloatArray:
    """A receiver state (4,) or, in space, (5,) anywhere in a hall."""
    if config.in_space:
        place = [*rng.uniform([1.0, 1.0], hall.size_m - [1.0, 2.5]), _RX_HEIGHT_M]
    else:
        place = [*_free_place(rng, hall)]
    return np.array([*place, rng.uniform(-np.pi, np.pi), rng.uniform(-5.0, 15.0)])


def draw_walk(rng: np.random.Generator, config: ScenarioConfig, n_stops: int) -> TrueWalk:
    """A smooth closed walk through one hall, stops about 0.5 m apart, with a clock that walks 1 m per stop.

    Even with `has_los`, about a third of the stops in a row have no line of sight.
    """
    hall = draw_hall(rng, config)
    uneven = config.spacing_std * rng.standard_normal(n_stops) if config.spacing_std else np.zeros(n_stops)
    position = _loop(hall, np.arange(n_stops) + uneven)
    if config.placement_std_m:
        position = position + config.placement_std_m * rng.standard_normal(position.shape)
    clear = _length(hall.pillar_m[:, None] - position).min(axis=(1, 2)) >= CLEARANCE_M
    hall = replace(hall, pillar_m=hall.pillar_m[clear])
    bias = 10.0 + np.cumsum(rng.standard_normal(n_stops))
    heading = np.full(n_stops, rng.uniform(-np.pi, np.pi))
    first_hidden = rng.integers(n_stops)
    hidden = (np.arange(n_stops) - first_hidden) % n_stops < n_stops // 3
    height = [np.full(n_stops, _RX_HEIGHT_M)] if config.in_space else []
    return TrueWalk(hall, np.column_stack([position, *height, heading, bias]), config.has_los & ~hidden)


def bounce_points(hall: Hall, rx_m: FloatArray) -> tuple[FloatArray, IntArray]:
    """Specular points (point, xy) of all walls, then of all pillars, and the landmark of each.

    On a circle the normal halves the angle between the two legs: a contraction for circles that are small against
    the distance of both devices.
    """
    tx = hall.tx.position_m[:2]
    walls = [tx + _cut(tx, _mirror(rx_m, axis, level), axis, level) for axis, level in walls_of(hall)]
    normal = (tx - hall.pillar_m) / _length(tx - hall.pillar_m)
    for _ in range(60):
        point = hall.pillar_m + hall.radius_m * normal
        halving = (tx - point) / _length(tx - point) + (rx_m - point) / _length(rx_m - point)
        normal = halving / _length(halving)
    points = np.concatenate([np.reshape(walls, (-1, 2)), hall.pillar_m + hall.radius_m * normal])
    return points, np.arange(len(points))


def spatial_points(rng: np.random.Generator, hall: Hall, rx_m: FloatArray) -> tuple[FloatArray, IntArray]:
    """IPs (point, xyz) of walls, pillars, floor, ceiling and rough places, and the landmark of each or -1."""
    tx = hall.tx.position_m
    flat, landmark = bounce_points(hall, rx_m[:2])
    before = np.linalg.norm(flat - tx[:2], axis=1)
    after = np.linalg.norm(flat - rx_m[:2], axis=1)
    upright = np.column_stack([flat, tx[2] + before / (before + after) * (rx_m[2] - tx[2])])
    level = []
    for height in (0.0, _CEILING_M):
        share = (tx[2] - height) / (tx[2] + rx_m[2] - 2 * height)
        level.append([*(tx[:2] + share * (rx_m[:2] - tx[:2])), height])
    place = rng.uniform(0, 1, (_N_ROUGH, 2)) * hall.size_m
    rough = np.column_stack([place, rng.uniform(0.3, _CEILING_M - 0.3, _N_ROUGH)])
    axis, side = rng.integers(0, 2, _N_ROUGH), rng.integers(0, 2, _N_ROUGH)
    rough[np.arange(_N_ROUGH), axis] = side * hall.size_m[axis]
    points = np.concatenate([upright, level, rough])
    return points, np.concatenate([landmark, np.full(len(points) - len(landmark), -1)])


def double_bounces(hall: Hall, state: FloatArray) -> FloatArray:
    """Measurements (12, 3) of the paths off every ordered pair of walls, by images of the TX."""
    tx, walls = hall.tx.position_m[:2], walls_of(hall)
    rows = []
    for first, second in ((a, b) for a in walls for b in walls if a != b):
        ray = state[:2] - _mirror(_mirror(tx, *first), *second)
        departure = _mirror(_mirror(ray, second[0], 0.0), first[0], 0.0)
        aod = np.arctan2(departure[1], departure[0]) - hall.tx.heading_rad
        rows.append([np.hypot(*ray) + state[3], aod, np.arctan2(-ray[1], -ray[0]) - state[2]])
    return np.array(rows)


def walls_of(hall: Hall) -> list[tuple[int, float]]:
    """Axis and level of the four walls: axis 0 is a wall at an x, axis 1 one at a y."""
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


def _free_place(rng: np.random.Generator, hall: Hall) -> FloatArray:
    """A place within reach of the TX that keeps clear of it, of walls and of pillars."""
    while True:
        place = rng.uniform(CLEARANCE_M, hall.size_m - CLEARANCE_M)
        others = np.vstack([hall.pillar_m, hall.tx.position_m[:2]])
        distance = np.hypot(*(others - place).T)
        if distance.min() >= CLEARANCE_M and distance[-1] <= _MAX_DISTANCE_M:
            return np.asarray(place)


def _loop(hall: Hall, step: FloatArray) -> FloatArray:
    """Stops (stop, xy) on an ellipse in the middle of the hall at steps (stop,) of at most 0.5 m along it."""
    axes = 0.3 * hall.size_m
    turn = min(2 * np.pi, 0.5 * len(step) / float(axes.max()))
    angle = turn / len(step) * step
    return np.asarray(0.45 * hall.size_m + axes * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
