"""Contours, objects, meshes and devices moved by a rigid motion: the same shapes at another place."""

from dataclasses import replace
from typing import TypeVar

import numpy as np

from scenes.contours import Contour, Ellipse
from scenes.motion.motion import RigidState
from scenes.objects.clutter import Clutter
from scenes.objects.scene_object import SceneObject
from scenes.pose import Pose
from scenes.record import FloatArray

C = TypeVar("C", bound=Contour)
POINT_FIELDS = ("center_m", "vertices_m", "points_m")


def moved_contour(contour: C, pivot_m: FloatArray, state: RigidState) -> C:
    """A contour turned about a pivot (xy,) and shifted."""
    changes: dict[str, object] = {
        name: _moved(getattr(contour, name), pivot_m, state) for name in POINT_FIELDS if hasattr(contour, name)
    }
    if isinstance(contour, Ellipse):
        changes["rotation_rad"] = contour.rotation_rad + state.turn_rad
    return replace(contour, **changes)


def moved_object(item: SceneObject, time_s: float) -> SceneObject:
    """An object where its motion has brought it at a time, at rest; itself if it stands."""
    if item.motion is None:
        return item
    state = item.motion.at(time_s)
    contour = moved_contour(item.contour, item.pivot_m[:2], state)
    low, high = (z_m + float(state.shift_m[2]) for z_m in (item.z_min_m, item.z_max_m))
    target = item.target and replace(item.target, heading_rad=item.target.heading_rad + state.turn_rad)
    return replace(item, contour=contour, z_min_m=low, z_max_m=high, motion=None, target=target)


def moved_clutter(item: Clutter, time_s: float) -> Clutter:
    """A mesh where its motion has brought it at a time, at rest; itself if it stands."""
    if item.motion is None:
        return item
    state = item.motion.at(time_s)
    xy = _moved(item.vertices_m[:, :2], item.pivot_m[:2], state)
    return replace(item, vertices_m=np.column_stack([xy, item.vertices_m[:, 2] + state.shift_m[2]]), motion=None)


def moved_pose(pose: Pose, state: RigidState) -> Pose:
    """A device at the place where its motion has brought it."""
    return Pose(pose.position_m + state.shift_m, pose.heading_rad + state.turn_rad)


def carried_points(point_m: FloatArray, pivot_m: FloatArray, before: RigidState, after: RigidState) -> FloatArray:
    """Points (..., xyz) of a body in one state, where they are in another; the pivot is that at rest."""
    turn, now = after.turn_rad - before.turn_rad, pivot_m + before.shift_m
    step = replace(after, turn_rad=turn, shift_m=after.shift_m - before.shift_m)
    level = _moved(point_m[..., :2], now[:2], step)
    return np.concatenate([level, point_m[..., 2:] + step.shift_m[2]], axis=-1)


def _moved(point_m: FloatArray, pivot_m: FloatArray, state: RigidState) -> FloatArray:
    """Points (..., xy) turned about a pivot (xy,) and shifted."""
    c, s = np.cos(state.turn_rad), np.sin(state.turn_rad)
    return np.asarray((point_m - pivot_m) @ np.array([(c, s), (-s, c)]) + pivot_m + state.shift_m[:2])
