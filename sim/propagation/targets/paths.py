"""Paths TX - target - RX, directly or with one reflection off the scene before or after the target.

Either half is a path of the exact solver between a device and a scattering point, with the gain of both
polarisations at the point. The whole has the gain g_t g_r sqrt(4 pi sigma) / lambda: the radar equation.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import ComplexArray, FloatArray, IntArray
from scenes.scene import Scene
from scenes.targets.target import Target
from sim.config import PropagationConfig
from sim.propagation.occlusion import occluders, surface_names
from sim.propagation.paths import BounceKind, Paths, empty_paths
from sim.propagation.specular.solver import ExactSolver
from sim.propagation.targets.rcs import TargetDraws, mean_rcs_dbsm, scattering

MOST_REFLECTIONS = 1  # off the scene, before and after a target together
SLOTS = 1 + MOST_REFLECTIONS


ANGLES = ("aod_azimuth_rad", "aod_elevation_rad")


@dataclass(frozen=True)
class _Placed:
    """A target of a scene: its number among the targets and the objects, its points (point, xyz), its solver."""

    number: int
    index: int
    target: Target
    points_m: FloatArray
    solver: ExactSolver


class TargetSolver:
    """The targets of a scene, each with a solver of the scene whose own box does not block it."""

    def __init__(self, scene: Scene, carrier_hz: float, config: PropagationConfig) -> None:
        self._wavelength_m, self._names = SPEED_OF_LIGHT_M_S / carrier_hz, surface_names(scene)
        self._tx = np.asarray(scene.tx.position_m, float)
        few = config.model_copy(
            update={"max_bounces": min(config.max_bounces, MOST_REFLECTIONS), "transmission": False}
        )
        self._targets: list[_Placed] = []
        for index, item in enumerate(scene.objects):
            if item.target is not None:
                faces = occluders(scene, without=index)
                points = item.target.points_m(item.pivot_m)
                solver = ExactSolver(scene, carrier_hz, few, faces)
                self._targets.append(_Placed(len(self._targets), index, item.target, points, solver))
        self._draws: TargetDraws | None = None

    def drawn(self, rng: np.random.Generator) -> TargetSolver:
        """The same targets with the random numbers of a stop."""
        drawn = copy.copy(self)
        n_points = max((len(placed.points_m) for placed in self._targets), default=0)
        drawn._draws = TargetDraws.make(rng, len(self._targets), n_points, len(self._names))
        return drawn

    def restricted(self, objects: IntArray) -> TargetSolver:
        """Only the targets among these objects, and only these reflect."""
        fewer = copy.copy(self)
        fewer._targets = [
            replace(placed, solver=placed.solver.restricted(objects))
            for placed in self._targets
            if placed.index in objects
        ]
        return fewer

    def paths(self, rx_m: FloatArray) -> list[Paths]:
        """Paths over targets to a receiver (xyz,), a record for each target."""
        return [self._over(placed, rx_m) for placed in self._targets]

    def _over(self, placed: _Placed, rx_m: FloatArray) -> Paths:
        points, solver = placed.points_m, placed.solver
        sent, received = solver.polarised(points), solver.from_place(rx_m).polarised(points)
        rows, halves = [], []
        for point, ((a, a_gain), (b, b_gain)) in enumerate(zip(sent, received, strict=True)):
            for i, j in product(range(len(a)), range(len(b))):
                if a.n_bounces[i] + b.n_bounces[j] <= MOST_REFLECTIONS:
                    rows.append(_joined(a, i, b, j, placed.index, points[point]))
                    halves.append((point, a_gain[i], b_gain[j], *self._ends(a, i, b, j, points[point], rx_m)))
        if not rows:
            return empty_paths(self._names, SLOTS)
        columns = [np.array(column) for column in zip(*rows, strict=True)]
        gain = self._gain(placed, *(np.array(column) for column in zip(*halves, strict=True)))
        values: list[Any] = [gain, *columns, np.asarray(self._names, str)]
        return Paths(*values)

    def _ends(
        self, a: Paths, i: int, b: Paths, j: int, point: FloatArray, rx_m: FloatArray
    ) -> tuple[FloatArray, FloatArray, int, int]:
        """Unit vectors (xyz,) from a point towards the places before and after it, and their surfaces."""
        towards = []
        for half, row, end in ((a, i, self._tx), (b, j, rx_m)):
            last = half.vertex_m[row, half.n_interactions[row] - 1] if half.n_interactions[row] else end
            towards.append((last - point) / np.linalg.norm(last - point))
        # With one reflection at most the first slot is the surface; -1 stands for none.
        return towards[0], towards[1], int(a.bounce_object[i, 0]), int(b.bounce_object[j, 0])

    def _gain(
        self,
        placed: _Placed,
        point: IntArray,
        sent: ComplexArray,
        received: ComplexArray,
        incident: FloatArray,
        scattered: FloatArray,
        before: IntArray,
        after: IntArray,
    ) -> ComplexArray:
        """Gain (path,) of whole paths from those of their halves (path, polarisation)."""
        target = placed.target
        own = point if target.has_points else None
        mean = 10 ** (mean_rcs_dbsm(target.standard, target.heading_rad, incident, scattered, own) / 10)
        if self._draws is None:
            field = (received * sent).sum(axis=1)
        else:
            factor, matrix = scattering(target.standard, self._draws.value[placed.number, point, before, after])
            mean, field = mean * factor, np.einsum("pa,pab,pb->p", received, matrix, sent)
        return np.asarray(field * np.sqrt(4 * np.pi * mean) / self._wavelength_m)


def _joined(a: Paths, i: int, b: Paths, j: int, target: int, point: FloatArray) -> tuple[object, ...]:
    """The columns of a path, but its gain, from one that reaches a point and one that comes back from the RX."""
    kind, item = np.full(SLOTS, BounceKind.NONE), np.full(SLOTS, -1)
    vertex = np.full((SLOTS, 3), np.nan)
    n, m = int(a.n_interactions[i]), int(b.n_interactions[j])
    kind[:n], item[:n], vertex[:n] = a.bounce_kind[i, :n], a.bounce_object[i, :n], a.vertex_m[i, :n]
    kind[n], item[n], vertex[n] = BounceKind.TARGET, target, point
    back = slice(n + 1, n + 1 + m)
    kind[back], item[back] = b.bounce_kind[j, :m][::-1], b.bounce_object[j, :m][::-1]
    vertex[back] = b.vertex_m[j, :m][::-1]
    angles = (*(getattr(a, name)[i] for name in ANGLES), *(getattr(b, name)[j] for name in ANGLES))
    return (a.delay_s[i] + b.delay_s[j], *angles, kind, item, vertex)
