"""From plan view to rays in space: heights, bounces off floor, ceiling and lids, and occlusion.

The height is linear in the unfolded horizontal length. So a plan path and a sequence of horizontal faces give at
most one ray. The order of its bounces follows from the positions at which it reaches each height.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from scenes.record import BoolArray, ComplexArray, FloatArray, IntArray, Record, array, concatenate
from sim.propagation.diffraction.fock import grazing_factor
from sim.propagation.occlusion import Crossings, Occluders, leg_crossings
from sim.propagation.specular.plan_view import PlanPaths, dot, norm
from sim.propagation.specular.surfaces import HorizontalFace, Surfaces

# Lower limit of |J| / L: a gain of at most 10 dB over flat surfaces. That is about the height of the Airy peak at
# a caustic at 60 GHz, for contours of a few metres.
CAUSTIC_LIMIT = 0.1


@dataclass(frozen=True)
class Rays(Record):
    """Specular rays with the same number of bounces each."""

    receiver: IntArray = array("ray", dtype=int, doc="index of the receiver")
    spreading: ComplexArray = array("ray", dtype=complex, doc="amplitude over that with flat surfaces")
    surface: IntArray = array("ray", "bounce", dtype=int, doc="index of the object, TX to RX")
    vertex_m: FloatArray = array("ray", "bounce", "xyz", unit="m", doc="points of reflection")
    normal: FloatArray = array("ray", "bounce", "xyz", doc="unit normal of the lit side")

    def __len__(self) -> int:
        return self.size("ray")


def spreading_factor(curvature: FloatArray, leg_m: FloatArray, cos_incidence: FloatArray) -> ComplexArray:
    """Amplitude (path,) after bounces off cylinders over that off planes, geometrical optics.

    sqrt(L / |J|), where J is the width of a ray tube of unit angle in plan view. At the TX, J = 0 and J' = 1.
    Along a leg s, J grows by s J'. At a bounce of curvature k (> 0 convex), J' grows by 2 k J / cos t. For one
    bounce this is 1 / sqrt|1 + 2 k s1 s2 / ((s1 + s2) cos t)|. Every change of sign of J is a caustic: the phase
    advances by 90 deg, and the gain is limited there. Axes: curvature and cosine (path, corner), horizontal legs
    (path, corner + 1).
    """
    width, growth = leg_m[:, 0], np.ones(len(leg_m))
    n_caustics = np.zeros(len(leg_m), int)
    for corner in range(curvature.shape[1]):
        growth = growth + 2 * curvature[:, corner] * width / cos_incidence[:, corner]
        following = width + leg_m[:, corner + 1] * growth
        n_caustics += (following < 0) != (width < 0)
        width = following
    total = leg_m.sum(axis=1)
    share = np.abs(width) / np.where(total > 0, total, 1.0)
    amplitude = np.where(total > 0, 1 / np.sqrt(np.maximum(share, CAUSTIC_LIMIT)), 1.0)
    return np.asarray(amplitude * np.array([1, 1j, -1, -1j])[n_caustics % 4])


def rays_from_plan_paths(
    plan: PlanPaths, known: Surfaces, tx_m: FloatArray, rx_m: FloatArray, max_levels: int, wavenumber: float
) -> Iterator[Rays]:
    """Rays over the plan paths with up to `max_levels` bounces off horizontal faces, one record per sequence.

    The spreading holds the divergence of curved walls and, near grazing, the uniform correction of
    `sim.propagation.diffraction.fock`.
    """
    ends = (np.broadcast_to(tx_m, (len(plan), 3)), rx_m[plan.receiver])
    corners = np.concatenate([ends[0][:, None, :2], plan.point_m, ends[1][:, None, :2]], axis=1)
    step = np.diff(corners, axis=1)
    leg = norm(step)
    cosine = np.abs(dot(plan.normal, step[:, :-1])) / np.where(leg[:, :-1] > 0, leg[:, :-1], 1.0)
    reached = np.concatenate([np.zeros((len(plan), 1)), np.cumsum(leg, axis=1)], axis=1)
    gain = spreading_factor(plan.curvature, leg, cosine) * _grazing(plan.curvature, reached, cosine, wavenumber)
    lines = _Unfolded(gain, corners, reached, ends[0][:, 2], ends[1][:, 2])
    for n_levels in range(max_levels + 1):
        for sequence in product(known.horizontal_faces, repeat=n_levels):
            if all(a.facing != b.facing and (a.z_m - b.z_m) * b.facing > 0 for a, b in pairwise(sequence)):
                lit = _starts_and_ends_lit(lines, sequence)
                if lit.any() or not n_levels:
                    yield _over_levels(plan.take("path", lit), lines.take("path", lit), sequence, known)


def _grazing(curvature: FloatArray, reached_m: FloatArray, cosine: FloatArray, wavenumber: float) -> ComplexArray:
    """Product (path,) of the grazing corrections of all bounces off convex walls, from unfolded lengths."""
    factor = np.ones(curvature.shape, complex)
    path, corner = np.nonzero((curvature > 0) & (cosine > 0))
    before = reached_m[path, corner + 1]
    after = reached_m[path, -1] - before
    radius = 1 / curvature[path, corner]
    factor[path, corner] = grazing_factor(wavenumber, radius, before, after, cosine[path, corner], "soft")
    return np.asarray(factor.prod(axis=1))


@dataclass(frozen=True)
class _Unfolded(Record):
    """Plan paths with their end points, and the horizontal length up to each point."""

    spreading: ComplexArray = array("path", dtype=complex)
    corner_m: FloatArray = array("path", "point", "xy", unit="m")
    reached_m: FloatArray = array("path", "point", unit="m")
    tx_z_m: FloatArray = array("path", unit="m")
    rx_z_m: FloatArray = array("path", unit="m")


def _over_levels(plan: PlanPaths, lines: _Unfolded, sequence: tuple[HorizontalFace, ...], known: Surfaces) -> Rays:
    """Rays off one sequence of horizontal faces; both ends lie on the lit sides."""
    levels_z = np.array([level.z_m for level in sequence])
    heights = np.column_stack([lines.tx_z_m, np.tile(levels_z, (len(plan), 1)), lines.rx_z_m])
    climbed = np.zeros(heights.shape)
    climbed[:, 1:] = np.cumsum(np.abs(np.diff(heights, axis=1)), axis=1)
    at_corner, at_level = _share(lines.reached_m)[:, 1:-1], _share(climbed)[:, 1:-1]
    if sequence:
        z = _interpolated(at_corner * climbed[:, -1:], climbed, heights[..., None])[..., 0]
    else:
        z = heights[:, :1] + at_corner * (heights[:, 1:] - heights[:, :1])
    xy = _interpolated(at_level * lines.reached_m[:, -1:], lines.reached_m, lines.corner_m)
    valid = _on_surfaces(plan.surface, z, known.z_range_m)
    for place, level in enumerate(sequence):
        valid &= level.holds(xy[:, place])
    return _merged(plan, lines, sequence, (at_corner, z), (at_level, xy), heights).take("ray", valid)


def _starts_and_ends_lit(lines: _Unfolded, sequence: tuple[HorizontalFace, ...]) -> BoolArray:
    """Whether TX and RX lie on the lit sides of the first and the last horizontal face (path,)."""
    if not sequence:
        return np.ones(len(lines.tx_z_m), bool)
    first, last = sequence[0], sequence[-1]
    return np.asarray(
        ((lines.tx_z_m - first.z_m) * first.facing > 0) & ((lines.rx_z_m - last.z_m) * last.facing > 0)
    )


def _merged(
    plan: PlanPaths,
    lines: _Unfolded,
    sequence: tuple[HorizontalFace, ...],
    corner: tuple[FloatArray, FloatArray],
    level: tuple[FloatArray, FloatArray],
    heights: FloatArray,
) -> Rays:
    """Bounces off walls and off horizontal faces, sorted by their share of the path length."""
    (at_corner, z), (at_level, xy) = corner, level
    n, n_levels = at_level.shape
    surface = np.tile(np.array([one.surface for one in sequence], int), (n, 1))
    upright = np.zeros((n, n_levels, 3))
    upright[..., 2] = [one.facing for one in sequence]
    on_wall = np.concatenate([plan.point_m, z[..., None]], axis=2)
    on_level = np.concatenate([xy, heights[:, 1:-1, None]], axis=2)
    normal = np.concatenate([plan.normal, np.zeros((*plan.surface.shape, 1))], axis=2)
    order = np.argsort(np.concatenate([at_corner, at_level], axis=1), axis=1, kind="stable")
    return Rays(
        plan.receiver,
        lines.spreading,
        np.take_along_axis(np.concatenate([plan.surface, surface], axis=1), order, 1),
        np.take_along_axis(np.concatenate([on_wall, on_level], axis=1), order[..., None], 1),
        np.take_along_axis(np.concatenate([normal, upright], axis=1), order[..., None], 1),
    )


def _share(reached: FloatArray) -> FloatArray:
    total = reached[:, -1:]
    return reached / np.where(total > 0, total, 1.0)


def _interpolated(position: FloatArray, knot: FloatArray, value: FloatArray) -> FloatArray:
    """Piecewise linear values (path, position, n) between knots (path, knot) with values (path, knot, n)."""
    before = (position[:, :, None] >= knot[:, None, 1:-1]).sum(axis=2)
    low, high = (np.take_along_axis(knot, before + k, 1) for k in (0, 1))
    share = (position - low) / np.where(high > low, high - low, 1.0)
    start, end = (np.take_along_axis(value, (before + k)[..., None], 1) for k in (0, 1))
    return np.asarray(start + share[..., None] * (end - start))


def _on_surfaces(surface: IntArray, z_m: FloatArray, z_range_m: FloatArray) -> BoolArray:
    if not surface.shape[1]:
        return np.ones(len(surface), bool)
    rims = z_range_m[surface]
    return np.asarray(((z_m >= rims[..., 0]) & (z_m <= rims[..., 1])).all(axis=1))


def ray_points(rays: Rays, tx_m: FloatArray, rx_m: FloatArray) -> FloatArray:
    """TX, bounces, RX (ray, bounce + 2, xyz) of all rays."""
    ends = np.broadcast_to(tx_m, (len(rays), 1, 3)), rx_m[rays.receiver][:, None]
    return np.concatenate([ends[0], rays.vertex_m, ends[1]], axis=1)


def unobstructed_rays(
    rays: Rays, points_m: FloatArray, faces: Occluders, opaque: BoolArray, max_crossed: int
) -> tuple[IntArray, Crossings]:
    """Rays (kept,) that cross at most `max_crossed` faces, none of them opaque (object,), and these crossings.

    The leg index of a crossing is: index of the ray x number of legs per ray + leg.
    """
    n_legs = points_m.shape[1] - 1
    alive = np.arange(len(rays))
    n_crossed = np.zeros(len(rays), int)
    parts = [leg_crossings(faces, np.zeros((0, 3)), np.zeros((0, 3)))]
    for leg in range(n_legs):
        found = leg_crossings(faces, points_m[alive, leg], points_m[alive, leg + 1])
        ray = alive[found.leg]
        np.add.at(n_crossed, ray, 1 + max_crossed * opaque[found.surface])
        parts.append(Crossings(ray * n_legs + leg, found.share, found.surface, found.normal))
        alive = alive[n_crossed[alive] <= max_crossed]
    met = concatenate(parts, "crossing")
    return alive, met.take("crossing", n_crossed[met.leg // n_legs] <= max_crossed)
