"""Exact reflection off smooth contours, alone or with one flat face. Faceted ray tracing misses these paths.

All objects are vertical prisms, so the point of reflection is a stationary point in plan view of the length
|S - c(t)| + |c(t) - Q|, where S is the TX or its image in an earlier flat face, and Q is the RX or its image in
a later flat face. The solver finds every solution. A convex curve has at most one on its lit side, where the
length is a minimum. On a concave curve the solver follows all sign changes of the slope, including close pairs.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from scenes.record import BoolArray, FloatArray, IntArray, Record, array
from sim.propagation.specular.curves import N_NODES, NODE_T, Curves
from sim.propagation.specular.images import CLEARANCE_M, FaceChains, is_outside_beam, points_on_faces
from sim.propagation.specular.plan_view import PlanPaths, dot, norm
from sim.propagation.specular.surfaces import Faces

MIN_COS_INCIDENCE = 1e-5  # nearer to grazing, rounding errors decide whether the curve blocks itself
CURVE_OVERLAP = 1e-9  # the search extends by this share beyond the ends of a curve, to include the joints
MAX_STEPS = 60
STEP_LIMIT_M = 1e-10  # the Newton iteration ends below this step: the next one would be about its square
RESIDUAL_LIMIT_M = 1e-9
N_REFINED = 16  # parts of an interval that may hold a close pair of solutions


@dataclass(frozen=True)
class ReflectionPoints(Record):
    """Points of reflection on curves: index of the candidate and local geometry."""

    row: IntArray = array("bounce", dtype=int, doc="index of the candidate")
    point_m: FloatArray = array("bounce", "xy", unit="m", doc="point of reflection")
    normal: FloatArray = array("bounce", "xy", doc="unit normal of the lit side")
    curvature: FloatArray = array("bounce", unit="1/m", doc="> 0 where convex, seen from the lit side")


def curved_paths(curves: Curves, tx_xy_m: FloatArray, rx_xy_m: FloatArray) -> PlanPaths:
    """Paths of one bounce off a curve to receivers (receiver, xy), without test for occlusion."""
    curve = _lit_curves(curves, tx_xy_m)
    receiver, pick = (part.ravel() for part in np.indices((len(rx_xy_m), len(curve))))
    curve = curve[pick]
    found = reflection_points(curves, curve, np.broadcast_to(tx_xy_m, (len(curve), 2)), rx_xy_m[receiver])
    return PlanPaths(
        receiver[found.row],
        curves.surface[curve[found.row], None],
        found.point_m[:, None],
        found.normal[:, None],
        found.curvature[:, None],
    )


def planar_curved_paths(
    faces: Faces, curves: Curves, chain: FaceChains, tx_xy_m: FloatArray, rx_xy_m: FloatArray
) -> PlanPaths:
    """Paths TX, flat face, curve, RX for the faces of the chains of length one."""
    row, curve = np.indices((len(chain), len(curves))).reshape(2, -1)
    face, image = chain.face[row, 0], chain.image_m[row, 1]
    kept = _is_reached(faces, curves, face, image, curve)
    face, image, curve = face[kept], image[kept], curve[kept]
    receiver, pick = (part.ravel() for part in np.indices((len(rx_xy_m), len(curve))))
    face, image, curve = face[pick], image[pick], curve[pick]
    found = reflection_points(curves, curve, image, rx_xy_m[receiver])
    return _with_face(faces, curves, face, image, curve, receiver, found, face_first=True)


def curved_planar_paths(faces: Faces, curves: Curves, tx_xy_m: FloatArray, rx_xy_m: FloatArray) -> PlanPaths:
    """Paths TX, curve, flat face, RX."""
    every = np.arange(faces.size("face"))
    receiver, face = np.nonzero(faces.height_over(every[None], rx_xy_m[:, None]) > CLEARANCE_M)
    image = faces.mirror(face, rx_xy_m[receiver])
    lit = _lit_curves(curves, tx_xy_m)
    row, pick = (part.ravel() for part in np.indices((len(face), len(lit))))
    face, image, receiver, curve = face[row], image[row], receiver[row], lit[pick]
    kept = _is_reached(faces, curves, face, image, curve)
    face, image, receiver, curve = face[kept], image[kept], receiver[kept], curve[kept]
    found = reflection_points(curves, curve, np.broadcast_to(tx_xy_m, image.shape), image)
    return _with_face(faces, curves, face, image, curve, receiver, found, face_first=False)


def _with_face(
    faces: Faces,
    curves: Curves,
    face: IntArray,
    image_m: FloatArray,
    curve: IntArray,
    receiver: IntArray,
    found: ReflectionPoints,
    *,
    face_first: bool,
) -> PlanPaths:
    """Paths of two corners: a bounce on a curve, and a point on the flat face before or after it."""
    row = found.row
    point, valid = points_on_faces(faces, face[row], image_m[row], found.point_m)
    row, found, point = row[valid], found.take("bounce", valid), point[valid]
    return PlanPaths(
        receiver[row],
        _in_order(faces.surface[face[row]], curves.surface[curve[row]], face_first),
        _in_order(point, found.point_m, face_first),
        _in_order(faces.normal[face[row]], found.normal, face_first),
        _in_order(np.zeros(len(row)), found.curvature, face_first),
    )


def _in_order(on_face: Any, on_curve: Any, face_first: bool) -> Any:
    return np.stack((on_face, on_curve) if face_first else (on_curve, on_face), axis=1)


def reflection_points(
    curves: Curves, curve: IntArray, source_m: FloatArray, target_m: FloatArray
) -> ReflectionPoints:
    """All lit points of reflection on curves (candidate,) between points (candidate, xy) and (candidate, xy)."""
    row, low, high = _brackets(curves, curve, source_m, target_m)
    t, residual = _refine(curves, curve[row], source_m[row], target_m[row], low, high)
    index = curve[row]
    point, first, second = curves.at(index, t)
    normal = curves.normal(index, first)
    to_source, to_target = source_m[row] - point, target_m[row] - point
    valid = residual <= RESIDUAL_LIMIT_M
    valid &= curves.is_cyclic[index] | ((t >= -CURVE_OVERLAP) & (t <= 1 + CURVE_OVERLAP))
    valid &= dot(normal, to_source) > MIN_COS_INCIDENCE * norm(to_source)
    valid &= dot(normal, to_target) > MIN_COS_INCIDENCE * norm(to_target)
    curvature = curves.curvature(index, first, second)
    return ReflectionPoints(row[valid], point[valid], normal[valid], curvature[valid])


def length_derivatives(
    curves: Curves, curve: IntArray, t: FloatArray, source_m: FloatArray, target_m: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """d/dt and d^2/dt^2 (n,) of |S - c(t)| + |c(t) - Q| in m, and the speed |c'| (n,) in m."""
    point, first, second = curves.at(curve, t)
    return *_slopes(point, first, second, source_m, target_m), norm(first)


