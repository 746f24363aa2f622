"""Occlusion of straight legs by the scene's prisms, in 2.5 D: plan view and height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from scenes.record import BoolArray, FloatArray, Record, array
from scenes.scene import Scene

OCCLUDER_SAGITTA_M = 1e-4  # curved contours stand as polygons that stay this close to them
MAX_TABLE_ENTRIES = 2_000_000  # legs x edges held at once


@dataclass(frozen=True)
class Occluders(Record):
    """All vertical faces of a scene, and the closed outlines that lids stand over."""

    edge_start_m: FloatArray = array("edge", "xy", unit="m", doc="start of each face in plan view")
    edge_end_m: FloatArray = array("edge", "xy", unit="m", doc="end of each face in plan view")
    z_min_m: FloatArray = array("edge", unit="m", doc="lower rim of the face")
    z_max_m: FloatArray = array("edge", unit="m", doc="upper rim of the face")
    lids: tuple[tuple[float, shapely.Polygon], ...] = ()


def surface_names(scene: Scene) -> list[str]:
    """Names of everything that reflects: the objects in order, then 'floor' and 'ceiling' where there are."""
    planes = [name for name in ("floor", "ceiling") if getattr(scene, name) is not None]
    return [*scene.object_names, *planes]


def occluders(scene: Scene, max_sagitta_m: float = OCCLUDER_SAGITTA_M) -> Occluders:
    """Faces of all objects; floor and ceiling need none, since both ends of a leg lie between them."""
    starts, ends, z_ranges = [np.zeros((0, 2))], [np.zeros((0, 2))], [np.zeros((0, 2))]
    lids = []
    for item in scene.objects:
        corners = item.contour.vertices(max_sagitta_m)
        following = np.roll(corners, -1, axis=0)
        if not item.contour.closed:
            corners, following = corners[:-1], corners[1:]
        else:
            lids += [(z, shapely.Polygon(corners)) for z in (item.z_min_m, item.z_max_m)]
        starts.append(corners)
        ends.append(following)
        z_ranges.append(np.tile([item.z_min_m, item.z_max_m], (len(corners), 1)))
    z_range = np.concatenate(z_ranges)
    return Occluders(np.concatenate(starts), np.concatenate(ends), z_range[:, 0], z_range[:, 1], tuple(lids))


def blocked(faces: Occluders, start_m: FloatArray, end_m: FloatArray) -> BoolArray:
    """Whether each leg (leg, xyz) -> (leg, xyz) meets a face or a lid, ends included (leg,)."""
    start, end = np.atleast_2d(start_m), np.atleast_2d(end_m)
    result = np.zeros(len(start), bool)
    step = max(1, MAX_TABLE_ENTRIES // max(1, faces.size("edge")))
    for first in range(0, len(start), step):
        part = slice(first, first + step)
        result[part] = _meets_face(faces, start[part], end[part])
    for z_m, outline in faces.lids:
        result |= _meets_lid(z_m, outline, start, end)
    return result


def _meets_face(faces: Occluders, start: FloatArray, end: FloatArray) -> BoolArray:
    """Crossing of p + u r (leg) and q + v s (face) in plan view, with the leg's height there between the rims."""
    r = (end - start)[:, None, :2]
    s = (faces.edge_end_m - faces.edge_start_m)[None]
    to_face = faces.edge_start_m[None] - start[:, None, :2]
    determinant = _cross(r, s)
    with np.errstate(divide="ignore", invalid="ignore"):  # parallel: not a crossing
        along_leg = _cross(to_face, s) / determinant
        along_face = _cross(to_face, r) / determinant
        height = start[:, None, 2] + along_leg * (end - start)[:, None, 2]
    crossing = (along_leg >= 0) & (along_leg <= 1) & (along_face >= 0) & (along_face <= 1)
    crossing &= (height >= faces.z_min_m) & (height <= faces.z_max_m)
    return np.asarray(crossing.any(axis=1))


def _meets_lid(z_m: float, outline: shapely.Polygon, start: FloatArray, end: FloatArray) -> BoolArray:
    """Whether each leg passes the height `z_m` inside the outline."""
    result = np.zeros(len(start), bool)
    passes = np.flatnonzero((start[:, 2] - z_m) * (end[:, 2] - z_m) < 0)
    if len(passes):
        share = (z_m - start[passes, 2]) / (end[passes, 2] - start[passes, 2])
        crossing = start[passes] + share[:, None] * (end[passes] - start[passes])
        result[passes] = shapely.contains_xy(outline, crossing[:, 0], crossing[:, 1])
    return result


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
