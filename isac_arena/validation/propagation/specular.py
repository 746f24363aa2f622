"""Checks of the exact specular solver against the ray tracer, shot rays and symmetries."""

from dataclasses import replace

import numpy as np

from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.propagation.shooting import Shooter
from isac_arena.validation.scenarios import solids
from scenes.config import library_scenes, load_scene
from scenes.contours import Circle
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.random_arena import random_arena
from scenes.record import FloatArray
from scenes.scene import Scene
from sim.config import PropagationConfig
from sim.propagation.paths import Paths
from sim.propagation.propagator import compare_planar
from sim.propagation.specular.curved import length_derivatives, reflection_points
from sim.propagation.specular.solver import ExactSolver, exact_paths
from sim.propagation.specular.surfaces import reflecting_surfaces
from sim.propagation.tracer import Tracer

SAME_LENGTH_M = 1e-4
FIELDS = ("gain", "delay_s", "aod_azimuth_rad", "aoa_elevation_rad", "bounce_object", "vertex_m")


def check_completeness(seed: int, quick: bool) -> list[Measurement]:
    """Planar specular paths against the ray tracer, on library scenes and random arenas.

    The exact solver has to hold every path that the tracer finds; what the tracer loses is counted.
    """
    rng = np.random.default_rng(seed)
    names = library_scenes()[: 1 if quick else None]
    scenes = [load_scene(name, solids.CARRIER_HZ) for name in names]
    scenes += [random_arena(rng, float(rng.uniform(0, 1)), 3) for _ in range(1 if quick else 20)]
    n_common = n_repaired = n_extra = 0
    for scene in scenes:
        stops = scene.walk.positions_m()[:: 1 + len(scene.stops) // 5]
        tracer = Tracer(scene, solids.CARRIER_HZ, PropagationConfig(diffuse_samples=0))
        for rx, exact in zip(stops, exact_paths(scene, stops, solids.CARRIER_HZ), strict=True):
            counts = compare_planar(scene, tracer.specular(rx), exact)
            n_common, n_repaired = n_common + counts.n_common, n_repaired + counts.n_repaired
            n_extra += counts.n_extra
    share = n_common / max(1, n_common + n_extra)
    reason = f"of {n_common + n_extra} paths traced in {len(scenes)} scenes; the tracer loses {n_repaired}"
    return [
        at_least("planar_completeness", share, 1.0, reason, "share"),
        at_most("planar_missed", n_extra, 0, "traced paths that the solver lacks", "paths"),
    ]


def check_against_shooting(seed: int, quick: bool) -> list[Measurement]:
    """All paths of up to two bounces off flat, convex and concave walls against rays shot onto the receiver."""
    rng = np.random.default_rng(seed)
    counts = {"solids": np.zeros(3, int), "concave": np.zeros(3, int)}
    for _ in range(2 if quick else 20):
        scene = solids.scene_of([*rng.uniform(-1, 1, 2), 1.0], solids.random_solids(rng))
        counts["solids"] += _compared(scene, solids.random_receivers(rng, scene, 3, 2.5, 1.0))
    pillar = Circle(np.array([-0.7, -1.1]), 0.2)
    for wall in (solids.open_ring(), solids.wave_wall()):
        for _ in range(1 if quick else 5):
            scene = solids.scene_of([*rng.uniform(0.1, 1.1, 2), 1.0], [wall, pillar])
            counts["concave"] += _compared(scene, solids.random_receivers(rng, scene, 1, 1.6, 1.0))
    rows = []
    for name, (missed, extra, total) in counts.items():
        rows.append(at_most(f"{name}_missed", missed, 0, f"of {total} paths that shot rays find", "paths"))
        rows.append(at_most(f"{name}_extra", extra, 0, "no path that shot rays do not find", "paths"))
    return rows


def check_lit_pillar(seed: int, quick: bool) -> list[Measurement]:
    """A receiver gets the path of a smooth pillar exactly where the pillar does not cut its line of sight."""
    rng = np.random.default_rng(seed)
    scene = solids.scene_of([4.0, 1.0, 1.5], [Circle(np.zeros(2), 0.203)])
    rx = solids.random_receivers(rng, scene, 200 if quick else 2000, 8.0, 1.5)
    solved = exact_paths(scene, rx, solids.CARRIER_HZ, PropagationConfig(max_bounces=1))
    hits = [bool(paths.is_single_bounce.any()) for paths in solved if paths.is_los.any()]
    return [at_least("lit_pillar_hit_rate", np.mean(hits), 1.0, "one lit point", "share")]


def check_stationarity(seed: int, quick: bool) -> list[Measurement]:
    """Distance of the reflection points from where the length is stationary."""
    rng = np.random.default_rng(seed)
    worst = 0.0
    for contour in (Circle(np.zeros(2), 0.203), solids.open_ring(), solids.wave_wall()):
        curves = reflecting_surfaces(solids.scene_of([9.0, 9.0, 1.0], [contour])).curves
        n = 100 if quick else 1000
        curve = rng.integers(len(curves), size=n)
        source, target = rng.uniform(-4, 4, (2, n, 2))
        found = reflection_points(curves, curve, source, target)
        for row, point in zip(found.row, found.point_m, strict=True):
            grid = np.linspace(-1e-9, 1 + 1e-9, 4001)
            index = np.full(len(grid), curve[row])
            t = grid[np.linalg.norm(curves.at(index, grid)[0] - point, axis=1).argmin()]
            ends = source[row, None], target[row, None]
            for _ in range(8):
                slope, bend, _ = length_derivatives(curves, curve[row, None], np.array([t]), *ends)
                t -= float((slope / bend)[0])
            there = curves.at(curve[row, None], np.array([t]))[0][0]
            worst = max(worst, float(np.linalg.norm(there - point)))
    return [at_most("stationarity_residual", worst, 1e-9, "Newton's method to the end", "m")]


def check_symmetries(seed: int, quick: bool) -> list[Measurement]:
    """Reciprocity and rigid motion of the whole scene, through walls too."""
    rng = np.random.default_rng(seed)
    swap = motion = 0.0
    config = PropagationConfig(transmission=True)
    for _ in range(2 if quick else 20):
        contours = solids.random_solids(rng)
        tx = np.array([*rng.uniform(-1, 1, 2), 1.2])
        scene = solids.scene_of(tx, contours, (solids.GLASS, solids.METAL, solids.STONE), floor=True)
        [rx] = solids.random_receivers(rng, scene, 1, 2.5, 1.9)
        [paths] = exact_paths(scene, rx, solids.CARRIER_HZ, config)
        [back] = exact_paths(solids.with_tx(scene, rx), tx, solids.CARRIER_HZ, config)
        swap = max(swap, _relative(paths, back))
        moved, rx_moved = _moved(scene, rx, float(rng.uniform(0, 2 * np.pi)), rng.uniform(-5, 5, 2))
        [there] = exact_paths(moved, rx_moved, solids.CARRIER_HZ, config)
        motion = max(motion, _relative(paths, there))
    return [
        at_most("reciprocity", swap, 1e-9, "swapped ends, gains and delays", "relative"),
        at_most("rigid_motion", motion, 1e-9, "gains without carrier phase, delays", "relative"),
    ]


def check_same_bits(seed: int, quick: bool) -> list[Measurement]:
    """The same bits for chunks of 1, 7 and all receivers, shuffled receivers, and a second run."""
    rng = np.random.default_rng(seed)
    contours = [*solids.random_solids(rng), solids.open_ring(9.0)]
    scene = solids.scene_of([0.3, 0.2, 1.2], contours, (solids.GLASS, solids.METAL), floor=True)
    rx = solids.random_receivers(rng, scene, 12 if quick else 60, 3.0, 1.8)
    config = PropagationConfig(transmission=True)
    solver = ExactSolver(scene, solids.CARRIER_HZ, config)
    first = solver.paths(rx, chunk=len(rx))
    order = rng.permutation(len(rx))
    shuffled = solver.paths(rx[order])
    runs = [
        solver.paths(rx, chunk=1),
        solver.paths(rx, chunk=7),
        ExactSolver(scene, solids.CARRIER_HZ, config).paths(rx, chunk=len(rx)),
        [shuffled[int(place)] for place in np.argsort(order)],
    ]
    differing = sum(not _identical(a, b) for run in runs for a, b in zip(first, run, strict=True))
    return [at_most("differing_records", differing, 0, "chunks, order, two runs", "records")]


def _compared(scene: Scene, rx_m: FloatArray) -> tuple[int, int, int]:
    """Paths missed, paths too many, and paths in all, of up to two bounces, against shot rays."""
    solved = exact_paths(scene, rx_m, solids.CARRIER_HZ, PropagationConfig(max_bounces=2))
    shooter = Shooter(scene)
    missed = extra = total = 0
    for rx, paths in zip(rx_m, solved, strict=True):
        ours = [
            (tuple(int(one) for one in surface if one >= 0), delay * SPEED_OF_LIGHT_M_S)
            for surface, delay in zip(paths.bounce_object, paths.delay_s, strict=True)
            if surface[0] >= 0
        ]
        for shot in shooter.paths(rx[:2], 2):
            total += 1
            met = [one for one in ours if one[0] == shot.surface]
            near = [one for one in met if abs(one[1] - shot.length_m) < SAME_LENGTH_M]
            missed += not near
            if near:
                ours.remove(near[0])
        extra += len(ours)
    return missed, extra, total


def _moved(scene: Scene, rx_m: FloatArray, turn_rad: float, shift_m: FloatArray) -> tuple[Scene, FloatArray]:
    """The scene and a receiver turned about the vertical and shifted."""
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    matrix = np.array([(c, -s), (s, c)])

    def move(point: FloatArray) -> FloatArray:
        moved = np.array(point, float)
        moved[..., :2] = point[..., :2] @ matrix.T + shift_m
        return moved

    objects = []
    for item in scene.objects:
        contour = item.contour
        names = ("center_m", "vertices_m", "points_m")
        changed = {name: move(getattr(contour, name)) for name in names if hasattr(contour, name)}
        objects.append(replace(item, contour=replace(contour, **changed)))
    tx = Pose(move(scene.tx.position_m), scene.tx.heading_rad)
    return replace(scene, tx=tx, objects=tuple(objects)), move(rx_m)


def _relative(a: Paths, b: Paths) -> float:
    """Largest relative difference of sorted delays and of gains freed from the carrier phase; inf if unequal."""
    if len(a) != len(b):
        return np.inf
    columns = []
    for paths in (a, b):
        gain = paths.gain * np.exp(2j * np.pi * solids.CARRIER_HZ * paths.delay_s)
        order = np.lexsort([gain.real, np.round(paths.delay_s * 1e15)])
        columns.append((paths.delay_s[order], gain[order]))
    delay = np.abs(columns[0][0] / columns[1][0] - 1).max()
    gain = (np.abs(columns[0][1] - columns[1][1]) / np.abs(columns[0][1])).max()
    return float(max(delay, gain))


def _identical(a: Paths, b: Paths) -> bool:
    return all(getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in FIELDS)
