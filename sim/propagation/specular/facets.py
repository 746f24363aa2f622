"""Specular rays over the flat facets of user meshes: exact points for the chains of the ray tracer.

The tracer finds the triangles that a path reflects off. It works in single precision and its rays miss some
triangles. Here the points follow from the images of the TX in the planes of these triangles, and every
triangle is tested for a single bounce. Occlusion and gain come from the exact solver, so a box has the same paths
as a mesh and as a prism.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scenes.objects.clutter import Clutter
from scenes.record import BoolArray, FloatArray, IntArray, Record, array
from sim.propagation.paths import BounceKind
from sim.propagation.specular.rays import Rays

OUTSIDE_TRIANGLE_M = 1e-4  # the tracer selects between two coplanar triangles in single precision
OFF_FACE_M = 1e-5  # distance from a face of the point that tests on which side of it a path is
SAME_POINT_M = 1e-6  # reflections off the same objects at the same points are one path


@dataclass(frozen=True)
class TracedChains(Record):
    """Interactions of traced specular paths, TX to RX: reflections (SPECULAR), transmissions (REFRACTION)."""

    kind: IntArray = array("path", "bounce", dtype=int, doc="BounceKind; NONE if unused")
    surface: IntArray = array("path", "bounce", dtype=int, doc="index of the object; -1 if unused")
    corner_m: FloatArray = array("path", "bounce", "corner", "xyz", unit="m", doc="corners of the triangle")


def mesh_rays(
    found: TracedChains, tx_m: FloatArray, rx_m: FloatArray, clutter: Sequence[Clutter], first: int
) -> list[Rays]:
    """Rays from TX to RX (xyz,) that reflect off at least one mesh, one record per number of reflections.

    `first` is the index of the first mesh among all objects. Single bounces are tested on all triangles; longer
    chains are those in `found`. The result omits chains whose points miss their triangles by more than 0.1 mm,
    repeated chains, and reflections inside a closed mesh (prisms have none either).
    """
    reflects = found.kind == BounceKind.SPECULAR
    n_reflections = np.where((reflects & (found.surface >= first)).any(axis=1), reflects.sum(axis=1), 0)
    candidates = [_triangles(clutter, first)]
    for n in np.unique(n_reflections[n_reflections > 1]):
        chosen = n_reflections == n
        surface = found.surface[chosen][reflects[chosen]].reshape(-1, n)
        candidates.append((surface, found.corner_m[chosen][reflects[chosen]].reshape(-1, n, 3, 3)))
    result = []
    for surface, corner_m in candidates:
        rays = _distinct(_reflected(surface, corner_m, tx_m, rx_m))
        result.append(rays.take("ray", ~_is_within(rays, tx_m, clutter, first)))
    return result


def _triangles(clutter: Sequence[Clutter], first: int) -> tuple[IntArray, FloatArray]:
    """Objects (triangle, 1) and corners (triangle, 1, corner, xyz) of all triangles that have an area."""
    surface = [np.full((len(item.faces), 1), first + index) for index, item in enumerate(clutter)]
    corner_m = np.concatenate([item.vertices_m[item.faces] for item in clutter])
    across = np.cross(corner_m[:, 1] - corner_m[:, 0], corner_m[:, 2] - corner_m[:, 0])
    real = (across != 0).any(axis=1)
    return np.concatenate(surface)[real], corner_m[real][:, None]


def _reflected(surface: IntArray, corner_m: FloatArray, tx_m: FloatArray, rx_m: FloatArray) -> Rays:
    """Rays over triangles (ray, bounce, corner, xyz) by the image method, without rays that miss a triangle."""
    n_rays, n = surface.shape
    normal, anchor = _normals(corner_m), corner_m[:, :, 0]
    images = [np.broadcast_to(tx_m, (n_rays, 3))]
    for k in range(n):
        height = _dot(images[-1] - anchor[:, k], normal[:, k])
        images.append(images[-1] - 2 * height[:, None] * normal[:, k])
    target = np.broadcast_to(rx_m, (n_rays, 3))
    points: list[FloatArray] = []
    valid = np.ones(n_rays, bool)
    for k in reversed(range(n)):
        before, behind = (_dot(end - anchor[:, k], normal[:, k]) for end in (target, images[k + 1]))
        crossing = before * behind < 0
        share = before / np.where(crossing, before - behind, 1.0)
        target = target + share[:, None] * (images[k + 1] - target)
        points.insert(0, target)
        valid &= crossing
    vertex = np.stack(points, axis=1)
    valid &= (_off_triangle(vertex, corner_m, normal) < OUTSIDE_TRIANGLE_M).all(axis=1)
    rays = Rays(np.zeros(n_rays, int), np.ones(n_rays, complex), surface, vertex, normal)
    return rays.take("ray", valid)


def _distinct(rays: Rays) -> Rays:
    """The first one of all rays that reflect off the same objects at the same points."""
    place = np.round(rays.vertex_m / SAME_POINT_M).reshape(len(rays), 3 * rays.size("bounce"))
    _, first = np.unique(np.column_stack([rays.surface, place]), axis=0, return_index=True)
    return rays.take("ray", np.sort(first))


def _is_within(rays: Rays, tx_m: FloatArray, clutter: Sequence[Clutter], first: int) -> BoolArray:
    """Mask (ray,) of rays that reflect off the inner side of a closed mesh."""
    before = np.concatenate([np.broadcast_to(tx_m, (len(rays), 1, 3)), rays.vertex_m[:, :-1]], axis=1)
    back = before - rays.vertex_m
    probe = rays.vertex_m + OFF_FACE_M * back / np.linalg.norm(back, axis=2, keepdims=True)
    inner = np.zeros(rays.surface.shape, bool)
    for index, item in enumerate(clutter):
        here = rays.surface == first + index
        inner[here] = item.contains(probe[here])
    return np.asarray(inner.any(axis=1))


def _normals(corner_m: FloatArray) -> FloatArray:
    """Unit normals (..., xyz) of triangles (..., corner, xyz)."""
    across = np.cross(corner_m[..., 1, :] - corner_m[..., 0, :], corner_m[..., 2, :] - corner_m[..., 0, :])
    return np.asarray(across / np.linalg.norm(across, axis=-1, keepdims=True))


def _off_triangle(point_m: FloatArray, corner_m: FloatArray, normal: FloatArray) -> FloatArray:
    """Distance (...) of points (..., xyz), in the planes of triangles (..., corner, xyz), outside them."""
    outside = np.zeros(point_m.shape[:-1])
    for k in range(3):
        side = corner_m[..., (k + 1) % 3, :] - corner_m[..., k, :]
        inward = np.cross(normal, side) / np.linalg.norm(side, axis=-1, keepdims=True)
        outside = np.maximum(outside, -_dot(inward, point_m - corner_m[..., k, :]))
    return outside


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray((a * b).sum(axis=-1))
