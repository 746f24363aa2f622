"""Exact double reflection off two curved walls.

The points c1(s), c2(t) are stationary points of |T - c1| + |c1 - c2| + |c2 - R| in plan view. Two convex curves
have at most one lit solution, because the length is convex over their hulls. Newton's method finds it from the
nearest nodes. If one of them is concave, the method starts in every grid cell in which both gradients may vanish.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.record import BoolArray, FloatArray, IntArray
from sim.propagation.specular.curved import CURVE_OVERLAP, MIN_COS_INCIDENCE, RESIDUAL_LIMIT_M, STEP_LIMIT_M
from sim.propagation.specular.curves import N_NODES, NODE_T, Curves
from sim.propagation.specular.plan_view import SAME_POINT_M, PlanPaths, dot, norm

MAX_STEPS = 24
PATIENCE, LOST_STEP = 10, 0.01  # after PATIENCE steps, starts with larger steps than LOST_STEP are discarded
MAX_STEP = 3 * float(NODE_T[1])
COARSE = np.arange(0, N_NODES, 2)  # nodes for the test whether two curves see each other
SIGHT_SLACK = 0.1  # share of the reach of a curve
GRID = np.arange(0, N_NODES, 4)  # nodes of the grid of starts


@dataclass(frozen=True)
class CurvePairs:
    """Candidates: receiver, first and second curve (candidate,), and the ends (candidate, xy)."""

    receiver: IntArray
    first: IntArray
    second: IntArray
    source_m: FloatArray
    target_m: FloatArray

    def take(self, index: IntArray | BoolArray) -> CurvePairs:
        """The candidates of an index."""
        return CurvePairs(
            self.receiver[index], self.first[index], self.second[index], self.source_m[index], self.target_m[index]
        )


def facing_pairs(curves: Curves, tx_xy_m: FloatArray) -> tuple[IntArray, IntArray]:
    """First and second curves (pair,) that see each other, the first one lit by the TX (xy,)."""
    first = np.flatnonzero((dot(curves.node_normal, tx_xy_m - curves.node_m) > 0).any(axis=1))
    node, normal = curves.node_m[:, COARSE], curves.node_normal[:, COARSE]
    slack = -SIGHT_SLACK * curves.reach_m  # allows for the curve between the coarse nodes
    seen = np.zeros((len(first), len(curves)), bool)
    for row, index in enumerate(first.tolist()):
        forth = node[:, None] - node[index, :, None]
        margin = slack[:, None, None] + slack[index]
        front = dot(normal[index, :, None], forth) > margin
        back = dot(normal[:, None], forth) < -margin
        seen[row] = (front & back).any(axis=(1, 2))
    pair, second = np.nonzero(seen)
    return first[pair], second


def curved_curved_paths(
    curves: Curves, pairs: tuple[IntArray, IntArray], tx_xy_m: FloatArray, rx_xy_m: FloatArray
) -> PlanPaths:
    """Paths TX, curve, curve, RX to receivers (receiver, xy) over pairs of curves, without test for occlusion."""
    first, second = pairs
    lit = _sees(curves, rx_xy_m)
    receiver, pick = np.nonzero(lit[:, second])
    target = rx_xy_m[receiver]
    candidates = CurvePairs(receiver, first[pick], second[pick], np.broadcast_to(tx_xy_m, target.shape), target)
    both = curves.is_convex[candidates.first] & curves.is_convex[candidates.second]
    convex, other = candidates.take(both), candidates.take(~both)
    row, start = _grid_starts(curves, other)
    joined = _joined(convex, other.take(row))
    return _solved(curves, joined, np.concatenate([_convex_start(curves, convex), start]))


def _joined(a: CurvePairs, b: CurvePairs) -> CurvePairs:
    return CurvePairs(
        *(np.concatenate([getattr(a, name), getattr(b, name)]) for name in CurvePairs.__dataclass_fields__)
    )


def _sees(curves: Curves, point_m: FloatArray) -> BoolArray:
    """Whether points (point, xy) lie on the lit side of a node of each curve (point, curve)."""
    level = dot(curves.node_normal, curves.node_m)
    return np.stack([(dot(curves.node_normal, point) > level).any(axis=1) for point in point_m]).reshape(
        len(point_m), len(curves)
    )


def _convex_start(curves: Curves, pairs: CurvePairs) -> FloatArray:
    """Parameters (candidate, 2) of nodes that give almost the shortest path."""
    a, b = pairs.first, pairs.second
    other = curves.center_m[b]
    for _ in range(2):
        s = _nearest_node(curves, a, pairs.source_m, other)
        t = _nearest_node(curves, b, curves.node_m[a, s], pairs.target_m)
        other = curves.node_m[b, t]
    return np.column_stack([NODE_T[s], NODE_T[t]])


def _nearest_node(curves: Curves, curve: IntArray, source_m: FloatArray, target_m: FloatArray) -> IntArray:
    node = curves.node_m[curve]
    return np.asarray((norm(node - source_m[:, None]) + norm(node - target_m[:, None])).argmin(axis=1))


def _grid_starts(curves: Curves, pairs: CurvePairs) -> tuple[IntArray, FloatArray]:
    """Candidates and parameters (start, 2) of grid cells in or next to which both slopes change sign."""
    x = curves.node_m[pairs.first][:, GRID, None]
    y = curves.node_m[pairs.second][:, None, GRID]
    between = x - y
    unit = between / np.maximum(norm(between), 1e-12)[..., None]
    from_tx, from_rx = x - pairs.source_m[:, None, None], y - pairs.target_m[:, None, None]
    slope_1 = dot(curves.node_first[pairs.first][:, GRID, None], unit + from_tx / norm(from_tx)[..., None])
    slope_2 = dot(curves.node_first[pairs.second][:, None, GRID], from_rx / norm(from_rx)[..., None] - unit)
    row, i, j = np.nonzero(_changes_sign(slope_1) & _changes_sign(slope_2))
    half = NODE_T[GRID[1]] / 2
    return row, np.column_stack([NODE_T[GRID[i]], NODE_T[GRID[j]]]) + half


def _changes_sign(value: FloatArray) -> BoolArray:
    """Cells (pair, i, j) with both signs among the nodes of the cell and the next ones around it."""
    found = []
    for sign in (value >= 0, value <= 0):
        near = sign
        for axis in (1, 2):
            width = [(0, 0), (0, 0), (0, 0)]
            width[axis] = (1, 1)
            padded = np.moveaxis(np.pad(near, width), axis, 0)
            near = np.moveaxis(padded[:-3] | padded[1:-2] | padded[2:-1] | padded[3:], 0, axis)
        found.append(near)
    return np.asarray(found[0] & found[1])


def _solved(curves: Curves, pairs: CurvePairs, start: FloatArray) -> PlanPaths:
    """Newton's method from starts (candidate, 2); lit solutions only."""
    u = start.copy()
    residual = np.full(len(u), np.inf)
    active = np.arange(len(u))
    for n_steps in range(MAX_STEPS):
        if not len(active):
            break
        step, speed = _newton_step(curves, pairs.take(active), u[active])
        size = np.abs(step).max(axis=1)
        u[active] += step * np.minimum(1, MAX_STEP / np.maximum(size, 1e-300))[:, None]
        residual[active] = size * speed
        inside = np.abs(u[active] - 0.5).max(axis=1) < 1.0
        lost = (n_steps >= PATIENCE) & (size > LOST_STEP)
        active = active[(size * speed > STEP_LIMIT_M) & inside & ~lost]
    return _lit(curves, pairs, u, residual <= RESIDUAL_LIMIT_M)


