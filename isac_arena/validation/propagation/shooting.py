"""Rays shot in plan view and bisected onto the receiver: finds reflections without stationary points.

Rays leave the TX towards closely spaced points of every contour and are followed mirror by mirror; where two
neighbours over the same objects pass the receiver on different sides, a path lies between them. Where two
neighbours meet different objects, the last rays that still meet the same ones are found first: a path that grazes
a pillar lies in a sliver of angle beside its rim.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimation.execution import compiled
from scenes.contours import Circle, Contour, Piece
from scenes.record import BoolArray, FloatArray, IntArray
from scenes.scene import Scene

POINTS_PER_PIECE = 4000
SAGITTA_M = 1e-5  # normals are interpolated along the chords, so lengths are good to about 1e-6 m
N_BISECTIONS = 60
OFF_SURFACE_M = 1e-7


@dataclass(frozen=True)
class Hits:
    """First hits of rays: object (-1 for none), distance in m, and unit normal (ray, xy)."""

    surface: IntArray
    distance_m: FloatArray
    normal: FloatArray


@dataclass(frozen=True)
class ShotPath:
    """A path found by shooting: the objects it meets from TX to RX and its horizontal length."""

    surface: tuple[int, ...]
    length_m: float


class Shooter:
    """The contours of a scene as targets of rays in plan view: all objects count as infinitely high."""

    def __init__(self, scene: Scene) -> None:
        self._contours = [item.contour for item in scene.objects]
        self._tx = scene.tx.position_m[:2]
        self._chords = [_chords(contour) for contour in self._contours]

    def paths(self, rx_xy_m: FloatArray, max_bounces: int) -> list[ShotPath]:
        """All paths of 1 ... `max_bounces` reflections from the TX to a receiver (xy,)."""
        angles = [self._angles(piece) for contour in self._contours for piece in contour.pieces]
        found: list[ShotPath] = []
        for n in range(1, max_bounces + 1):
            found += self._between(*self._stretches(angles, rx_xy_m, n), rx_xy_m, n)
        return _distinct(found)

    def _angles(self, piece: Piece) -> FloatArray:
        """Directions (ray,) from the TX to points along a piece of a contour."""
        aim = piece.point(np.linspace(0, 1, POINTS_PER_PIECE, endpoint=False))
        return np.unwrap(np.arctan2(aim[:, 1] - self._tx[1], aim[:, 0] - self._tx[0]))

    def _stretches(self, angles: list[FloatArray], rx: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
        """Intervals of angle, lower and upper ends, over which the rays meet the same objects."""
        angle = np.concatenate(angles)
        left = np.delete(np.arange(len(angle)), np.cumsum([len(piece) for piece in angles]) - 1)
        right = left + 1
        chain = self._follow(angle, rx, n)[0]
        differs = (chain[left] != chain[right]).any(axis=1)
        anchor = np.append(left[differs], right[differs])
        other = np.append(right[differs], left[differs])
        near, _ = _bisected(
            angle[anchor], angle[other], lambda ray: (self._follow(ray, rx, n)[0] == chain[anchor]).all(axis=1)
        )
        return np.append(angle[left[~differs]], angle[anchor]), np.append(angle[right[~differs]], near)

    def _between(self, low: FloatArray, high: FloatArray, rx: FloatArray, n: int) -> list[ShotPath]:
        chain_low, miss_low, _, _ = self._follow(low, rx, n)
        chain_high, miss_high, _, _ = self._follow(high, rx, n)
        bracket = (chain_low == chain_high).all(axis=1) & (chain_low >= 0).all(axis=1)
        bracket &= (miss_low > 0) != (miss_high > 0)
        above, chain = miss_low[bracket] > 0, chain_low[bracket]
        low, high = _bisected(
            low[bracket], high[bracket], lambda middle: (self._follow(middle, rx, n)[1] > 0) == above
        )
        met, miss, length, reached = self._follow((low + high) / 2, rx, n)
        kept = reached & (np.abs(miss) < 1e-5) & (met == chain).all(axis=1)
        found = zip(met[kept].tolist(), length[kept].tolist(), strict=True)
        return [ShotPath(tuple(row), size) for row, size in found]

    def _follow(
        self, angle: FloatArray, rx: FloatArray, n: int
    ) -> tuple[IntArray, FloatArray, FloatArray, BoolArray]:
        """Objects met (ray, n), signed distance from the RX to the last leg, length, and whether it gets there."""
        origin = np.broadcast_to(self._tx, (len(angle), 2))
        heading = np.column_stack([np.cos(angle), np.sin(angle)])
        chain = np.full((len(angle), n), -1)
        length = np.zeros(len(angle))
        for bounce in range(n):
            hit = self._first(origin, heading)
            chain[:, bounce] = hit.surface
            step = np.where(hit.surface >= 0, hit.distance_m, 0.0)
            origin = origin + step[:, None] * heading
            heading = heading - 2 * (heading * hit.normal).sum(axis=1)[:, None] * hit.normal
            length += step
        offset = rx - origin
        ahead = (offset * heading).sum(axis=1)
        miss = heading[:, 0] * offset[:, 1] - heading[:, 1] * offset[:, 0]
        free = self._first(origin, heading).distance_m > ahead
        return chain, miss, length + ahead, (ahead > 0) & free

    def _first(self, origin: FloatArray, heading: FloatArray) -> Hits:
        best = Hits(np.full(len(origin), -1), np.full(len(origin), np.inf), np.zeros((len(origin), 2)))
        for index, contour in enumerate(self._contours):
            if isinstance(contour, Circle):
                distance, normal = _meet_circle(contour, origin, heading)
            else:
                distance, normal = _meet_chords(*self._chords[index], origin, heading)
            nearer = distance < best.distance_m
            best = Hits(
                np.where(nearer, index, best.surface),
                np.where(nearer, distance, best.distance_m),
                np.where(nearer[:, None], normal, best.normal),
            )
        return best


def _bisected(
    low: FloatArray, high: FloatArray, is_like_low: Callable[[FloatArray], BoolArray]
) -> tuple[FloatArray, FloatArray]:
    """Ends (ray,) of intervals halved until no number lies between them."""
    for _ in range(N_BISECTIONS):
        middle = (low + high) / 2
        if ((middle == low) | (middle == high)).all():
            break
        like_low = is_like_low(middle)
        low, high = np.where(like_low, middle, low), np.where(like_low, high, middle)
    return low, high


def _chords(contour: Contour) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Starts, ends and the normals at both (chord, xy) of a polygon close to a contour."""
    columns: list[tuple[FloatArray, ...]] = []
    for piece in contour.pieces:
        t = np.linspace(0, 1, piece.n_chords(SAGITTA_M, np.pi) + 1)
        point, normal = piece.point(t), piece.outward_normal(t)
        columns.append((point[:-1], point[1:], normal[:-1], normal[1:]))
    start, end, first, last = (np.concatenate(column) for column in zip(*columns, strict=True))
    return start, end, first, last


