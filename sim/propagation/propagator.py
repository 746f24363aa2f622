"""All propagation paths of a scene in canonical order: specular, diffracted, over meshes and targets, diffuse."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np

from scenes.contours.pieces import LinePiece, Piece
from scenes.motion.motion import BodyMotion
from scenes.record import BoolArray, FloatArray, IntArray, concatenate
from scenes.scene import Scene
from sim.config import PropagationConfig
from sim.propagation.diffraction.creeping import convex_contours, creeping_paths
from sim.propagation.diffraction.edge_paths import diffracted_paths
from sim.propagation.diffraction.edges import find_edges
from sim.propagation.diffraction.mesh_edges import diffracted_by_meshes, mesh_edges
from sim.propagation.motion.bounces import bounce_pieces
from sim.propagation.motion.rates import path_rates
from sim.propagation.occlusion import occluders, surface_names
from sim.propagation.paths import BounceKind, Paths, canonical_order, with_bounce_slots
from sim.propagation.specular.facets import TracedChains, mesh_rays
from sim.propagation.specular.solver import ExactSolver
from sim.propagation.targets.paths import SLOTS, TargetSolver
from sim.propagation.tracer import Tracer

SAME_VERTEX_M = 5e-3  # the tracer computes its vertices in single precision
ON_FACE_M = 1e-6


@dataclass(frozen=True)
class PlanarComparison:
    """Number of planar specular paths found by both solvers, by the exact one only, by the tracer only."""

    n_common: int
    n_repaired: int
    n_extra: int


class Propagator:
    """A scene prepared for propagation; `paths` then computes one receiver position at a time.

    If a material scatters or the scene has meshes, the tracer is imported and the scene is loaded, which takes
    seconds. In this case it raises `sim.propagation.llvm.LlvmError` if there is no usable LLVM library.
    """

    def __init__(
        self, scene: Scene, carrier_hz: float, config: PropagationConfig | None = None, *, traces: bool = True
    ) -> None:
        self._config = config or PropagationConfig()
        self._scene, self._carrier_hz = scene, carrier_hz
        self._faces = occluders(scene)
        self._exact = ExactSolver(scene, carrier_hz, self._config, self._faces)
        self._edges = find_edges(scene) if self._diffracts else None
        self._rings = convex_contours(scene) if self._diffracts else {}
        needs_tracer = _needs_tracer(scene, self._config)
        self._tracer = Tracer(scene, carrier_hz, self._config) if traces and needs_tracer else None
        self._targets = TargetSolver(scene, carrier_hz, self._config) if self._reaches_targets else None
        self._meshes = None
        if needs_tracer and scene.clutter:
            self._meshes = MeshSolver(scene, carrier_hz, self._diffracts, self._exact)

    def paths(self, rx_position_m: FloatArray) -> Paths:
        """All paths from the scene's TX to a receiver (xyz,), in canonical order.

        Line of sight, specular reflections off flat and curved surfaces up to `max_bounces` (two if one surface is
        curved) and first-order diffuse scattering; with `transmission` also paths through faces, with
        `diffraction` paths around one edge or pillar. The tracer finds the reflections off user meshes, the exact
        solver all other specular paths. The result has the same bits on every run and in any order of calls.
        """
        rx = np.asarray(rx_position_m, float)
        return self._paths(rx, self._exact.paths(rx), None)

    def compared_paths(self, rx_position_m: FloatArray) -> tuple[Paths, PlanarComparison]:
        """The same paths, and the comparison of the planar paths of the tracer with the exact ones.

        All counts are zero if the scene needs no tracer, or without `compare_planar`.
        """
        if self._tracer is None or not self._config.compare_planar:
            return self.paths(rx_position_m), PlanarComparison(0, 0, 0)
        rx = np.asarray(rx_position_m, float)
        traced, chains = self._tracer.specular_chains(rx)
        exact = self._exact.paths(rx)
        return self._paths(rx, exact, chains), compare_planar(self._scene, traced, exact[0])

    def _paths(self, rx: FloatArray, exact: list[Paths], chains: TracedChains | None) -> Paths:
        """All paths to a receiver (xyz,); `chains` are the result of the tracer if it has already run."""
        if chains is None:
            chains = self.mesh_chains(rx)
        parts = self._exact_parts(rx, exact, chains)
        if self._tracer is not None:
            parts.append(with_bounce_slots(self._tracer.diffuse(rx), parts[0].bounce_kind.shape[1]))
        return canonical_order(concatenate(parts, "path"))

    def mesh_chains(self, rx_position_m: FloatArray) -> TracedChains | None:
        """Chains of triangles that reflect to a receiver (xyz,), found by the tracer; None without meshes."""
        if self._meshes is None or self._tracer is None:
            return None
        return self._tracer.specular_chains(rx_position_m)[1]

    def exact_paths(self, rx_position_m: FloatArray, chains: TracedChains | None = None) -> Paths:
        """All paths but the diffuse ones to a receiver (xyz,); `chains` are those of meshes."""
        rx = np.asarray(rx_position_m, float)
        return canonical_order(concatenate(self._exact_parts(rx, self._exact.paths(rx), chains), "path"))

    def drawn(self, rng: np.random.Generator) -> Propagator:
        """The same scene, its targets with the random numbers of a stop; without them they have mean values."""
        if self._targets is None:
            return self
        drawn = copy.copy(self)
        drawn._targets = self._targets.drawn(rng)
        return drawn

    def with_rates(self, paths: Paths, bodies: BodyMotion) -> Paths:
        """Paths of this scene with their rates; `bodies` are its surfaces as paths count them, TX and receiver."""
        meshes = None if self._meshes is None else self._meshes.edges
        args = self._scene, self._edges, self._rings, meshes, self._carrier_hz
        return replace(paths, rates=path_rates(paths, bodies, *args))

    def bounce_pieces(self, paths: Paths) -> IntArray:
        """Smooth pieces (path, bounce) of the contours of this scene that paths meet."""
        return bounce_pieces(paths, self._scene)

    def restricted(self, objects: IntArray) -> Propagator:
        """The same scene where only these objects reflect and diffract; all of them still block."""
        fewer = copy.copy(self)
        fewer._exact = self._exact.restricted(objects)
        if self._edges is not None:
            fewer._edges = self._edges.take("edge", np.isin(self._edges.object, objects))
        fewer._targets = None if self._targets is None else self._targets.restricted(objects)
        fewer._rings = {index: ring for index, ring in self._rings.items() if index in objects}
        return fewer

    def _exact_parts(self, rx: FloatArray, exact: list[Paths], chains: TracedChains | None) -> list[Paths]:
        parts = list(exact)
        if self._edges is not None:
            bent = diffracted_paths(self._scene, rx, self._carrier_hz, self._faces, self._edges)
            bent += creeping_paths(self._scene, rx, self._carrier_hz, self._faces, self._rings)
            parts += [with_bounce_slots(paths, self._config.n_bounce_slots) for paths in bent]
        if self._meshes is not None and chains is not None:
            parts += self._meshes.paths(rx, chains)
        if self._targets is not None:
            n_slots = max(self._config.n_bounce_slots, SLOTS)
            parts = [with_bounce_slots(paths, n_slots) for paths in (*parts, *self._targets.paths(rx))]
        return parts

    @property
    def _reaches_targets(self) -> bool:
        return self._scene.has_targets and self._config.max_bounces > 0

    @property
    def _diffracts(self) -> bool:
        return self._config.diffraction and self._config.max_bounces > 0


class MeshSolver:
    """Paths over the meshes of a scene: the tracer finds the reflecting triangles, points and gains are exact."""

    def __init__(self, scene: Scene, carrier_hz: float, diffracts: bool, exact: ExactSolver) -> None:
        self._carrier_hz, self._exact = carrier_hz, exact
        self._tx = np.asarray(scene.tx.position_m, float)
        self._clutter, self._names = scene.clutter, surface_names(scene)
        self.edges = mesh_edges(scene.clutter) if diffracts else None

    def paths(self, rx_m: FloatArray, chains: TracedChains) -> list[Paths]:
        """Paths to a receiver (xyz,) that reflect off or are diffracted at one or more meshes, in no order."""
        first = len(self._names) - len(self._clutter)
        rays = mesh_rays(chains, self._tx, rx_m, self._clutter, first)
        parts = [self._exact.finished(one, rx_m[None])[0] for one in rays]
        if self.edges is not None:
            materials = [item.material for item in self._clutter]
            parts.append(
                diffracted_by_meshes(
                    self.edges, (self._tx, rx_m), materials, self._exact.faces, self._carrier_hz, self._names,
                    self._exact.n_bounce_slots,
                )
            )  # fmt: skip
        return parts


def propagate(
    scene: Scene, rx_positions_m: FloatArray, *, carrier_hz: float, config: PropagationConfig | None = None
) -> list[Paths]:
    """Paths to each receiver position (receiver, xyz), one record each; see `Propagator.paths`."""
    propagator = Propagator(scene, carrier_hz, config)
    return [propagator.paths(position) for position in np.atleast_2d(rx_positions_m)]


def compare_planar(scene: Scene, traced: Paths, exact: Paths) -> PlanarComparison:
    """Count the exact paths that the tracer missed (repaired), and the paths that only the tracer found (extra).

    Only paths without curved bounce, transmission or mesh count. Two paths are the same if kinds and objects agree
    and all vertices lie within 5 mm.
    """
    ours = exact.take("path", _is_planar(scene, exact))
    theirs = traced.take("path", _is_planar(scene, traced))
    left = list(range(len(theirs)))
    for index in range(len(ours)):
        match = next((other for other in left if _same(ours, index, theirs, other)), None)
        if match is not None:
            left.remove(match)
    n_common = len(theirs) - len(left)
    return PlanarComparison(n_common, len(ours) - n_common, len(left))


def _is_planar(scene: Scene, paths: Paths) -> BoolArray:
    """Mask (path,) of paths with only specular bounces off flat faces of prisms, floor or ceiling."""
    planar = np.isin(paths.bounce_kind, (BounceKind.NONE, BounceKind.SPECULAR)).all(axis=1)
    planar &= (paths.bounce_object < len(paths.object_name) - len(scene.clutter)).all(axis=1)
    for index, item in enumerate(scene.objects):
        if any(piece.is_curved for piece in item.contour.pieces):
            z = paths.vertex_m[..., 2]
            on_lid = np.minimum(np.abs(z - item.z_min_m), np.abs(z - item.z_max_m)) < SAME_VERTEX_M
            flat = on_lid | _on_lines(paths.vertex_m[..., :2], item.contour.pieces)
            planar &= ~((paths.bounce_object == index) & ~flat).any(axis=1)
    return np.asarray(planar)


def _on_lines(xy_m: FloatArray, pieces: tuple[Piece, ...]) -> BoolArray:
    """Whether points (..., xy) lie on a straight piece, within its ends."""
    found = np.zeros(xy_m.shape[:-1], bool)
    for piece in pieces:
        if isinstance(piece, LinePiece):
            along = piece.end_m - piece.start_m
            offset = xy_m - piece.start_m
            share = (offset @ along) / (along @ along)
            aside = np.abs(offset[..., 0] * along[1] - offset[..., 1] * along[0]) / piece.length
            found |= (share >= 0) & (share <= 1) & (aside < ON_FACE_M)
    return found


def _same(ours: Paths, index: int, theirs: Paths, other: int) -> bool:
    n = int(ours.n_interactions[index])
    if n != theirs.n_interactions[other]:
        return False
    if np.any(ours.bounce_object[index, :n] != theirs.bounce_object[other, :n]):
        return False
    offset = ours.vertex_m[index, :n] - theirs.vertex_m[other, :n]
    return bool(np.abs(offset).max(initial=0) < SAME_VERTEX_M)


def _needs_tracer(scene: Scene, config: PropagationConfig) -> bool:
    """Whether the scene needs the tracer: for diffuse paths or for meshes."""
    rough = any(material.scattering_coefficient > 0 for material in scene.materials.values())
    return config.max_bounces > 0 and ((rough and config.diffuse_samples > 0) or bool(scene.clutter))
