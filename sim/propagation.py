"""All propagation paths of a scene: exact specular ones and traced diffuse ones, in one order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenes.contour_piece import LinePiece, Piece
from scenes.record import BoolArray, FloatArray, concatenate
from scenes.scene import Scene
from sim.config import PropagationConfig
from sim.creeping import creeping_paths
from sim.diffraction import diffracted_paths
from sim.edges import find_edges
from sim.exact import ExactSolver
from sim.occlusion import occluders
from sim.paths import BounceKind, Paths, canonical_order, with_bounce_slots
from sim.raytrace import Tracer

SAME_VERTEX_M = 5e-3  # the tracer places its vertices in single precision
ON_FACE_M = 1e-6


class Propagator:
    """A scene made ready for propagation, to be asked for one receiver position after the other.

    Where a material scatters, the tracer is imported and the scene loaded, which takes seconds; raises
    `sim.llvm.LlvmError` where there is no usable LLVM library then.
    """

    def __init__(self, scene: Scene, carrier_hz: float, config: PropagationConfig | None = None) -> None:
        self._config = config or PropagationConfig()
        self._scene, self._carrier_hz = scene, carrier_hz
        self._faces = occluders(scene)
        self._edges = find_edges(scene)
        self._exact = ExactSolver(scene, carrier_hz, self._config, self._faces)
        self._tracer = Tracer(scene, carrier_hz, self._config) if _scatters(scene, self._config) else None

    def paths(self, rx_position_m: FloatArray) -> Paths:
        """All paths from the scene's TX to a receiver (xyz,), in canonical order.

        Line of sight, specular reflections off flat and curved surfaces up to `max_bounces` (two where one is
        curved), with `transmission` also ways through faces, with `diffraction` those round one edge or pillar,
        and first-order diffuse scattering. The same bits on every run, whatever was asked before.
        """
        rx = np.asarray(rx_position_m, float)
        parts = self._exact.paths(rx)
        if self._config.diffraction and self._config.max_bounces:
            scene, carrier_hz, faces = self._scene, self._carrier_hz, self._faces
            bent = diffracted_paths(scene, rx, carrier_hz, faces, self._edges)
            bent += creeping_paths(scene, rx, carrier_hz, faces)
            parts += [with_bounce_slots(paths, self._config.n_bounce_slots) for paths in bent]
        if self._tracer is not None:
            parts.append(self._tracer.diffuse(rx))
        return canonical_order(concatenate(parts, "path"))


def propagate(
    scene: Scene, rx_positions_m: FloatArray, *, carrier_hz: float, config: PropagationConfig | None = None
) -> list[Paths]:
    """Paths to each receiver position (receiver, xyz), one record each; see `Propagator.paths`."""
    propagator = Propagator(scene, carrier_hz, config)
    return [propagator.paths(position) for position in np.atleast_2d(rx_positions_m)]


@dataclass(frozen=True)
class Comparison:
    """Planar specular paths of the tracer against the exact ones: found by both, by one alone."""

    n_common: int
    n_repaired: int
    n_extra: int


def compare_planar(scene: Scene, traced: Paths, exact: Paths) -> Comparison:
    """How many exact paths without curved bounce or transmission the tracer lost (repaired), and found beyond.

    A path is the same where kinds and objects agree and all vertices lie within 5 mm.
    """
    ours = exact.take("path", _is_planar(scene, exact))
    theirs = traced.take("path", ~traced.is_diffuse)
    left = list(range(len(theirs)))
    for index in range(len(ours)):
        match = next((other for other in left if _same(ours, index, theirs, other)), None)
        if match is not None:
            left.remove(match)
    n_common = len(theirs) - len(left)
    return Comparison(n_common, len(ours) - n_common, len(left))


def _is_planar(scene: Scene, paths: Paths) -> BoolArray:
    """Paths (path,) of specular bounces alone, all of them off flat faces."""
    planar = np.isin(paths.bounce_kind, (BounceKind.NONE, BounceKind.SPECULAR)).all(axis=1)
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
    n = int(ours.n_bounces[index])
    if n != theirs.n_bounces[other]:
        return False
    if np.any(ours.bounce_object[index, :n] != theirs.bounce_object[other, :n]):
        return False
    offset = ours.vertex_m[index, :n] - theirs.vertex_m[other, :n]
    return bool(np.abs(offset).max(initial=0) < SAME_VERTEX_M)


def _scatters(scene: Scene, config: PropagationConfig) -> bool:
    """Whether there is anything to trace for diffuse paths."""
    rough = any(material.scattering_coefficient > 0 for material in scene.materials.values())
    return rough and config.diffuse_samples > 0 and config.max_bounces > 0