def _meet_circle(circle: Circle, origin: FloatArray, heading: FloatArray) -> tuple[FloatArray, FloatArray]:
    offset = origin - circle.center_m
    half = (offset * heading).sum(axis=1)
    root = half**2 - (offset**2).sum(axis=1) + circle.radius_m**2
    near = -half - np.sqrt(np.maximum(root, 0))
    distance = np.where((root > 0) & (near > OFF_SURFACE_M), near, np.inf)
    point = offset + np.where(np.isfinite(distance), distance, 0)[:, None] * heading
    return distance, point / circle.radius_m


def _meet_chords(
    start: FloatArray,
    end: FloatArray,
    first: FloatArray,
    last: FloatArray,
    origin: FloatArray,
    heading: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    chord, distance, share = _nearest_chord(start, end - start, origin, heading)
    weight = share[:, None]
    normal = (1 - weight) * first[chord] + weight * last[chord]
    normal = np.where(np.isfinite(distance)[:, None], normal, [1.0, 0.0])
    return distance, normal / np.linalg.norm(normal, axis=1, keepdims=True)


@compiled
def _nearest_chord(
    start: FloatArray, along: FloatArray, origin: FloatArray, heading: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """First chord (ray,) that each ray meets, the distance to it (infinite for none), and the share along it."""
    n_rays = len(origin)
    chord, nearest, place = np.zeros(n_rays, np.int64), np.full(n_rays, np.inf), np.zeros(n_rays)
    for ray in range(n_rays):
        heading_x, heading_y = heading[ray, 0], heading[ray, 1]
        for index in range(len(start)):
            determinant = heading_x * along[index, 1] - heading_y * along[index, 0]
            if determinant == 0:
                continue
            x, y = start[index, 0] - origin[ray, 0], start[index, 1] - origin[ray, 1]
            distance = (x * along[index, 1] - y * along[index, 0]) / determinant
            if not OFF_SURFACE_M < distance < nearest[ray]:
                continue
            share = (x * heading_y - y * heading_x) / determinant
            if 0 <= share <= 1:
                chord[ray], nearest[ray], place[ray] = index, distance, share
    return chord, nearest, place


def _distinct(paths: list[ShotPath]) -> list[ShotPath]:
    kept: list[ShotPath] = []
    for path in sorted(paths, key=lambda one: (one.surface, one.length_m)):
        if not kept or kept[-1].surface != path.surface or path.length_m - kept[-1].length_m > 1e-5:
            kept.append(path)
    return kept
