"""Synthetic objects seen by reflection: pillars, walls and edges with the Campus Arena's TX and walk.

The true paths come from brute force: the point of least length on a densely sampled outline, and mirror images.
They share no code with the estimators, because they are the reference for the reflection law. Objects are drawn
uniformly beside the walk. A stop has no path if its rays are nearly grazing or if the object shadows it. A ghost
is a path of the object with uniform errors of range and both angles. The errors are so small that a cluster of
incidence points still contains many ghosts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import shapely

from estimation.shape.reflection.reflections import Reflections
from scenes.contours.base import Contour
from scenes.contours.polygons import RoundedPolygon
from scenes.contours.smooth import Circle, Ellipse
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import BoolArray, FloatArray, IntArray
from scenes.walks.trajectory import Walk

C = TypeVar("C", bound=Contour)
T = TypeVar("T")

TX = np.array([2.25, 2.5, -np.pi / 2])
WAYPOINTS_M = np.array([
    [-5.5, -2.3], [6.0, -2.3], [6.7, -3.1], [6.7, -4.6], [5.1, -5.7], [3.1, -5.7], [2.2, -5.1], [1.0, -3.5],
    [0.6, -2.7],
])  # fmt: skip
N_STOPS = 45
BOX_M = np.array([[-7.0, 9.0], [-8.5, -1.0]])  # x and y of the objects
CLEARANCE_M = 0.3
RADII_M = (0.2, 0.8)
MIN_PATHS = 8
LEAST_COS_INCIDENCE = 0.2
OUTLINE_SPACING_M = 5e-4
GHOST_RANGE_M, GHOST_ANGLE_RAD = 3.0, np.deg2rad(20.0)  # half widths


@dataclass(frozen=True)
class Errors:
    """Errors put on true paths. Offsets are constant over a scene: their size is given, the sign is drawn."""

    level: float = 1.0  # standard deviation in ns, deg and deg
    position_std_m: float = 0.0  # of the RX, along x and y
    heading_std_deg: float = 0.0
    delay_offset_ns: float = 0.0
    angle_offset_deg: float = 0.0  # departures and arrivals, each with its own sign
    ghost_share: float = 0.0


@dataclass(frozen=True)
class TruePaths:
    """The specular points of one object and the stops that see them."""

    point_m: FloatArray  # (path, xy)
    rx: FloatArray  # (path, 3) x, y, heading of the RX


def walk_positions() -> FloatArray:
    """Positions (stop, xy) in m of the walk."""
    return Walk(WAYPOINTS_M, 0.0, 0.0, N_STOPS).positions_m()[:, :2]


def draw_circle(rng: np.random.Generator) -> Circle:
    """A round pillar, its radius uniform in `RADII_M`."""
    radius = rng.uniform(*RADII_M)
    return Circle(_place(rng, radius), radius)


def draw_ellipse(rng: np.random.Generator) -> Ellipse:
    """An ellipse of any turn, both half axes uniform in `RADII_M`."""
    axes = rng.uniform(*RADII_M, 2)
    return Ellipse(_place(rng, float(axes.max())), axes, rng.uniform(0, np.pi))


def draw_rounded_square(rng: np.random.Generator) -> RoundedPolygon:
    """A square column of any turn, corners rounded by 0.1 to 0.5 of half its width.

    The sharp square has the area of a circle with a radius uniform in `RADII_M`.
    """
    half = rng.uniform(*RADII_M) * np.sqrt(np.pi) / 2
    turn, corner = rng.uniform(0, np.pi / 2), half * rng.uniform(0.1, 0.5)
    angle = turn + np.pi / 4 + np.arange(4) * np.pi / 2
    vertices = np.sqrt(2) * half * np.column_stack([np.cos(angle), np.sin(angle)])
    return RoundedPolygon(_place(rng, np.sqrt(2) * half) + vertices, np.full(4, corner))


def draw_wall(rng: np.random.Generator, length_m: tuple[float, float] = (3.0, 20.0)) -> FloatArray:
    """Ends (2, xy) of a wall clear of the walk: its length is uniform in the range, its middle is in the box."""
    walk = shapely.LineString(WAYPOINTS_M)
    while True:
        azimuth, half = rng.uniform(0, np.pi), rng.uniform(*length_m) / 2
        along = half * np.array([np.cos(azimuth), np.sin(azimuth)])
        middle = rng.uniform(BOX_M[:, 0], BOX_M[:, 1])
        ends = np.array([middle - along, middle + along])
        if walk.distance(shapely.LineString(ends)) > CLEARANCE_M:
            return ends


def draw_edge(rng: np.random.Generator) -> FloatArray:
    """An edge point (xy,), clear of the walk."""
    return _place(rng, 0.0)


def lit_pillar(draw: Callable[[np.random.Generator], C], rng: np.random.Generator) -> tuple[C, TruePaths]:
    """A contour of the given kind that enough stops see, and its paths."""
    return _lit(draw, closed_paths, rng)


def lit_wall(rng: np.random.Generator) -> tuple[FloatArray, TruePaths]:
    """Ends (2, xy) of a wall that enough stops see, and its paths."""
    return _lit(draw_wall, wall_paths, rng)


def lit_edge(rng: np.random.Generator) -> TruePaths:
    """Paths of an edge point that enough stops see."""
    return _lit(draw_edge, edge_paths, rng)[1]


def _lit(
    draw: Callable[[np.random.Generator], T],
    paths: Callable[[T, np.random.Generator], TruePaths],
    rng: np.random.Generator,
) -> tuple[T, TruePaths]:
    while True:
        drawn = draw(rng)
        true = paths(drawn, rng)
        if len(true.point_m) >= MIN_PATHS:
            return drawn, true


def closed_paths(contour: Contour, rng: np.random.Generator) -> TruePaths:
    """True reflections off a closed convex contour for the walk, the headings uniform."""
    rx, outline = _receivers(rng), contour.sample(OUTLINE_SPACING_M)
    to_tx = np.linalg.norm(outline - TX[:2], axis=1)
    nearest = np.array([np.argmin(to_tx + np.linalg.norm(outline - p, axis=1)) for p in rx[:, :2]])
    return _seen(outline[nearest], rx)


def wall_paths(ends_m: FloatArray, rng: np.random.Generator) -> TruePaths:
    """True reflections off a wall: from the image of the TX through a point between the ends."""
    rx = _receivers(rng)
    along = ends_m[1] - ends_m[0]
    length = float(np.hypot(*along))
    along = along / length
    normal = np.array([-along[1], along[0]])
    depth_t, depth_r = (TX[:2] - ends_m[0]) @ normal, (rx[:, :2] - ends_m[0]) @ normal
    share = depth_r / (depth_t + depth_r)
    point = rx[:, :2] + share[:, None] * (TX[:2] - 2 * depth_t * normal - rx[:, :2])
    place = (point - ends_m[0]) @ along
    lit = (depth_t * depth_r > 0) & (np.abs(depth_r) > CLEARANCE_M) & (place >= 0) & (place <= length)
    return _seen(point[lit], rx[lit])


def edge_paths(edge_m: FloatArray, rng: np.random.Generator) -> TruePaths:
    """Paths over an edge point for the walk."""
    rx = _receivers(rng)
    return _seen(np.broadcast_to(edge_m, (len(rx), 2)), rx)


def observe(true: TruePaths, errors: Errors, rng: np.random.Generator) -> tuple[Reflections, BoolArray]:
    """Measured paths with the given errors, and which are ghosts (path,).

    The covariances of path and pose errors are the true ones. Offsets and ghosts are not stated.
    """
    n = len(true.point_m)
    is_ghost = rng.random(n) < errors.ghost_share
    half = np.array([GHOST_RANGE_M, GHOST_ANGLE_RAD, GHOST_ANGLE_RAD])
    ghost = is_ghost[:, None] * rng.uniform(-half, half, (n, 3))
    pose = _pose_std(errors) * rng.standard_normal((n, 4))
    exact = true_measurements(true) + ghost
    data = _measured(true, np.arange(n), exact, pose, errors, _offset(errors, rng), rng)
    return data, is_ghost


def observe_together(
    truths: Sequence[TruePaths], errors: Errors, rng: np.random.Generator
) -> tuple[list[Reflections], Reflections]:
    """Measured paths of several objects and all lines of sight of one walk, without ghosts.

    Every stop has one pose error, and all paths have the same offsets.
    """
    walk, offset = walk_positions(), _offset(errors, rng)
    pose = _pose_std(errors) * rng.standard_normal((len(walk), 4))
    heading = rng.uniform(-np.pi, np.pi, len(walk))
    objects = []
    for true in truths:
        stop = np.argmin(np.linalg.norm(true.rx[:, None, :2] - walk, axis=2), axis=1)
        same = TruePaths(true.point_m, np.column_stack([true.rx[:, :2], heading[stop]]))
        objects.append(_measured(same, stop, true_measurements(same), pose[stop], errors, offset, rng))
    every = TruePaths(walk, np.column_stack([walk, heading]))
    away = walk - TX[:2]
    azimuth = np.arctan2(away[:, 1], away[:, 0])
    los = np.column_stack([np.linalg.norm(away, axis=1), azimuth - TX[2], azimuth + np.pi - heading])
    return objects, _measured(every, np.arange(len(walk)), los, pose, errors, offset, rng)


def _offset(errors: Errors, rng: np.random.Generator) -> FloatArray:
    size = [1e-9 * SPEED_OF_LIGHT_M_S * errors.delay_offset_ns, *2 * [np.deg2rad(errors.angle_offset_deg)]]
    return np.asarray(rng.choice([-1.0, 1.0], 3) * np.array(size))


def _pose_std(errors: Errors) -> FloatArray:
    return np.array([errors.position_std_m, errors.position_std_m, np.deg2rad(errors.heading_std_deg), 0.0])


def _measured(
    true: TruePaths, stop: IntArray, exact: FloatArray, pose_error: FloatArray, errors: Errors,
    offset: FloatArray, rng: np.random.Generator,
) -> Reflections:  # fmt: skip
    """Exact measurements (path, 3) with offset and noise, the poses with their errors (path, 4)."""
    n = len(exact)
    std = errors.level * np.array([1e-9 * SPEED_OF_LIGHT_M_S, np.deg2rad(1.0), np.deg2rad(1.0)])
    return Reflections(
        measured=exact + offset + std * rng.standard_normal((n, 3)),
        covariance=np.tile(np.diag(std**2), (n, 1, 1)),
        tx=np.tile(TX, (n, 1)),
        rx_state=np.column_stack([true.rx, np.zeros(n)]) + pose_error,
        rx_covariance=np.tile(np.diag(_pose_std(errors) ** 2), (n, 1, 1)),
        session=np.zeros(n, dtype=np.int64),
        stop=stop,
    )


def true_measurements(true: TruePaths) -> FloatArray:
    """Range in m, departure and arrival azimuths in rad (path, 3) of the paths over the points."""
    from_tx, from_rx = true.point_m - TX[:2], true.point_m - true.rx[:, :2]
    aod = np.arctan2(from_tx[:, 1], from_tx[:, 0]) - TX[2]
    aoa = np.arctan2(from_rx[:, 1], from_rx[:, 0]) - true.rx[:, 2]
    range_m = np.linalg.norm(from_tx, axis=1) + np.linalg.norm(from_rx, axis=1)
    return np.column_stack([range_m, aod, aoa])


def _receivers(rng: np.random.Generator) -> FloatArray:
    return np.column_stack([walk_positions(), rng.uniform(-np.pi, np.pi, N_STOPS)])


def _place(rng: np.random.Generator, reach_m: float) -> FloatArray:
    """A centre in the box, its object of the given reach clear of the walk."""
    walk = walk_positions()
    while True:
        center = rng.uniform(BOX_M[:, 0], BOX_M[:, 1])
        if np.linalg.norm(walk - center, axis=1).min() > reach_m + CLEARANCE_M:
            return np.asarray(center)


def _seen(point_m: FloatArray, rx: FloatArray) -> TruePaths:
    """The paths without grazing ones and those of stops in the object's shadow: their incidence is too flat."""
    seen = np.hypot(*_back(point_m, rx).T) / 2 > LEAST_COS_INCIDENCE
    return TruePaths(np.asarray(point_m[seen]), rx[seen])


def _back(point_m: FloatArray, rx: FloatArray) -> FloatArray:
    """Sum (path, xy) of the unit vectors from the points to TX and RX."""
    to_tx, to_rx = TX[:2] - point_m, rx[:, :2] - point_m
    size_tx, size_rx = (np.linalg.norm(leg, axis=1, keepdims=True) for leg in (to_tx, to_rx))
    return np.asarray(to_tx / size_tx + to_rx / size_rx)
