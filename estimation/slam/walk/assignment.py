"""Assignment of paths to known landmarks: the smallest chi-square within the gate, compiled."""

import numpy as np

from estimation.distributions import chi_square_quantile
from estimation.execution import compiled
from estimation.laws.contour import closed_path
from estimation.laws.plane import wrapped
from estimation.laws.raised import raised_path, raised_range
from estimation.laws.support import CIRCLE_BY_RADIUS
from estimation.laws.wall import mirror_point, wall_path, wall_place
from estimation.slam.config import TrajectoryConfig
from estimation.slam.transmitters import transmitters_of
from estimation.slam.walk.linearise import add_roughness, cholesky3, path_heights
from estimation.slam.walk.residuals import (
    Association,
    Observations,
    PathClass,
    TrajectoryState,
    without_heading_offsets,
)
from scenes.record import FloatArray, IntArray

_END_MARGIN_M = 0.7  # added to both ends of the span of a wall
_DOUBLE_PROBABILITY = 0.95
_UNUSED, _LOS = PathClass.UNUSED, PathClass.LOS
_WALL, _OBJECT, _DOUBLE, _RAISED = PathClass.WALL, PathClass.OBJECT, PathClass.DOUBLE, PathClass.RAISED


def assign_to_landmarks(
    seen: Observations, now: TrajectoryState, link: Association, spans: FloatArray, config: TrajectoryConfig
) -> Association:
    """Assign every path except lines of sight to the landmark of smallest chi-square within the gate.

    `spans` (wall, 2) are the intervals along the walls where incidence points were seen. Paths that are otherwise
    unassigned may be double bounces off two walls.
    """
    gates = np.array(
        [
            chi_square_quantile(config.gate_probability, 3),
            chi_square_quantile(_DOUBLE_PROBABILITY, 3) if config.use_double_bounces else 0.0,
        ]
    )
    kind, landmark = link.kind.copy(), link.landmark.copy()
    spans = spans + np.array([-_END_MARGIN_M, _END_MARGIN_M])
    rough_m = np.array([config.wall_roughness_m, config.object_roughness_m])
    state, measured = seen.states(now.state), without_heading_offsets(seen, now, np.arange(len(kind)))
    for index, tx in enumerate(transmitters_of(seen.tx).rows):
        own = np.flatnonzero(seen.tx_of_path == index)
        kinds, landmarks = kind[own], landmark[own]
        paths = state[own], measured[own], seen.covariance[own]
        _assign(tx, *paths, now.walls, spans, now.objects, rough_m, gates, kinds, landmarks)
        if len(now.raised):
            heights = path_heights(seen.take(own))
            _assign_raised(
                tx, *paths, now.raised, *heights, now.walls, now.objects, rough_m, gates, kinds, landmarks
            )
        kind[own], landmark[own] = kinds, landmarks
    return Association(kind, landmark)


@compiled
def _assign(
    tx: FloatArray,
    state: FloatArray,
    measured: FloatArray,
    covariance: FloatArray,
    walls: FloatArray,
    spans: FloatArray,
    objects: FloatArray,
    rough_m: FloatArray,
    gates: FloatArray,
    kind: IntArray,
    landmark: IntArray,
) -> None:
    """Fill `kind` (path,) and `landmark` (path, 2) in place.

    The delay alone gives a lower bound of the chi-square, since roughness r adds at most (2 r)^2 to its variance.
    So does every angle alone. These bounds reject most pairs of path and landmark.
    """
    chain = np.empty((2, 2))
    single, double = wall_images(tx, walls)
    for i in range(len(kind)):
        if kind[i] == _LOS:
            continue
        x, seen, cov = state[i], measured[i], covariance[i]
        reach, variance = seen[0] - x[3], cov[0, 0] + 4 * rough_m**2
        best = gates[0]
        for w in range(len(walls)):
            if (reach - _separation(single[w], x)) ** 2 > best * variance[0]:
                continue
            place, depth_tx, depth_rx, total = wall_place(walls[w], tx, x)
            if depth_tx * depth_rx <= 0 or not spans[w, 0] < place < spans[w, 1]:
                continue
            if _arrives_elsewhere(single[w], depth_rx / total, x, seen, cov, rough_m[0], best):
                continue
            chain[0] = walls[w]
            distance = wall_chi2(tx, x, seen, cov, chain[:1], rough_m[0])
            if distance < best:
                best, kind[i], landmark[i, 0], landmark[i, 1] = distance, _WALL, w, -1
        for o in range(len(objects)):
            short = abs(reach - _separation(tx, objects[o]) - _separation(objects[o], x)) - 2 * abs(objects[o, 2])
            if short > 0 and short**2 > best * variance[1]:
                continue
            if _is_elsewhere(objects[o], tx, x, seen, cov, rough_m[1], best):
                continue
            distance = circle_chi2(tx, x, seen, cov, objects[o], rough_m[1])
            if distance < best:
                best, kind[i], landmark[i, 0], landmark[i, 1] = distance, _OBJECT, o, -1
        if kind[i] == _UNUSED:
            _assign_double(tx, x, seen, cov, walls, double, rough_m[0], gates[1], kind[i : i + 1], landmark[i])


