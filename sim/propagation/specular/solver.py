"""The exact specular solver: line of sight, reflections off flat and curved walls, paths through thin walls.

The solver finds paths in plan view (images for flat faces, stationary points for curves), computes their heights
and removes the blocked ones.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import ComplexArray, FloatArray, IntArray, concatenate
from scenes.scene import Scene
from sim.config import PropagationConfig
from sim.propagation.occlusion import Occluders, occluders, surface_names
from sim.propagation.paths import Paths, canonical_order, empty_paths
from sim.propagation.specular.curved import curved_paths, curved_planar_paths, planar_curved_paths
from sim.propagation.specular.curved_pairs import curved_curved_paths, facing_pairs
from sim.propagation.specular.fresnel import horizontal_polarisation, vertical_polarisation
from sim.propagation.specular.images import face_chains, planar_paths
from sim.propagation.specular.path_gain import Polarisation, paths_of_rays, ray_interactions, scene_slabs
from sim.propagation.specular.plan_view import PlanPaths, straight_paths, without_duplicates
from sim.propagation.specular.rays import Rays, ray_points, rays_from_plan_paths, unobstructed_rays
from sim.propagation.specular.surfaces import reflecting_surfaces

MAX_CURVED_BOUNCES = 2  # bounces of a path that meets a curved wall
CHUNK = 16  # receivers solved at once


class ExactSolver:
    """A scene prepared for the exact solver: tables of its surfaces and of the images of its TX."""

    def __init__(
        self,
        scene: Scene,
        carrier_hz: float,
        config: PropagationConfig | None = None,
        faces: Occluders | None = None,
    ) -> None:
        self._config = config or PropagationConfig()
        self._tx = np.asarray(scene.tx.position_m, float)
        self._wavenumber = 2 * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S
        self._names = surface_names(scene)
        self.faces = occluders(scene) if faces is None else faces
        self.n_bounce_slots = self._config.n_bounce_slots
        self._known = reflecting_surfaces(scene)
        self._slabs = scene_slabs(scene, carrier_hz)
        self._receives: Polarisation = vertical_polarisation
        self._opaque = self._slabs.opaque(self._config.max_transmission_loss_db)
        if not self._config.transmission:
            self._opaque = np.ones_like(self._opaque)
        self._find_chains()

    def from_place(self, tx_m: FloatArray) -> ExactSolver:
        """The same scene with the TX in another place (xyz,)."""
        other = copy.copy(self)
        other._tx = np.asarray(tx_m, float)
        other._find_chains()
        return other

    def polarised(self, rx_positions_m: FloatArray) -> list[tuple[Paths, ComplexArray]]:
        """Paths to every receiver (receiver, xyz), with gains (path, 2) at vertical and horizontal elements."""
        across = copy.copy(self)
        across._receives = horizontal_polarisation
        pairs = zip(self.paths(rx_positions_m), across.paths(rx_positions_m), strict=True)
        return [(paths, np.stack([paths.gain, other.gain], axis=1)) for paths, other in pairs]

    def restricted(self, objects: IntArray) -> ExactSolver:
        """The same scene where only these objects, floor and ceiling among them, reflect."""
        fewer, known = copy.copy(self), self._known
        fewer._known = replace(
            known,
            faces=known.faces.take("face", np.isin(known.faces.surface, objects)),
            curves=known.curves.take("curve", np.isin(known.curves.surface, objects)),
            horizontal_faces=tuple(face for face in known.horizontal_faces if face.surface in objects),
        )
        fewer._find_chains()
        return fewer

    def _find_chains(self) -> None:
        """Chains of faces and pairs of curves, the same for all receivers."""
        faces, curves, tx = self._known.faces, self._known.curves, self._tx[:2]
        self._chains = face_chains(faces, tx, self._config.max_bounces)
        self._pairs = facing_pairs(curves, tx) if self._config.max_bounces > 1 else None

    def paths(self, rx_positions_m: FloatArray, chunk: int = CHUNK) -> list[Paths]:
        """All specular paths to receivers (receiver, xyz), one record each in canonical order.

        The solver processes `chunk` receivers at a time to limit the memory. The result does not depend on it.
        """
        rx = np.atleast_2d(np.asarray(rx_positions_m, float))
        solved: list[Paths] = []
        for first in range(0, len(rx), chunk):
            solved += self._solve(rx[first : first + chunk])
        return solved

    def _solve(self, rx: FloatArray) -> list[Paths]:
        limit = self._config.max_bounces
        rays: dict[int, list[Rays]] = {}
        for plan, max_levels in self._plan_paths(rx):
            for found in rays_from_plan_paths(plan, self._known, self._tx, rx, max_levels, self._wavenumber):
                rays.setdefault(found.size("bounce"), []).append(found)
        slots = self._config.n_bounce_slots
        parts, owners = [empty_paths(self._names, slots)], [np.zeros(0, int)]
        for n in range(limit + 1):
            paths, receiver = self.finished(concatenate(rays[n], "ray"), rx)
            parts.append(paths)
            owners.append(receiver)
        joined, owner = concatenate(parts, "path"), np.concatenate(owners)
        return [canonical_order(joined.take("path", owner == index)) for index in range(len(rx))]

    def _plan_paths(self, rx: FloatArray) -> Iterator[tuple[PlanPaths, int]]:
        """Plan paths of every kind, and their maximum number of extra bounces off floor, ceiling and lids."""
        limit = self._config.max_bounces
        tx_xy, rx_xy = self._tx[:2], rx[:, :2]
        faces, curves = self._known.faces, self._known.curves
        yield straight_paths(len(rx)), limit
        for n, chain in enumerate(self._chains, start=1):
            yield without_duplicates(planar_paths(faces, chain, rx_xy)), limit - n
        limit = min(limit, MAX_CURVED_BOUNCES)
        if limit >= 1 and len(curves):
            yield without_duplicates(curved_paths(curves, tx_xy, rx_xy)), limit - 1
        if self._pairs is not None and len(curves):
            yield without_duplicates(planar_curved_paths(faces, curves, self._chains[0], tx_xy, rx_xy)), 0
            yield without_duplicates(curved_planar_paths(faces, curves, tx_xy, rx_xy)), 0
            yield without_duplicates(curved_curved_paths(curves, self._pairs, tx_xy, rx_xy)), 0

    def finished(self, rays: Rays, rx: FloatArray) -> tuple[Paths, IntArray]:
        """Unobstructed rays to receivers (receiver, xyz) with their gains, and the receiver (path,) of each."""
        config = self._config
        points = ray_points(rays, self._tx, rx)
        n_crossed = config.max_crossed_faces if config.transmission else 0
        kept, met = unobstructed_rays(rays, points, self.faces, self._opaque, n_crossed)
        renumbered = np.full(len(rays), -1)
        renumbered[kept] = np.arange(len(kept))
        n_legs = points.shape[1] - 1
        met = replace(met, leg=renumbered[met.leg // n_legs] * n_legs + met.leg % n_legs)
        rays, points = rays.take("ray", kept), points[kept]
        happening = ray_interactions(rays, points, met, config.n_bounce_slots)
        paths, strong = paths_of_rays(
            rays, points, happening, self._slabs, self._names, config.max_transmission_loss_db, self._receives
        )
        return paths.take("path", strong), rays.receiver[strong]


def exact_paths(
    scene: Scene, rx_positions_m: FloatArray, carrier_hz: float, config: PropagationConfig | None = None
) -> list[Paths]:
    """All specular paths to receivers (receiver, xyz), one record each; see `ExactSolver.paths`."""
    return ExactSolver(scene, carrier_hz, config).paths(rx_positions_m)