def _slopes(
    point: FloatArray, first: FloatArray, second: FloatArray, source_m: FloatArray, target_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    slope: FloatArray = np.zeros(())
    bend: FloatArray = np.zeros(())
    speed_squared = dot(first, first)
    for end in (source_m, target_m):
        offset = point - end
        distance = np.maximum(norm(offset), 1e-12)
        along = dot(first, offset) / distance
        slope = slope + along
        bend = bend + dot(second, offset) / distance + (speed_squared - along * along) / distance
    return slope, bend


def _brackets(
    curves: Curves, curve: IntArray, source_m: FloatArray, target_m: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Candidates and parameter intervals (low, high) that hold one solution each."""
    convex = np.flatnonzero(curves.is_convex[curve])
    node = curves.node_m[curve[convex]]
    length = norm(node - source_m[convex, None]) + norm(node - target_m[convex, None])
    least = length.argmin(axis=1)
    step = NODE_T[1]
    concave = np.flatnonzero(~curves.is_convex[curve])
    parts = [(convex, NODE_T[least] - step, NODE_T[least] + step)]
    if len(concave):
        parts.append(_sign_changes(curves, curve, source_m, target_m, concave))
    row, low, high = (np.concatenate(column) for column in zip(*parts, strict=True))
    return row, low, high


def _sign_changes(
    curves: Curves, curve: IntArray, source_m: FloatArray, target_m: FloatArray, rows: IntArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Intervals of the node grid where the slope changes sign once, and, on a finer grid, twice."""
    index = curve[rows]
    slope, bend = _slopes(
        curves.node_m[index], curves.node_first[index], curves.node_second[index],
        source_m[rows, None], target_m[rows, None],
    )  # fmt: skip
    step = NODE_T[1]
    rising = slope > 0
    changes = rising[:, 1:] != rising[:, :-1]
    one, interval = np.nonzero(changes)
    ends = CURVE_OVERLAP * np.array([-1.0, 1.0])
    low, high = NODE_T[interval], NODE_T[interval + 1]
    low, high = np.where(interval == 0, ends[0], low), np.where(interval == N_NODES - 2, 1 + ends[1], high)
    near, place = np.nonzero(~changes & _may_hold_pair(slope, bend * step))
    if not len(near):
        return rows[one], low, high
    fine = NODE_T[place][:, None] + step * np.linspace(0, 1, N_REFINED + 1)
    pick = np.repeat(rows[near], N_REFINED + 1)
    fine_slope, _, _ = length_derivatives(curves, curve[pick], fine.ravel(), source_m[pick], target_m[pick])
    rising = fine_slope.reshape(fine.shape) > 0
    extra, part = np.nonzero(rising[:, 1:] != rising[:, :-1])
    return (
        np.concatenate([rows[one], rows[near][extra]]),
        np.concatenate([low, fine[extra, part]]),
        np.concatenate([high, fine[extra, part + 1]]),
    )


def _may_hold_pair(value: FloatArray, change: FloatArray) -> BoolArray:
    """Whether a function may reach zero twice between nodes (row, node - 1), from the tangents at both ends."""
    sign = np.sign(value[:, :-1])
    left, right = sign * value[:, :-1], sign * value[:, 1:]
    fall, rise = -sign * change[:, :-1], sign * change[:, 1:]
    dips = (fall > 0) & (rise > 0)
    total = np.where(dips, fall + rise, 1.0)
    # The tangents left - fall x and right - rise (1 - x) meet at x, below the function where it is convex.
    meeting = left - fall * (left - right + rise) / total
    return np.asarray(dips & (meeting < np.minimum(left, right) * 0.5))


def _refine(
    curves: Curves, curve: IntArray, source_m: FloatArray, target_m: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Newton's method on the slope, kept inside the brackets by bisection: t and the last step in m."""
    t = (low + high) / 2
    low, high, residual = low.copy(), high.copy(), np.full(len(t), np.inf)
    falls = length_derivatives(curves, curve, low, source_m, target_m)[0] > 0
    falls &= ~curves.is_convex[curve]  # a convex curve has a minimum, also if the slopes beyond differ
    active = np.arange(len(t))
    for _ in range(MAX_STEPS):
        if not len(active):
            break
        here = curve[active]
        slope, bend, speed = length_derivatives(curves, here, t[active], source_m[active], target_m[active])
        beyond = (slope > 0) != falls[active]
        high[active[beyond]] = t[active[beyond]]
        low[active[~beyond]] = t[active[~beyond]]
        usable = np.where(falls[active], bend < 0, bend > 0)
        newton = t[active] - slope / np.where(usable, bend, 1.0)
        usable &= (newton >= low[active]) & (newton <= high[active])
        following = np.where(usable, newton, (low[active] + high[active]) / 2)
        step = np.abs(following - t[active])
        residual[active] = np.where(usable, step * speed, np.inf)
        t[active] = following
        active = active[step * speed > STEP_LIMIT_M]
    return t, residual


def _lit_curves(curves: Curves, point_m: FloatArray) -> IntArray:
    """Curves with a node for which a point (xy,) is on the lit side."""
    offset = point_m - curves.node_m
    return np.flatnonzero((dot(curves.node_normal, offset) > 0).any(axis=1))


def _is_reached(faces: Faces, curves: Curves, face: IntArray, image_m: FloatArray, curve: IntArray) -> BoolArray:
    """Whether a part of each curve lies in front of a face and in the beam from an image through this face."""
    center, reach = curves.center_m[curve], curves.reach_m[curve]
    kept = faces.height_over(face, center) > -reach
    return kept & ~is_outside_beam(faces, face, image_m, center, reach)