@compiled
def _assign_raised(
    tx: FloatArray,
    state: FloatArray,
    measured: FloatArray,
    covariance: FloatArray,
    raised: FloatArray,
    difference_m: FloatArray,
    boresight_rad: FloatArray,
    walls: FloatArray,
    objects: FloatArray,
    rough_m: FloatArray,
    gates: FloatArray,
    kind: IntArray,
    landmark: IntArray,
) -> None:
    """Give paths to a raised point that predicts them better than their landmark does, in place."""
    value, by_state, by_point = np.empty(3), np.empty((3, 4)), np.empty((3, 3))
    for i in range(len(kind)):
        if kind[i] == _LOS:
            continue
        x, seen, cov = state[i], measured[i], covariance[i]
        best = gates[0]
        if kind[i] == _WALL:
            best = wall_chi2(tx, x, seen, cov, walls[landmark[i, 0] : landmark[i, 0] + 1], rough_m[0])
        elif kind[i] == _OBJECT:
            best = circle_chi2(tx, x, seen, cov, objects[landmark[i, 0]], rough_m[1])
        for r in range(len(raised)):
            off_m = seen[0] - raised_range(tx, x, raised[r], difference_m[i])
            if off_m**2 > best * (cov[0, 0] + 4 * rough_m[1] ** 2):
                continue
            raised_path(tx, x, raised[r], difference_m[i], boresight_rad[i], value, by_state, by_point)
            distance = _chi2(tx, x, seen, cov, value, raised[r, :2], rough_m[1])
            if distance < best:
                best, kind[i], landmark[i, 0], landmark[i, 1] = distance, _RAISED, r, -1


@compiled
def _assign_double(
    tx: FloatArray,
    x: FloatArray,
    seen: FloatArray,
    cov: FloatArray,
    walls: FloatArray,
    images: FloatArray,
    rough_m: float,
    best: float,
    kind: IntArray,
    landmark: IntArray,
) -> None:
    """Assign one path to the pair of walls of smallest chi-square within the gate, in place."""
    chain = np.empty((2, 2))
    for a in range(len(walls)):
        for b in range(len(walls)):
            short = seen[0] - x[3] - _separation(images[a, b], x)
            if a == b or short**2 > best * (cov[0, 0] + 4 * rough_m**2):
                continue
            if not _is_in_front(tx, x, walls[a], walls[b]):
                continue
            chain[0], chain[1] = walls[a], walls[b]
            distance = wall_chi2(tx, x, seen, cov, chain, rough_m)
            if distance < best:
                best, kind[0], landmark[0], landmark[1] = distance, _DOUBLE, a, b


@compiled
def _is_in_front(tx: FloatArray, x: FloatArray, first: FloatArray, second: FloatArray) -> bool:
    """Whether a path off two walls meets each from one side, as seen from the image of the TX in the first."""
    image = np.array(mirror_point(tx[0], tx[1], first))
    place, depth_image, depth_rx, _ = wall_place(second, image, x)
    nx, ny = np.cos(second[0]), np.sin(second[0])
    point = np.array([nx * second[1] - ny * place, ny * second[1] + nx * place])
    _, depth_tx, depth_point, _ = wall_place(first, tx, point)
    return bool(depth_image * depth_rx > 0 and depth_tx * depth_point > 0)


