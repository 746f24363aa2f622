"""Rates of paths against tracing again: central differences of fourth order over five instants."""

from collections.abc import Iterator

import numpy as np

from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.motion.worlds import MadeWorld, moving_world
from scenes.pose import wrap_angle
from scenes.record import FloatArray, IntArray
from sim.propagation.motion.tracks import ANGLES
from sim.propagation.paths import BounceKind, Paths

STEP_S = 1e-3
FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / (12 * STEP_S)
SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / (12 * STEP_S**2)
SAME_M, SAME_RAD = 0.01, 0.02  # within a step a path is not farther from its prediction
BARS = {"length_rate": 1e-6, "length_acceleration": 1e-5, "departure": 1e-6, "arrival": 1e-6}
CONVERGED = np.array(
    [5e-7, 5e-6, 5e-7, 5e-7, 5e-7, 5e-7]
)  # of the differences themselves, half the step against all
LEAST_JUDGED = 0.9  # of the paths: those of the others bend too fast for the differences


def check_rates(seed: int, quick: bool, trials: int | None = None) -> list[Measurement]:
    """Length rate (Doppler), its second derivative and rates of all angles, for all kinds of exact paths."""
    n_worlds = trials or (8 if quick else 500)
    errors: dict[str, list[FloatArray]] = {
        kind: [] for kind in ("reflected", "curved", "edges", "mesh", "creeping")
    }
    worst: list[FloatArray] = []
    n_paths = 0
    for index in range(n_worlds):
        for kind, error in world_errors(moving_world(seed, index)):
            n_paths += 1
            if error is not None:
                errors[kind].append(error)
                worst.append(error)
    every = np.array(worst)
    count = f"{len(every)} paths of {n_worlds} arenas: " + ", ".join(f"{len(e)} {k}" for k, e in errors.items())
    rows = [
        at_most(f"motion.rates.{name}", every[:, place].max(), bar, f"relative to the rate or its median; {count}")
        for place, (name, bar) in enumerate(BARS.items())
    ]
    rows.append(at_least("motion.rates.judged", len(every) / max(1, n_paths), LEAST_JUDGED, "share of the paths"))
    rows.append(at_least("motion.rates.kinds", sum(bool(e) for e in errors.values()), 4 if quick else 5, count))
    return rows


def world_errors(world: MadeWorld) -> Iterator[tuple[str, FloatArray | None]]:
    """Kind of every path that lives through the five instants, and its four relative errors.

    Errors are relative to the rate, or to the speed of the world (the median size of that rate over its paths)
    where the rate is smaller. The errors are None where the differences have not converged: half the step differs.
    """
    times = STEP_S * np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])
    traced = [world.paths(time) for time in times]
    middle = traced[len(times) // 2]
    rows = np.stack([_followed(middle, paths, time) for paths, time in zip(traced, times, strict=True)])
    alive = np.flatnonzero((rows >= 0).all(axis=0))
    value = _values([(paths, row[alive]) for paths, row in zip(traced, rows, strict=True)])
    rates = _rates(middle, alive)
    wide, fine = _differences(value[:, [0, 1, 3, 5, 6]], 1.0), _differences(value[:, 1:6], 0.5)
    scale = np.maximum(np.abs(rates), np.median(np.abs(rates), axis=1, keepdims=True))
    error, doubt = np.abs(wide - rates) / scale, np.abs(wide - fine) / scale
    for column, path in enumerate(alive):
        length, bend, *angles = error[:, column]
        found = np.array([length, bend, max(angles[:2]), max(angles[2:])])
        yield _kind(world, middle, int(path)), found if (doubt[:, column] < CONVERGED).all() else None


def _followed(middle: Paths, later: Paths, time_s: float) -> IntArray:
    """Row (path,) of every path of the middle at another time; -1 where it is not there."""
    assert middle.rates is not None
    length = middle.length_m + time_s * middle.rates.length_rate_m_s
    apart = np.abs(length[:, None] - later.length_m)
    for name in ANGLES:
        there = getattr(middle, f"{name}_rad") + time_s * getattr(middle.rates, f"{name}_rate_rad_s")
        turned = np.abs(wrap_angle(there[:, None] - getattr(later, f"{name}_rad")))
        apart = np.where(turned < SAME_RAD, apart, np.inf)
    same = (middle.bounce_object[:, None] == later.bounce_object).all(axis=2)
    same &= (middle.bounce_kind[:, None] == later.bounce_kind).all(axis=2)
    apart = np.where(same, apart, np.inf)
    return np.where(apart.min(axis=1, initial=np.inf) < SAME_M, apart.argmin(axis=1), -1)


def _values(traced: list[tuple[Paths, IntArray]]) -> FloatArray:
    """Length and the four angles, unwrapped (quantity, time, path)."""
    length = np.array([paths.length_m[rows] for paths, rows in traced])
    angles = [
        np.unwrap([getattr(paths, f"{name}_rad")[rows] for paths, rows in traced], axis=0) for name in ANGLES
    ]
    return np.stack([length, *angles])


def _differences(value: FloatArray, step: float) -> FloatArray:
    """Length rate, its derivative, and rates of the angles (rate, path) from five instants."""
    first = np.einsum("t,qtp->qp", FIRST / step, value)
    second = np.einsum("t,tp->p", SECOND / step**2, value[0])
    return np.vstack([first[:1], second[None], first[1:]])


def _rates(paths: Paths, rows: IntArray) -> FloatArray:
    assert paths.rates is not None
    angles = [getattr(paths.rates, f"{name}_rate_rad_s")[rows] for name in ANGLES]
    return np.stack([paths.rates.length_rate_m_s[rows], paths.rates.length_acceleration_m_s2[rows], *angles])


def _kind(world: MadeWorld, paths: Paths, path: int) -> str:
    kinds, objects = paths.bounce_kind[path], paths.bounce_object[path]
    if (kinds == BounceKind.TARGET).any():
        return "target"
    touched = objects[objects >= 0]
    if (touched >= len(paths.object_name) - len(world.scene.clutter)).any():
        return "mesh"
    solids = [world.scene.objects[index].contour for index in touched if index < len(world.scene.objects)]
    is_curved = any(piece.is_curved for contour in solids for piece in contour.pieces)
    if (kinds == BounceKind.DIFFRACTION).any():
        return "creeping" if is_curved else "edges"
    return "curved" if is_curved else "reflected"
