"""Random walks, random places and grids of places of a receiver that keep a clearance from all obstacles."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from scenes.contours import Contour
from scenes.pose import direction
from scenes.record import FloatArray
from scenes.walks.trajectory import Walk

TURN_STD_RAD = 0.35  # change of course from one step to the next
N_DIRECTIONS = 24  # alternative courses if the drawn one is blocked
N_STARTS = 2000
MARGIN_M = 1e-3  # added to the clearance, because curves are approximated by polygons
N_QUADRANT_CHORDS = 32


def random_walk(
    rng: np.random.Generator,
    obstacles: Sequence[Contour],
    *,
    area_m: tuple[float, float, float, float],
    n_stops: int,
    step_m: float,
    height_m: float,
    clearance_m: float,
    start_m: FloatArray | None = None,
    heading_rad: float = np.nan,
) -> Walk:
    """A walk of equal steps that keeps `clearance_m` from all obstacles and the rim of the area.

    The course changes by a normally distributed angle per step. If this course is blocked, the walk takes the
    nearest free course. The whole line of a step keeps the clearance, not only its ends.

    Parameters
    ----------
    area_m : (x_min, y_min, x_max, y_max) of the walk
    start_m : first stop (xy,); random by default
    heading_rad : heading of the array at every stop; NaN looks along the walk

    Raises `ValueError` if the given start is not free, no free start exists, or no free step exists.
    """
    free = _free_area(obstacles, area_m, clearance_m)
    here = _start(rng, free, area_m, start_m, clearance_m)
    course = rng.uniform(-np.pi, np.pi)
    fan = np.arange(N_DIRECTIONS) * 2 * np.pi / N_DIRECTIONS
    fan = fan[np.argsort(np.abs((fan + np.pi) % (2 * np.pi) - np.pi), kind="stable")]
    points = [here]
    for _ in range(n_stops - 1):
        course += TURN_STD_RAD * rng.standard_normal()
        for turn in fan:
            there = here + step_m * direction(course + turn)[:2]
            if free.covers(shapely.LineString([here, there])):
                course, here = course + turn, there
                break
        else:
            raise ValueError(f"step_m = {step_m}: there is no clear step from {np.round(here, 3).tolist()}")
        points.append(here)
    return Walk(np.array(points), height_m, heading_rad)


def grid_places(
    obstacles: Sequence[Contour], area_m: tuple[float, float, float, float], step_m: float, clearance_m: float
) -> FloatArray:
    """Free places (stop, xy) of a grid centred in the area, row by row in alternating direction.

    Raises `ValueError` if no place is free.
    """
    free = _free_area(obstacles, area_m, clearance_m)
    low, high = np.array(area_m[:2]), np.array(area_m[2:])
    count = ((high - low - 2 * clearance_m) // step_m).astype(int) + 1
    start = (low + high - (count - 1) * step_m) / 2
    x, y = (start[axis] + step_m * np.arange(max(count[axis], 0)) for axis in (0, 1))
    rows = [np.column_stack([x if row % 2 == 0 else x[::-1], np.full(len(x), at)]) for row, at in enumerate(y)]
    places = np.concatenate([np.zeros((0, 2)), *rows])
    found = places[shapely.covers(free, shapely.points(places))]
    if not len(found):
        raise ValueError(f"step_m = {step_m}: no place of the grid keeps clearance_m = {clearance_m}")
    return np.asarray(found)


def random_places(
    rng: np.random.Generator,
    obstacles: Sequence[Contour],
    area_m: tuple[float, float, float, float],
    n_places: int,
    clearance_m: float,
) -> FloatArray:
    """Places (stop, xy) drawn evenly over the free part of the area, each alone.

    Raises `ValueError` if no place is free.
    """
    free = _free_area(obstacles, area_m, clearance_m)
    found = [_start(rng, free, area_m, None, clearance_m) for _ in range(n_places)]
    return np.array(found)


def _free_area(obstacles: Sequence[Contour], area_m: tuple[float, float, float, float], clearance_m: float) -> Any:
    """The part of the area that keeps the clearance, as a prepared shapely geometry."""
    margin = clearance_m + MARGIN_M
    bodies = [contour.body().buffer(margin, quad_segs=N_QUADRANT_CHORDS) for contour in obstacles]
    free = shapely.box(*area_m).buffer(-clearance_m).difference(shapely.union_all(bodies))
    shapely.prepare(free)
    return free


def _start(
    rng: np.random.Generator,
    free: Any,
    area_m: tuple[float, float, float, float],
    start_m: FloatArray | None,
    clearance_m: float,
) -> FloatArray:
    if start_m is not None:
        start = np.asarray(start_m, float)
        if not free.covers(shapely.Point(start)):
            raise ValueError(
                f"start_m = {start.tolist()}: must lie clearance_m = {clearance_m} away from objects and rim"
            )
        return start
    candidates = rng.uniform(area_m[:2], area_m[2:], (N_STARTS, 2))
    clear = np.flatnonzero(shapely.covers(free, shapely.points(candidates)))
    if not len(clear):
        raise ValueError(f"clearance_m = {clearance_m}: no place of the area is so far from all objects")
    return np.asarray(candidates[clear[0]])
