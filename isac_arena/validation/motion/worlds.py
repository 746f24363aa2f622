"""Random arenas in which everything moves, and their paths at any instant."""

from dataclasses import dataclass, replace

import numpy as np

from isac_arena.validation.scenarios.solids import CARRIER_HZ
from scenes.motion.motion import Motion
from scenes.objects.clutter import Clutter
from scenes.random_arena import random_arena
from scenes.record import FloatArray
from scenes.scene import Scene
from sim.config import PropagationConfig
from sim.propagation.paths import Paths
from sim.propagation.propagator import Propagator
from sim.propagation.specular.facets import TracedChains

EXACT = PropagationConfig(diffuse_samples=0)
MOST_DIFFICULT = 0.3  # of an arena: about ten objects
START_S = 0.5  # all motions bend before and after


@dataclass(frozen=True)
class MadeWorld:
    """A scene with a receiver that moves steadily, from `rx_m` at `START_S`."""

    scene: Scene
    rx_m: FloatArray
    rx_velocity_m_s: FloatArray

    def paths(self, time_s: float) -> Paths:
        """The exact paths at a time after `START_S`, with their rates."""
        now_s, here = START_S + time_s, self.rx_m + time_s * self.rx_velocity_m_s
        solver = Propagator(self.scene.at(now_s), CARRIER_HZ, EXACT, traces=False)
        found = solver.exact_paths(here, NO_CHAINS)
        return solver.with_rates(found, self.scene.bodies_at(now_s, here, self.rx_velocity_m_s))


NO_CHAINS = TracedChains(
    np.zeros((0, 1), int), np.zeros((0, 1), int), np.zeros((0, 1, 3, 3))
)  # one bounce off meshes


def moving_world(seed: int, index: int, *, with_mesh: bool = True) -> MadeWorld:
    """A random arena whose TX, receiver, pillars, boxes, mesh and some walls move on bent courses, and turn."""
    rng = np.random.default_rng([seed, index])
    scene = random_arena(rng, float(rng.uniform(0.05, MOST_DIFFICULT)), n_stops=2)
    objects = tuple(
        replace(item, motion=_course(rng)) if item.kind != "wall" or rng.random() < 0.3 else item
        for item in scene.objects
    )
    rx_m = scene.stops[0].position_m
    clutter = (_crate(rng, scene, rx_m),) if with_mesh else ()
    scene = replace(scene, objects=objects, tx_motions={scene.tx_name: _course(rng)}, clutter=clutter)
    return MadeWorld(scene, rx_m, rng.normal(size=3) * [1.0, 1.0, 0.1])


def _course(rng: np.random.Generator) -> Motion:
    """A motion of about 1 m/s and 1 rad/s with bends, that is where the scene has it at `START_S`."""
    coefficient = np.zeros((1, 4, 4))
    coefficient[0, 1:3] = rng.normal(size=(2, 4)) * [1.0, 1.0, 0.1, 1.0]
    at_start = coefficient[0, 1] * START_S**2 + coefficient[0, 2] * START_S
    coefficient[0, 3] = -at_start
    return Motion(np.array([0.0, np.inf]), coefficient)


def _crate(rng: np.random.Generator, scene: Scene, rx_m: FloatArray) -> Clutter:
    """A small tilted tetrahedron beside the receiver, for facets and edges in any direction."""
    middle = rx_m + [0.0, 0.0, 0.9] + 0.1 * rng.normal(size=3)
    corners = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]) * 0.25
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    faces = np.array([(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)])
    material = scene.objects[0].material
    return Clutter("crate", "clutter", material, corners @ turn + middle, faces, _course(rng))
