"""Exact rates of a path: of its length, of its departure and arrival, and the second derivative of its length.

The points x_i of a path slide over their surfaces, x_i(u_i, t), which move rigidly. The length L(u, t) is
stationary in u (Fermat). So dL/dt is its partial derivative at fixed u. The points follow from the implicit
function theorem: L_uu du/dt = -L_ut, and then d2L/dt2 = L_tt + L_tu du/dt. No finite differences are taken.

A creeping wave is a taut string around its body. In the frame of the body its points of contact slide along the
rays themselves and turn neither of them, so the rates follow from the two straight parts alone.
"""

from dataclasses import replace

import numpy as np

from scenes.contours import Circle
from scenes.motion.motion import BodyMotion, quarter_turn
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import BoolArray, FloatArray, concatenate
from scenes.scene import Scene
from sim.propagation.diffraction.convex import ConvexContour
from sim.propagation.diffraction.creeping import CreepingRays, creeping_rays
from sim.propagation.diffraction.edges import Edges
from sim.propagation.diffraction.mesh_edges import MeshEdges
from sim.propagation.motion.bounces import Bounces, bounce_geometry
from sim.propagation.paths import BounceKind, PathRates, Paths

ON_EDGE_M = 1e-6
LEAST_LENGTH_M = 1e-12


def path_rates(
    paths: Paths,
    bodies: BodyMotion,
    scene: Scene,
    edges: Edges | None,
    rings: dict[int, ConvexContour | Circle],
    edges_of_meshes: MeshEdges | None,
    carrier_hz: float,
) -> PathRates:
    """Rates of all paths of a scene at one instant; `bodies` are its surfaces as paths count them, TX and RX."""
    ends = bodies.pivot_m[-2], bodies.pivot_m[-1]
    creeps = _creeps(paths, edges, rings)
    parts, order = [_none()], [np.zeros(0, int)]
    for n in np.unique(paths.n_bounces[~creeps]):
        rows = np.flatnonzero((paths.n_bounces == n) & ~creeps)
        bounces = bounce_geometry(paths.take("path", rows), int(n), ends, scene, edges_of_meshes)
        parts.append(_stationary_rates(bounces, bodies))
        order.append(rows)
    for index in np.unique(paths.bounce_object[creeps, 0]):
        rows = np.flatnonzero(creeps & (paths.bounce_object[:, 0] == index))
        rays = _creeping_again(paths.vertex_m[rows, 0], rings[int(index)], ends)
        parts.append(_creeping_rates(rays, int(index), bodies))
        order.append(rows)
    found = concatenate(parts, "path").take("path", np.argsort(np.concatenate(order), kind="stable"))
    return replace(found, doppler_hz=-carrier_hz / SPEED_OF_LIGHT_M_S * found.length_rate_m_s)


def _none() -> PathRates:
    return PathRates(*(np.zeros(0) for _ in range(7)))


def _creeps(paths: Paths, edges: Edges | None, rings: dict[int, ConvexContour | Circle]) -> BoolArray:
    """Mask (path,) of the paths that creep around a contour; the others bend at edges."""
    creeps = (paths.bounce_kind[:, 0] == BounceKind.DIFFRACTION) & np.isin(paths.bounce_object[:, 0], list(rings))
    if edges is not None and len(edges.position_m):
        for row in np.flatnonzero(creeps):
            apart = np.linalg.norm(edges.position_m - paths.vertex_m[row, 0, :2], axis=1)
            creeps[row] = apart.min() > ON_EDGE_M
    return np.asarray(creeps)


def _stationary_rates(bounces: Bounces, bodies: BodyMotion) -> PathRates:
    """Rates of paths with the same number of interactions. Parameters: two slides for each, then the time."""
    n_paths, n = bounces.body.shape
    tx, rx = len(bodies.pivot_m) - 2, len(bodies.pivot_m) - 1
    body = np.column_stack([np.full(n_paths, tx), bounces.body, np.full(n_paths, rx)])
    first_end, last_end = (np.broadcast_to(bodies.pivot_m[end], (n_paths, 1, 3)) for end in (tx, rx))
    point = np.concatenate([first_end, bounces.point_m, last_end], axis=1)
    time = 2 * n
    moved = np.zeros((n_paths, n + 2, 2 * n + 1, 3))  # first derivatives of every point
    moved[:, :, time] = bodies.velocity_at(body, point)
    for k in range(n):
        moved[:, k + 1, 2 * k : 2 * k + 2] = bounces.tangent[:, k]
    leg = np.diff(point, axis=1)
    length = np.maximum(np.linalg.norm(leg, axis=2), LEAST_LENGTH_M)
    along = leg / length[..., None]
    stretch = np.diff(moved, axis=1)
    on_leg = (stretch * along[:, :, None]).sum(axis=3)
    across = (stretch - on_leg[..., None] * along[:, :, None]) / np.sqrt(length)[..., None, None]
    curved = np.einsum("pljx,plkx->pjk", across, across)
    pull = np.zeros(point.shape)  # dL / dx of every point
    pull[:, 1:] += along
    pull[:, :-1] -= along
    curved[:, time, time] += (pull * bodies.acceleration_at(body, point)).sum(axis=(1, 2))
    for k in range(n):
        spin = bodies.turn_rate_rad_s[bounces.body[:, k], None, None] * quarter_turn(bounces.tangent[:, k])
        mixed = (pull[:, k + 1, None] * spin).sum(axis=2)
        curved[:, 2 * k : 2 * k + 2, time] += mixed
        curved[:, time, 2 * k : 2 * k + 2] += mixed
        curved[:, 2 * k, 2 * k] += (pull[:, k + 1] * bounces.bend[:, k]).sum(axis=1)
    slide = _slides(curved, bounces.tangent.any(axis=3).reshape(n_paths, 2 * n))
    velocity = moved[:, :, time] + (moved[:, :, :time] * slide[:, None, :, None]).sum(axis=2)
    acceleration = curved[:, time, time] + (curved[:, time, :time] * slide).sum(axis=1)
    rate = on_leg[:, :, time].sum(axis=1)
    return PathRates(
        0 * rate,  # Doppler follows in `path_rates`
        rate,
        acceleration,
        *_angle_rates(leg[:, 0], velocity[:, 1] - velocity[:, 0]),
        *_angle_rates(-leg[:, -1], velocity[:, -2] - velocity[:, -1]),
    )


