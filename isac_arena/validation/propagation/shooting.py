"""Rays shot in plan view and bisected onto the receiver: finds reflections without stationary points.

Rays leave the TX towards closely spaced points of every contour and are followed mirror by mirror; where two
neighbours over the same objects pass the receiver on different sides, a path lies between them. Where two
neighbours meet different objects, the last rays that still meet the same ones are found first: a path that grazes
a pillar lies in a sliver of angle beside its rim.
"""

from dataclasses import dataclass

import numpy as np

from scenes.contours import Circle, Contour
from scenes.record import BoolArray, FloatArray, IntArray
from scenes.scene import Scene

POINTS_PER_CONTOUR = 4000
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
        found: list[ShotPath] = []
        for contour in self._contours:
            t = np.linspace(0, 1, POINTS_PER_CONTOUR, endpoint=False)
            for piece in contour.pieces:
                aim = piece.point(t)
                angle = np.unwrap(np.arctan2(aim[:, 1] - self._tx[1], aim[:, 0] - self._tx[0]))
                for n in range(1, max_bounces + 1):
                    found += self._between(*self._stretches(angle, rx_xy_m, n), rx_xy_m, n)
        return _distinct(found)

    def _stretches(self, angle: FloatArray, rx: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
        """Intervals of angle, lower and upper ends, over which the rays meet the same objects."""
        chain = self._follow(angle, rx, n)[0]
        differs = np.flatnonzero((chain[:-1] != chain[1:]).any(axis=1))
        low, high = [np.delete(angle[:-1], differs)], [np.delete(angle[1:], differs)]
        for anchor, other in ((differs, differs + 1), (differs + 1, differs)):
            near, far = angle[anchor], angle[other]
            for _ in range(N_BISECTIONS):
                middle = (near + far) / 2
                same = (self._follow(middle, rx, n)[0] == chain[anchor]).all(axis=1)
                near, far = np.where(same, middle, near), np.where(same, far, middle)
            low.append(angle[anchor])
            high.append(near)
        return np.concatenate(low), np.concatenate(high)

    def _between(self, low: FloatArray, high: FloatArray, rx: FloatArray, n: int) -> list[ShotPath]:
        chain_low, miss_low, _, _ = self._follow(low, rx, n)
        chain_high, miss_high, _, _ = self._follow(high, rx, n)
        bracket = (chain_low == chain_high).all(axis=1) & (chain_low >= 0).all(axis=1)
        bracket &= (miss_low > 0) != (miss_high > 0)
        low, high, above = low[bracket], high[bracket], miss_low[bracket] > 0
        chain = chain_low[bracket]
        for _ in range(N_BISECTIONS):
            middle = (low + high) / 2
            same = (self._follow(middle, rx, n)[1] > 0) == above
            low, high = np.where(same, middle, low), np.where(same, high, middle)
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
    along = end - start
    determinant = heading[:, :1] * along[:, 1] - heading[:, 1:] * along[:, 0]
    x, y = start[:, 0] - origin[:, :1], start[:, 1] - origin[:, 1:]
    safe = np.where(determinant == 0, 1.0, determinant)
    distance = (x * along[:, 1] - y * along[:, 0]) / safe
    share = (x * heading[:, 1:] - y * heading[:, :1]) / safe
    valid = (determinant != 0) & (share >= 0) & (share <= 1) & (distance > OFF_SURFACE_M)
    distance = np.where(valid, distance, np.inf)
    chord = distance.argmin(axis=1)
    ray = np.arange(len(origin))
    weight = np.clip(share[ray, chord], 0, 1)[:, None]
    normal = (1 - weight) * first[chord] + weight * last[chord]
    hit = np.isfinite(distance[ray, chord])
    normal = np.where(hit[:, None], normal, [1.0, 0.0])
    return distance[ray, chord], normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _distinct(paths: list[ShotPath]) -> list[ShotPath]:
    kept: list[ShotPath] = []
    for path in sorted(paths, key=lambda one: (one.surface, one.length_m)):
        if not kept or kept[-1].surface != path.surface or path.length_m - kept[-1].length_m > 1e-5:
            kept.append(path)
    return kept
