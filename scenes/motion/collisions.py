"""Movers that drive through something: every mover is followed over the whole campaign in steps of centimetres."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import shapely

from scenes.motion.motion import Motion
from scenes.objects.clutter import Clutter
from scenes.objects.scene_object import OVERLAP_TOLERANCE_M, SceneObject
from scenes.record import BoolArray, FloatArray
from scenes.scene import THIN_WALL_CLEARANCE_M, Scene
from scenes.walks.trajectory import stop_times_s, velocities_m_s

STEP_M = 0.02  # between two places of a mover that are looked at
MOST_PLACES = 200_000  # of all movers together; steps are longer where this is too few
LEAST_PLACES = 200  # of a mover
MOST_MOVERS = 100
SWEEP_PLACES = 9  # of a receiver in a sweep
OUTLINE_SAGITTA_M = 5e-4


@dataclass(frozen=True)
class _Mover:
    """A moving body: its outline (corner, xy) at time zero, relative to its pivot."""

    name: str
    outline_m: FloatArray
    is_closed: bool
    pivot_m: FloatArray
    z_m: tuple[float, float]
    motion: Motion
    may_overlap: bool

    @property
    def reach_m(self) -> float:
        return float(np.linalg.norm(self.outline_m, axis=1).max())

    def bodies(self, time_s: FloatArray) -> Any:
        """Its plan (time,) at times (time,), without a rim of the tolerance."""
        place = self.motion.over(time_s)[0]
        c, s = np.cos(place[:, 3]), np.sin(place[:, 3])
        turn = np.stack([np.stack([c, s], axis=1), np.stack([-s, c], axis=1)], axis=1)
        corners = self.outline_m @ turn + (self.pivot_m[:2] + place[:, :2])[:, None]
        return shapely.polygons(corners) if self.is_closed else shapely.linestrings(corners)

    def covers(self, point_m: FloatArray, time_s: FloatArray) -> BoolArray:
        """Whether it holds points (point, xyz) at times (point,)."""
        place = self.motion.over(time_s)[0]
        offset = point_m[:, :2] - self.pivot_m[:2] - place[:, :2]
        c, s = np.cos(place[:, 3]), np.sin(place[:, 3])
        back = np.stack([c * offset[:, 0] + s * offset[:, 1], c * offset[:, 1] - s * offset[:, 0]], axis=1)
        body = shapely.polygons(self.outline_m) if self.is_closed else shapely.linestrings(self.outline_m)
        near = shapely.distance(body, shapely.points(back)) <= (0.0 if self.is_closed else THIN_WALL_CLEARANCE_M)
        height = point_m[:, 2] - place[:, 2]
        return np.asarray(near & (height >= self.z_m[0]) & (height <= self.z_m[1]))


def check_motion(scene: Scene, sweep_s: float) -> None:
    """Raise `ValueError`, one line with names and time, where something drives through something else.

    The campaign starts at time zero and ends with its last sweep; a sweep takes `sweep_s`. Movers may touch, and
    may overlap where one of the two has `may_overlap`. The TX and the receiver, while it sweeps, are points.
    """
    middle_s = stop_times_s(scene.walk, sweep_s)
    if not scene.is_moving:
        return
    end_s = float(middle_s[-1] + sweep_s / 2)
    movers = list(_movers(scene))
    if len(movers) > MOST_MOVERS:
        raise ValueError(f"motion: {len(movers)} objects and meshes move, at most {MOST_MOVERS} may")
    time_s = _times(scene, movers, end_s)
    fixed = _without_movers(scene)
    for mover in movers:
        _check_solids(mover, fixed, time_s)
        _check_heights(mover.name, mover.z_m, mover.motion, scene, time_s)
    for one, other in combinations(movers, 2):
        _check_pair(one, other, time_s)
    tx_motion = scene.tx_motions.get(scene.tx_name)
    if tx_motion is not None:
        z_m = float(scene.tx.position_m[2])
        _check_heights("TX", (z_m, z_m), tx_motion, scene, time_s)
    tx_m = np.broadcast_to(scene.tx.position_m, (len(time_s), 3))
    tx_m = tx_m + (tx_motion.over(time_s)[0][:, :3] if tx_motion else 0.0)
    _check_points("TX", tx_m, time_s, fixed, movers)
    inside_s = sweep_s * np.linspace(-0.5, 0.5, SWEEP_PLACES)
    velocity = velocities_m_s(scene.walk)
    for stop, (place, at_s) in enumerate(zip(scene.walk.positions_m(), middle_s, strict=True)):
        rx_m = place + inside_s[:, None] * velocity[stop]
        _check_points(f"the receiver at stop {stop}", rx_m, at_s + inside_s, fixed, movers)


def _without_movers(scene: Scene) -> Scene:
    """The scene without what moves."""
    still = [item for item in scene.objects if item.motion is None]
    clutter = tuple(item for item in scene.clutter if item.motion is None)
    return replace(scene.at(0.0), objects=tuple(still), clutter=clutter, name=scene.name)


def _movers(scene: Scene) -> Iterator[_Mover]:
    for item in scene.objects:
        if item.motion is not None:
            body = item.contour.body(OUTLINE_SAGITTA_M)
            yield _mover(item, body, item.contour.closed, (item.z_min_m, item.z_max_m), item.may_overlap)
    for mesh in scene.clutter:
        if mesh.motion is not None:
            low, high = mesh.bounds_m
            body = shapely.convex_hull(shapely.multipoints(mesh.vertices_m[:, :2]))
            if body.geom_type == "Polygon":  # a mesh without extent in the plan drives through nothing
                yield _mover(mesh, body, True, (float(low[2]), float(high[2])), False)


def _mover(item: SceneObject | Clutter, body: Any, closed: bool, z_m: tuple[float, float], free: bool) -> _Mover:
    assert item.motion is not None
    shrunk = _shrunk(body) if closed else body
    line = shrunk.exterior if closed else shrunk
    outline = shapely.get_coordinates(line)[: -1 if closed else None]
    return _Mover(item.name, outline - item.pivot_m[:2], closed, item.pivot_m, z_m, item.motion, free)


def _shrunk(body: Any) -> Any:
    """A polygon without a rim of half of the tolerance; itself where nothing is left, or it falls apart."""
    smaller = body.buffer(-OVERLAP_TOLERANCE_M / 2)
    return smaller if smaller.geom_type == "Polygon" and not smaller.is_empty else body


def _times(scene: Scene, movers: list[_Mover], end_s: float) -> FloatArray:
    """Times of the campaign at which all places are looked at."""
    speeds = [one.motion.top_speed_m_s + one.reach_m * one.motion.top_turn_rate_rad_s for one in movers]
    speeds += [motion.top_speed_m_s for motion in scene.tx_motions.values()]
    most = max(LEAST_PLACES, MOST_PLACES // max(1, len(movers)))
    count = min(most, int(end_s * max(speeds, default=0.0) / STEP_M) + 2)
    return np.linspace(0.0, end_s, count)


def _check_solids(mover: _Mover, fixed: Scene, time_s: FloatArray) -> None:
    """Refuse a mover that drives through an object or a mesh that stands."""
    others: list[tuple[str, Any, tuple[float, float]]] = []
    for item in fixed.objects:
        if not (item.may_overlap or mover.may_overlap):
            body = item.contour.body(OUTLINE_SAGITTA_M)
            body = _shrunk(body) if item.contour.closed else body
            others.append((item.name, body, (item.z_min_m, item.z_max_m)))
    for mesh in fixed.clutter:
        low, high = mesh.bounds_m
        hull = shapely.convex_hull(shapely.multipoints(mesh.vertices_m[:, :2]))
        others.append((mesh.name, hull, (float(low[2]), float(high[2]))))
    if not others:
        return
    tree = shapely.STRtree([body for _, body, _ in others])
    rise = mover.motion.over(time_s)[0]
    track = mover.pivot_m[:2] + rise[:, :2]
    steps = shapely.linestrings(np.stack([track[:-1], track[1:]], axis=1))
    found = [tree.query(what, predicate="intersects") for what in (mover.bodies(time_s), steps)]
    moment, other = np.concatenate(found, axis=1)
    for place in np.argsort(moment, kind="stable"):
        name, _, z_m = others[other[place]]
        if _overlap(mover.z_m, z_m, rise[moment[place], 2]):
            raise ValueError(_collision(mover.name, name, time_s[moment[place]]))


def _check_pair(one: _Mover, other: _Mover, time_s: FloatArray) -> None:
    """Refuse two movers that meet."""
    if one.may_overlap or other.may_overlap:
        return
    places = [item.pivot_m + item.motion.over(time_s)[0][:, :3] for item in (one, other)]
    gap = np.linalg.norm((places[0] - places[1])[:, :2], axis=1)
    near = np.flatnonzero(gap <= one.reach_m + other.reach_m)
    hit = near[shapely.intersects(one.bodies(time_s[near]), other.bodies(time_s[near]))]
    for moment in hit:
        rise = (places[0] - one.pivot_m - places[1] + other.pivot_m)[moment, 2]
        if _overlap(one.z_m, other.z_m, rise):
            raise ValueError(_collision(one.name, other.name, time_s[moment]))


def _check_points(label: str, point_m: FloatArray, time_s: FloatArray, fixed: Scene, movers: list[_Mover]) -> None:
    """Refuse a device at points (point, xyz) and times (point,) inside an object or a mesh."""
    inside = fixed.object_index_at(point_m)
    for index in np.flatnonzero(inside >= 0)[:1]:
        raise ValueError(_collision(label, fixed.objects[inside[index]].name, time_s[index]))
    for mesh in fixed.clutter:
        for index in np.flatnonzero(mesh.contains(point_m))[:1]:
            raise ValueError(_collision(label, mesh.name, time_s[index]))
    for mover in movers:
        for index in np.flatnonzero(mover.covers(point_m, time_s))[:1]:
            raise ValueError(_collision(label, mover.name, time_s[index]))


def _check_heights(name: str, z_m: tuple[float, float], motion: Motion, scene: Scene, time_s: FloatArray) -> None:
    """Refuse what moves through the floor or the ceiling."""
    rise = motion.over(time_s)[0][:, 2]
    for plane, sign, end in ((scene.floor, -1, z_m[0]), (scene.ceiling, 1, z_m[1])):
        if plane is not None:
            beyond = sign * (end + rise - plane.z_m) > OVERLAP_TOLERANCE_M
            beyond &= np.abs(rise) > OVERLAP_TOLERANCE_M
            if beyond.any():
                raise ValueError(_collision(name, "floor" if sign < 0 else "ceiling", time_s[np.argmax(beyond)]))


def _overlap(z_m: tuple[float, float], other_m: tuple[float, float], rise_m: float) -> bool:
    common = min(z_m[1] + rise_m, other_m[1]) - max(z_m[0] + rise_m, other_m[0])
    return bool(common > OVERLAP_TOLERANCE_M)


def _collision(name: str, other: str, time_s: float) -> str:
    return f"motion: {name} drives through '{other}' at {time_s:.2f} s: change a path, a speed or a start"