def _slides(curved: FloatArray, is_free: BoolArray) -> FloatArray:
    """du/dt (path, slide) = -L_uu^-1 L_ut, zero for slides that are not free."""
    free = is_free[:, :, None] & is_free[:, None, :]
    inner = np.where(free, curved[:, :-1, :-1], np.eye(curved.shape[1] - 1))
    right = np.where(is_free, curved[:, :-1, -1], 0.0)
    return np.asarray(-np.linalg.solve(inner, right[..., None])[..., 0])


def _angle_rates(vector: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rates (path,) in rad/s of azimuth and elevation of vectors (path, xyz) that change with (path, xyz)."""
    (x, y, z), (dx, dy, dz) = vector.T, velocity.T
    level = np.maximum(np.hypot(x, y), LEAST_LENGTH_M)
    rise = (level * dz - z * (x * dx + y * dy) / level) / (level**2 + z**2)
    return (x * dy - y * dx) / level**2, rise


def _creeping_again(
    middle_m: FloatArray, ring: ConvexContour | Circle, ends_m: tuple[FloatArray, FloatArray]
) -> CreepingRays:
    """The rays around a contour whose arcs have their middle at points (path, xyz)."""
    both = concatenate([creeping_rays(ring, ends_m[0], ends_m[1][None], sense) for sense in (1, -1)], "ray")
    apart = np.linalg.norm(both.middle_m[None] - middle_m[:, None], axis=2)
    return both.take("ray", apart.argmin(axis=1))


def _creeping_rates(rays: CreepingRays, ring: int, bodies: BodyMotion) -> PathRates:
    """Rates of rays around one body, from the velocities of both ends relative to the body."""
    body, spin = np.array(ring), bodies.turn_rate_rad_s[ring]
    ends, rates, bends = [], [], []
    for end in (-2, -1):
        point = bodies.pivot_m[end]
        velocity = bodies.velocity_m_s[end] - bodies.velocity_at(body, point)
        relative = (
            bodies.acceleration_m_s2[end] - bodies.acceleration_at(body, point) - 2 * spin * quarter_turn(velocity)
        )
        ends.append(point)
        rates.append(velocity)
        bends.append(relative)
    out, back = rays.attach_m - ends[0], ends[1] - rays.shed_m
    directions, turned = [], []
    level_rate, level_bend = np.zeros(len(rays.arc_m)), np.zeros(len(rays.arc_m))
    for leg, rate, bend, sign in zip((out, back), rates, bends, (-1, 1), strict=True):
        size = np.hypot(leg[:, 0], leg[:, 1])
        unit = leg[:, :2] / size[:, None]
        aside = unit[:, 0] * rate[1] - unit[:, 1] * rate[0]
        level_rate += sign * (unit @ rate[:2])
        level_bend += sign * (unit @ bend[:2]) + aside**2 / size
        directions.append(unit)
        turned.append(sign * aside / size + spin)
    level = rays.s1_m + rays.arc_m + rays.s2_m
    rise = ends[1][2] - ends[0][2]
    rise_rate = bodies.velocity_m_s[-1, 2] - bodies.velocity_m_s[-2, 2]
    rise_bend = bodies.acceleration_m_s2[-1, 2] - bodies.acceleration_m_s2[-2, 2]
    length = np.hypot(level, rise)
    rate = (level * level_rate + rise * rise_rate) / length
    bend = (level_rate**2 + level * level_bend + rise_rate**2 + rise * rise_bend - rate**2) / length
    tilt = (level * rise_rate - rise * level_rate) / length**2
    return PathRates(0 * rate, rate, bend, turned[0], tilt, turned[1], -tilt)
