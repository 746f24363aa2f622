"""Walls from single bounces: each incidence point with its normal is a line, and a wall is a line that many share.

A path shows where it met a surface and, as the bisector of its two rays, how the surface faces. So points of one
wall agree however far apart they are; what is no single bounce gives lines at random, which agree with nothing.
"""

import numpy as np
from scipy.special import bdtrc

from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

TOLERANCE_M = 0.25  # of a point about its wall
LEAST_LENGTH_M = 1.0  # between the outer points of a wall
GATE_STDS = 3.0  # of the difference of two normals, and of the distance that it makes at a far point
MOST_SEEDS = 400  # lines that are tried, evenly over the points
BLOCK = 20_000  # pairs of lines and points compared at a time: bounds the memory
REFITS = 3
SHARPEST = (0.25, 0.5, 1.0)  # shares of the points, the sharpest first, that walls are found from
PATIENCE = 10  # lines in a row that are no walls: those that fewer points share follow
FALSE_ALARMS = 0.01  # walls of a scene without any


def find_walls(
    point_m: FloatArray, normal: FloatArray, normal_std_rad: FloatArray, least: int
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Walls [azimuth of normal, offset] (wall, 2), their spans (wall, 2), and the points (ip,) that are on none.

    From points (ip, 2) and outward normals (ip, 2) with standard deviations (ip,). The line that most points share
    is taken first, with all its points; a wall has at least `least` of them, and more than chance explains. The
    sharpest points come first: a few reflections show a wall that scattered paths about it hide.
    """
    walls: list[FloatArray] = []
    spans: list[tuple[float, float]] = []
    is_free = np.ones(len(point_m), bool)
    azimuth = np.arctan2(normal[:, 1], normal[:, 0])
    for share in SHARPEST:
        is_sharp = normal_std_rad <= np.quantile(normal_std_rad, share) if len(point_m) else is_free
        tried = np.flatnonzero(is_free & is_sharp)
        for wall, on in _lines(point_m[tried], azimuth[tried], normal_std_rad[tried], least):
            is_on = tried[on]
            facing, along = _axes(wall[0])
            place = point_m[is_on] @ along
            walls.append(wall)
            spans.append((float(place.min()), float(place.max())))
            middle = wall[1] * facing + np.median(place) * along
            std_rad = np.median(normal_std_rad[is_on]) / np.sqrt(len(is_on))
            line = middle[None], wall[:1], np.array([std_rad])
            is_free &= _closeness(*line, point_m, azimuth, normal_std_rad)[0] <= 0
            is_free[is_on] = False
    return np.reshape(walls, (-1, 2)), np.reshape(spans, (-1, 2)), is_free


def _lines(
    point_m: FloatArray, azimuth: FloatArray, std_rad: FloatArray, least: int
) -> list[tuple[FloatArray, IntArray]]:
    """Lines (2,) that more points share than chance explains, each with its points (index,)."""
    lines: list[tuple[FloatArray, IntArray]] = []
    n = len(point_m)
    rest = np.ones(n, bool)
    seeds = np.unique(np.linspace(0, max(n - 1, 0), min(n, MOST_SEEDS)).astype(int))
    parts = np.array_split(seeds, 1 + len(seeds) * n // BLOCK)
    near = [_closeness(point_m[k], azimuth[k], std_rad[k], point_m, azimuth, std_rad) for k in parts if len(k)]
    closeness = np.concatenate([np.empty((0, n), np.float32), *(part.astype(np.float32) for part in near)])
    score = closeness.sum(axis=1)
    failed = 0
    while np.count_nonzero(rest) >= least and failed < PATIENCE:
        best = seeds[np.argmax(np.where(rest[seeds], score, -np.inf))]
        if not rest[best]:
            break
        wall, is_on = _grown(int(best), np.flatnonzero(rest), point_m, azimuth, std_rad)
        if len(is_on) < least:
            break
        place = point_m[is_on] @ _axes(wall[0])[1]
        chance = _false_alarms(wall, is_on, point_m, std_rad, len(seeds))
        is_wall = np.ptp(place) >= LEAST_LENGTH_M and chance < FALSE_ALARMS / len(SHARPEST)
        failed = 0 if is_wall else failed + 1
        if is_wall:
            lines.append((wall, is_on))
        rest[is_on] = False
        score -= closeness[:, is_on].sum(axis=1)
    return lines


def _axes(azimuth_rad: float) -> tuple[FloatArray, FloatArray]:
    """The normal (2,) of a wall, and the direction along it."""
    facing = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad)])
    return facing, np.array([-facing[1], facing[0]])


def _grown(
    seed: int, rest: IntArray, point_m: FloatArray, azimuth: FloatArray, std_rad: FloatArray
) -> tuple[FloatArray, IntArray]:
    """The line from a seed, fitted to all points of `rest` that are close to it, and these points."""
    at, wall_azimuth, std = point_m[[seed]], azimuth[[seed]], std_rad[[seed]]
    others = point_m[rest], azimuth[rest], std_rad[rest]
    is_on = rest[_closeness(at, wall_azimuth, std, *others)[0] > 0]
    for _ in range(REFITS):
        line = _fitted(point_m[is_on], azimuth[is_on], std_rad[is_on], wall_azimuth[0])
        wall_azimuth, at = line[:1], point_m[is_on].mean(axis=0, keepdims=True)
        now_on = rest[_closeness(at, wall_azimuth, std, *others)[0] > 0]
        if len(now_on) <= len(is_on):
            break
        is_on = now_on
    return line, is_on


def _false_alarms(
    wall: FloatArray, is_on: IntArray, point_m: FloatArray, std_rad: FloatArray, n_tried: int
) -> float:
    """Expected number of lines with so many points by chance, of `n_tried`, were the points' normals at random.

    The number of false alarms of Desolneux, Moisan and Morel (2000): of all points between the outer points of the
    wall, a random normal agrees with the wall's within the gate with the share of the gate in half a turn.
    """
    facing, tangent = _axes(wall[0])
    along = point_m @ tangent
    between = (along >= along[is_on].min()) & (along <= along[is_on].max())
    is_near = between & (np.abs(point_m @ facing - wall[1]) < TOLERANCE_M)
    is_near[is_on] = True
    chance = min(GATE_STDS * np.sqrt(2) * float(np.median(std_rad[is_near])) / (np.pi / 2), 1.0)
    return n_tried * float(bdtrc(len(is_on) - 2, np.count_nonzero(is_near) - 1, chance))


def _closeness(
    at_m: FloatArray,
    line_azimuth: FloatArray,
    line_std_rad: FloatArray,
    point_m: FloatArray,
    azimuth: FloatArray,
    std_rad: FloatArray,
) -> FloatArray:
    """Closeness (line, ip), 0 to 1, of points to lines through `at_m` (line, 2): 0 beyond the gates."""
    facing, std = line_azimuth[:, None], line_std_rad[:, None]
    off = wrap_angle(azimuth - facing)
    line, point = np.nonzero(off**2 < GATE_STDS**2 * (std**2 + std_rad**2))
    x, y = (point_m[point] - at_m[line]).T
    gap = x * np.cos(line_azimuth)[line] + y * np.sin(line_azimuth)[line]
    turned2 = (GATE_STDS * line_std_rad[line]) ** 2 * (x**2 + y**2)
    closeness = np.zeros(off.shape)
    closeness[line, point] = np.maximum(1 - gap**2 / (TOLERANCE_M**2 + turned2), 0.0)
    return closeness


def _fitted(point_m: FloatArray, azimuth: FloatArray, std_rad: FloatArray, start_rad: float) -> FloatArray:
    """The line [azimuth, offset] of least squares for points and normals."""
    normal = np.array([np.cos(start_rad), np.sin(start_rad)])
    along = np.array([-normal[1], normal[0]])
    centre = point_m.mean(axis=0)
    lever = (point_m - centre) @ along / TOLERANCE_M
    turn = np.angle(np.exp(1j * (azimuth - start_rad)))
    information = float(np.sum(lever**2) + np.sum(std_rad**-2.0))
    slope = np.sum(turn / std_rad**2) - np.sum(lever * ((point_m - centre) @ normal)) / TOLERANCE_M
    wall_azimuth = start_rad + float(slope) / information
    offset = float(centre @ np.array([np.cos(wall_azimuth), np.sin(wall_azimuth)]))
    return np.array([wall_azimuth, offset])
