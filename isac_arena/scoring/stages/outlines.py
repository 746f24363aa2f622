"""Outlines and the objects that they show: the columns of both the paper's shapes and our contours."""

from collections.abc import Callable
from dataclasses import astuple, fields
from typing import Any

import numpy as np

from isac_arena.campaign.results import MapResult
from isac_arena.scoring.causes import cluster_causes
from isac_arena.scoring.metrics.statistics import rows_of_groups
from isac_arena.scoring.provenance import cluster_origin
from isac_arena.scoring.record import IpScores, SignificantPaths
from isac_arena.scoring.stages.maps import FOUND_POINTS, close_counts, is_ghost
from isac_arena.scoring.stages.shapes import ShapeErrors
from scenes.record import FloatArray
from scenes.scene import Scene, SceneObject

ErrorOf = Callable[[int, SceneObject, FloatArray, FloatArray], ShapeErrors]


def outline_columns(
    scene: Scene, result: MapResult, ips: IpScores, n_rows: int, significant: SignificantPaths, error_of: ErrorOf
) -> dict[str, Any]:
    """Columns (row,) by name: the object of each row, its purity and counts, and the errors of the row.

    `ips.label` (ip,) is the row of each incidence point, -1 for none. `error_of` takes the row, its object, the
    points of the row (ip, xy) and the true incidence points on the object (point, xy) over the whole campaign.
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
        "is_found": np.asarray((origin.object != "") & (n_close >= FOUND_POINTS)),
        "is_ghost": ghost,
        "cause": cluster_causes(ips.label, ips.object, ips.cause, ghost),
        **{field.name: column for field, column in zip(fields(ShapeErrors), columns, strict=True)},
    }


def is_compact(item: SceneObject) -> bool:
    """Whether the area of an object is observable; only one side of a wall is seen, so its thickness is not."""
    return item.contour.closed and item.kind != "wall"