def _newton_step(curves: Curves, pairs: CurvePairs, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Newton step (candidate, 2) to a zero of both slopes (a minimum if both curves are convex), and max |c'|."""
    x, dx, ddx = curves.at(pairs.first, u[:, 0])
    y, dy, ddy = curves.at(pairs.second, u[:, 1])
    slope_x, slope_y = np.zeros(len(u)), np.zeros(len(u))
    xx, yy = np.zeros(len(u)), np.zeros(len(u))
    between = x - y
    gap = np.maximum(norm(between), 1e-12)
    for offset, distance in ((x - pairs.source_m, None), (between, gap)):
        slope, bend = _length_terms(dx, ddx, offset, distance)
        slope_x, xx = slope_x + slope, xx + bend
    for offset, distance in ((y - pairs.target_m, None), (-between, gap)):
        slope, bend = _length_terms(dy, ddy, offset, distance)
        slope_y, yy = slope_y + slope, yy + bend
    xy = -(dot(dx, dy) - dot(dx, between) * dot(dy, between) / gap**2) / gap
    both = curves.is_convex[pairs.first] & curves.is_convex[pairs.second]
    determinant = xx * yy - xy * xy
    usable = np.where(both, (determinant > 0) & (xx > 0), determinant != 0)
    scale = np.where(usable, determinant, 1.0)
    newton = np.column_stack([xy * slope_y - yy * slope_x, xy * slope_x - xx * slope_y]) / scale[:, None]
    bound = np.abs(xy) + 1e-12
    descent = np.column_stack([-slope_x / (np.abs(xx) + bound), -slope_y / (np.abs(yy) + bound)])
    speed = np.maximum(norm(dx), norm(dy))
    return np.where(usable[:, None], newton, descent), speed


def _length_terms(
    first: FloatArray, second: FloatArray, offset: FloatArray, distance: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """First and second derivative (n,) of |offset| along a curve with derivatives (n, xy)."""
    length = np.maximum(norm(offset), 1e-12) if distance is None else distance
    along = dot(first, offset) / length
    return along, dot(second, offset) / length + (dot(first, first) - along * along) / length


def _lit(curves: Curves, pairs: CurvePairs, u: FloatArray, valid: BoolArray) -> PlanPaths:
    ends = np.column_stack([curves.is_cyclic[pairs.first], curves.is_cyclic[pairs.second]])
    valid = valid & (ends | ((u >= -CURVE_OVERLAP) & (u <= 1 + CURVE_OVERLAP))).all(axis=1)
    pairs, u = pairs.take(valid), u[valid]
    x, dx, ddx = curves.at(pairs.first, u[:, 0])
    y, dy, ddy = curves.at(pairs.second, u[:, 1])
    normals = curves.normal(pairs.first, dx), curves.normal(pairs.second, dy)
    lit = norm(x - y) > SAME_POINT_M
    for normal, leg in (
        (normals[0], pairs.source_m - x), (normals[0], y - x),
        (normals[1], x - y), (normals[1], pairs.target_m - y),
    ):  # fmt: skip
        lit &= dot(normal, leg) > MIN_COS_INCIDENCE * norm(leg)
    curvature = curves.curvature(pairs.first, dx, ddx), curves.curvature(pairs.second, dy, ddy)
    surface = curves.surface[pairs.first], curves.surface[pairs.second]
    return PlanPaths(
        pairs.receiver[lit],
        np.stack(surface, axis=1)[lit],
        np.stack((x, y), axis=1)[lit],
        np.stack(normals, axis=1)[lit],
        np.stack(curvature, axis=1)[lit],
    )
