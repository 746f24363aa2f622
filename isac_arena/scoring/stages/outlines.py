"""Outlines and the objects that they show: the columns of both the paper's shapes and our contours."""

from collections.abc import Callable
from dataclasses import astuple, fields
from typing import Any, Literal

import numpy as np
import shapely

from isac_arena.campaign.results import MapResult
from isac_arena.scoring.causes import cluster_causes
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.metrics.statistics import quantile, rows_of_groups
from isac_arena.scoring.provenance import cluster_origin
from isac_arena.scoring.record import IpScores, SignificantPaths
from isac_arena.scoring.stages.maps import FOUND_DISTANCE_M, FOUND_POINTS, close_counts, is_ghost
from isac_arena.scoring.stages.shapes import ShapeErrors
from scenes.record import BoolArray, FloatArray, TextArray
from scenes.scene import Scene, SceneObject

LineOf = Callable[[int], shapely.Geometry]
FOUND_SHARE_SEEN = 0.5  # of the true incidence points on an object: half of what could be seen of it
ErrorOf = Callable[[int, SceneObject, FloatArray, FloatArray], ShapeErrors]


def outline_columns(
    scene: Scene,
    result: MapResult,
    ips: IpScores,
    n_rows: int,
    significant: SignificantPaths,
    error_of: ErrorOf,
    line_of: LineOf,
) -> dict[str, Any]:
    """Columns (row,) by name: the object of each row, its purity and counts, and the errors of the row.

    `ips.label` (ip,) is the row of each incidence point, -1 for none. `error_of` takes the row, its object, the
    points of the row (ip, xy) and the true incidence points on the object (point, xy) over the whole campaign.
    `line_of` gives the outline of a row as a line.
    """
    origin = cluster_origin(ips.label, ips.object, n_rows)
    n_close = close_counts(scene, result, ips, origin)
    members, errors = rows_of_groups(ips.label, n_rows), []
    objects = {item.name: item for item in scene.fixtures}
    lit_m = {name: significant.vertex_m[significant.object == name] for name in set(origin.object.tolist())}
    for row, name in enumerate(origin.object.tolist()):
        if name not in objects:
            errors.append(ShapeErrors())
            continue
        errors.append(error_of(row, objects[name], result.ips.position_m[members[row]], lit_m[name]))
    columns = np.array([astuple(error) for error in errors]).reshape(-1, len(fields(ShapeErrors))).T
    ghost = is_ghost(ips, n_rows)
    return {
        "object": origin.object,
        "purity": origin.purity,
        "n_ips": np.bincount(ips.label[ips.label >= 0], minlength=n_rows),
        "n_close": n_close,
        "is_found": np.asarray((n_close >= FOUND_POINTS) & _shows_enough(origin.object, line_of, significant)),
        "is_ghost": ghost,
        "cause": cluster_causes(ips.label, ips.object, ips.cause, ghost),
        "surface_m": np.array([quantile(ips.surface_distance_m[rows], 0.5) for rows in members], float),
        **{field.name: column for field, column in zip(fields(ShapeErrors), columns, strict=True)},
    }


def _shows_enough(names: TextArray, line_of: LineOf, significant: SignificantPaths) -> BoolArray:
    """Whether the rows (row,) of an object together show enough of where it could be seen.

    Of a wall whose end alone is found a scene has little. Without true paths, as of a measurement, all do.
    """
    enough: BoolArray = np.asarray(names != "")
    if not len(significant.stop):
        return enough
    for name in set(names[enough].tolist()):
        rows, lit = np.flatnonzero(names == name), shapely.points(significant.vertex_m[significant.object == name])
        away_m = np.min([shapely.distance(line_of(row), lit) for row in rows.tolist()], axis=0)
        enough[rows] = len(lit) >= FOUND_POINTS and (away_m <= FOUND_DISTANCE_M).mean() >= FOUND_SHARE_SEEN
    return enough


FOUND_KINDS: tuple[Literal["pillar", "wall"], ...] = ("pillar", "wall")


def visible_metrics(scene: Scene, significant: SignificantPaths) -> list[Metric]:
    """How many pillars and walls enough significant single bounces meet to be found, and how many meet each."""
    names, counts = np.unique(significant.object[significant.object != ""], return_counts=True)
    met = set(names[counts >= FOUND_POINTS].tolist())
    kinds = [item.kind for item in scene.fixtures if item.name in met]
    known = len(significant.stop) > 0
    metrics = [
        Metric(f"scene.visible.{kind}", kinds.count(kind) if known else np.nan, "1", "info")
        for kind in FOUND_KINDS
    ]
    met_by = dict(zip(names.tolist(), counts.tolist(), strict=True))
    for item in scene.fixtures:
        if item.kind in FOUND_KINDS:
            value = met_by.get(item.name, 0) if known else np.nan
            metrics.append(Metric(f"scene.single_bounces.{item.kind}.{item.name}", value, "1", "info"))
    return metrics


def is_compact(item: SceneObject) -> bool:
    """Whether the area of an object is observable; only one side of a wall is seen, so its thickness is not."""
    return item.contour.closed and item.kind != "wall"
