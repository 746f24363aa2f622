"""Checks of the paths over user meshes: a box given as a mesh against the same box as a prism."""

from dataclasses import replace

import numpy as np

from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.scenarios.solids import CARRIER_HZ, STONE, box_walls, scene_of
from scenes.contours import Polygon
from scenes.objects.clutter import Clutter
from scenes.objects.material import Material
from scenes.pose import wrap_angle
from scenes.record import FloatArray
from scenes.scene import Scene, SceneObject
from sim.config import PropagationConfig
from sim.propagation.paths import BounceKind, Paths
from sim.propagation.propagator import Propagator

ROOM_M = (8.0, 6.0)
BOARD = Material("board", 5.0, 0.5, 0.01, 0.2)
BOX_FACES = [  # two triangles a side of corners 0..3 at the bottom and 4..7 at the top, normals outward
    (0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4),
    (1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7),
]  # fmt: skip
SAME_VERTEX_M = 1e-3


def check_mesh_box(seed: int, quick: bool) -> list[Measurement]:
    """Single bounces and diffraction at vertical edges of a box in a room: mesh against prism, missed and extra.

    Horizontal edges of the mesh diffract too, which those of prisms do not.
    """
    rng = np.random.default_rng(seed)
    single = PropagationConfig(max_bounces=1, diffuse_samples=0, compare_planar=False)
    double = single.model_copy(update={"max_bounces": 2})
    through = single.model_copy(update={"transmission": True})
    missed, count, extra, errors = np.zeros(3, int), np.zeros(3, int), 0, [np.zeros(3)]
    for _ in range(2 if quick else 15):
        prism, mesh, receivers = _box_scenes(rng)
        for index, config in enumerate((single, double, through)):
            solvers = [Propagator(scene, CARRIER_HZ, config) for scene in (prism, mesh)]
            for rx in receivers:
                drawn, found = (_over_box(solver.paths(rx)) for solver in solvers)
                pairs = _matched(drawn, found)
                count[index] += len(drawn)
                missed[index] += len(drawn) - len(pairs)
                specular = ~(found.bounce_kind == BounceKind.DIFFRACTION).any(axis=1)
                extra += int(specular.sum()) - sum(bool(specular[other]) for _, other in pairs)
                errors += [_errors(drawn, index, found, other) for index, other in pairs]
    delay, angle, gain = np.max(errors, axis=0)
    reasons = [f"of {n} paths over the same box drawn as a prism" for n in count]
    share = float(1 - missed[1] / max(1, count[1]))
    return [
        at_most("mesh_missed_single", int(missed[0]), 0, reasons[0], "paths"),
        at_most("mesh_missed_through_walls", int(missed[2]), 0, reasons[2], "paths"),
        at_least("mesh_completeness_double", share, 0.98, f"rays miss few {reasons[1]}", "share"),
        at_most("mesh_extra", extra, 0, "no specular path that the prism has not", "paths"),
        at_most("mesh_delay_error", delay * 1e12, 1.0, "the same box drawn as a prism", "ps"),
        at_most("mesh_angle_error", angle, 1e-5, "the same box drawn as a prism", "rad"),
        at_most("mesh_gain_error", gain, 0.05, "the same box drawn as a prism", "dB"),
    ]


def _box_scenes(rng: np.random.Generator) -> tuple[Scene, Scene, FloatArray]:
    """A room with a turned box on the floor, once as a prism and once as a mesh, and receivers (receiver, xyz)."""
    turn, height = rng.uniform(0, np.pi / 2), rng.uniform(0.8, 2.0)
    half = rng.uniform(0.3, 0.8, 2)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
    c, s = np.cos(turn), np.sin(turn)
    outline = corners @ np.array([(c, s), (-s, c)]) + (4.0, 3.0) + rng.uniform(-0.5, 0.5, 2)
    vertices = np.concatenate([np.column_stack([outline, np.full(4, z)]) for z in (0.0, height)])
    places = np.column_stack([rng.uniform(0.4, 2.0, 5), rng.uniform(0.4, 5.6, 5), rng.uniform(0.3, 2.7, 5)])
    places[2:, 0] = ROOM_M[0] - places[2:, 0]
    empty = replace(scene_of(places[0], box_walls(*ROOM_M), (STONE,), floor=True), bounds_m=(0.0, 0.0, *ROOM_M))
    drawn = SceneObject("crate", "box", Polygon(outline), 0.0, height, BOARD)
    crate = Clutter("crate", "clutter", BOARD, vertices, np.array(BOX_FACES))
    return replace(empty, objects=(*empty.objects, drawn)), replace(empty, clutter=(crate,)), places[1:]


def _over_box(paths: Paths) -> Paths:
    """The paths that meet the box."""
    [box] = np.flatnonzero(paths.object_name == "crate")
    return paths.take("path", (paths.bounce_object == box).any(axis=1))


def _matched(drawn: Paths, found: Paths) -> list[tuple[int, int]]:
    """Pairs of paths of the same kinds of interaction within 1 mm of each other."""
    unpaired, pairs = list(range(len(found))), []
    for index in range(len(drawn)):
        for other in unpaired:
            offset = np.nan_to_num(drawn.vertex_m[index]) - np.nan_to_num(found.vertex_m[other])
            same = np.array_equal(drawn.bounce_kind[index], found.bounce_kind[other])
            if same and np.abs(offset).max() < SAME_VERTEX_M:
                pairs.append((index, other))
                unpaired.remove(other)
                break
    return pairs


def _errors(drawn: Paths, index: int, found: Paths, other: int) -> FloatArray:
    """Differences of delay in s, directions in rad and gain in dB."""
    angle = max(
        abs(float(wrap_angle(getattr(drawn, name)[index] - getattr(found, name)[other])))
        for name in ("aod_azimuth_rad", "aod_elevation_rad", "aoa_azimuth_rad", "aoa_elevation_rad")
    )
    ratio = abs(drawn.gain[index] / found.gain[other])
    return np.array([abs(drawn.delay_s[index] - found.delay_s[other]), angle, abs(20 * np.log10(ratio))])