@compiled
def _arrives_elsewhere(
    image: FloatArray,
    last_leg: float,
    x: FloatArray,
    seen: FloatArray,
    cov: FloatArray,
    rough_m: float,
    best: float,
) -> bool:
    """Whether the arrival alone excludes the path from an image; `last_leg` is its share past the wall."""
    east, north = image[0] - x[0], image[1] - x[1]
    off = wrapped(seen[2] + x[2] - np.arctan2(north, east))
    return _is_beyond(off, (east**2 + north**2) * last_leg**2, cov[2, 2], rough_m, best)


@compiled
def _is_elsewhere(
    circle: FloatArray,
    tx: FloatArray,
    x: FloatArray,
    seen: FloatArray,
    cov: FloatArray,
    rough_m: float,
    best: float,
) -> bool:
    """Whether the departure or the arrival alone excludes the path off a circle."""
    for end, angle in ((tx, 1), (x, 2)):
        east, north = circle[0] - end[0], circle[1] - end[1]
        distance2 = east**2 + north**2
        if distance2 <= circle[2] ** 2:
            continue
        edge = np.arcsin(abs(circle[2]) / np.sqrt(distance2))
        off = abs(wrapped(seen[angle] + end[2] - np.arctan2(north, east))) - edge
        if off > 0 and _is_beyond(off, distance2, cov[angle, angle], rough_m, best):
            return True
    return False


@compiled
def _is_beyond(off_rad: float, distance2: float, variance: float, rough_m: float, best: float) -> bool:
    """Whether an angle alone makes a chi-square above the best, of a rough point at this squared distance."""
    return bool(off_rad**2 * distance2 > best * (variance * distance2 + rough_m**2))


@compiled
def wall_images(tx: FloatArray, walls: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Images of the TX in every wall (wall, 2), and of those in every other wall (wall, wall, 2)."""
    n = len(walls)
    single, double = np.empty((n, 2)), np.empty((n, n, 2))
    for a in range(n):
        single[a, 0], single[a, 1] = mirror_point(tx[0], tx[1], walls[a])
        for b in range(n):
            double[a, b, 0], double[a, b, 1] = mirror_point(single[a, 0], single[a, 1], walls[b])
    return single, double


@compiled
def _separation(a: FloatArray, b: FloatArray) -> float:
    return float(np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2))


@compiled
def wall_chi2(
    tx: FloatArray, x: FloatArray, seen: FloatArray, cov: FloatArray, walls: FloatArray, rough_m: float
) -> float:
    """Chi-square, 3 degrees of freedom, of a path as the one off walls (bounce, 2)."""
    value, by_state, by_wall = np.empty(3), np.empty((3, 4)), np.empty((3, 2 * len(walls)))
    point = np.empty(2)
    wall_path(tx, x, walls, value, by_state, by_wall, point)
    return _chi2(tx, x, seen, cov, value, point, rough_m)


@compiled
def circle_chi2(
    tx: FloatArray, x: FloatArray, seen: FloatArray, cov: FloatArray, circle: FloatArray, rough_m: float
) -> float:
    """The same as the one off a circle (3,)."""
    value, by_state, by_circle = np.empty(3), np.empty((3, 4)), np.empty((3, 3))
    point = np.empty(2)
    work = np.zeros(3), np.zeros((2, 3)), np.empty((3, 2))
    closed_path(CIRCLE_BY_RADIUS, circle, tx, x, value, by_state, by_circle, point, work)
    return _chi2(tx, x, seen, cov, value, circle[:2], rough_m)


@compiled
def _chi2(
    tx: FloatArray,
    x: FloatArray,
    seen: FloatArray,
    cov: FloatArray,
    predicted: FloatArray,
    point: FloatArray,
    rough_m: float,
) -> float:
    difference = seen - predicted
    difference[1], difference[2] = wrapped(difference[1]), wrapped(difference[2])
    spread = cov.copy()
    add_roughness(tx, x, point, rough_m, spread)
    total = 0.0
    cholesky3(spread)
    for i in range(3):
        for j in range(i):
            difference[i] -= spread[i, j] * difference[j]
        difference[i] /= spread[i, i]
        total += difference[i] ** 2
    return total
