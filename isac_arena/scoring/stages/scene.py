"""The scene as a whole: all closed outlines of a map against all compact objects that paths met."""

from collections.abc import Sequence

import numpy as np

from isac_arena.campaign.results import MapResult
from isac_arena.scoring.metrics.contours import scene_gospa
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.record import ContourScores, OutlineScores, SceneScores, SignificantPaths
from isac_arena.scoring.stages.outlines import is_compact
from isac_arena.scoring.stages.shapes import contour_points_m
from scenes.record import FloatArray
from scenes.scene import Scene

METHODS = ("shapes", "contours")  # the paper's and ours, in the order of the rows


def score_scene(
    scene: Scene,
    result: MapResult,
    clusters: OutlineScores,
    contours: ContourScores,
    significant: SignificantPaths,
) -> SceneScores:
    """Scene-level GOSPA of the paper's shapes and of our contours.

    Outlines of walls and other open objects are excluded, because the thickness of an object that is seen from
    one side is unobservable; a phantom is false, whatever its paths come from. An open contour of a compact object
    has no area: it counts as false and its object as missed. Other open contours and those of meshes are left out.
    """
    compact = [item for item in scene.fixtures if is_compact(item)]
    lit = [item for item in compact if (significant.object == item.name).any()]
    truths = [np.asarray(item.contour.outline.coords)[:-1] for item in lit]
    left_out = [
        *(item.name for item in scene.fixtures if not is_compact(item)),
        *(mesh.name for mesh in scene.clutter),
    ]
    with_area = np.flatnonzero(~np.isin(clusters.object, left_out)).tolist()
    shapes = [contour_points_m(result.shapes, row) for row in with_area]
    is_closed, of_compact = result.contours.is_closed, np.isin(contours.object, [item.name for item in compact])
    closed = is_closed & (contours.is_phantom | ~np.isin(contours.object, left_out))
    ours = [
        result.contours.contour_m[row] if is_closed[row] else result.contours.contour_m[row][:1].repeat(3, axis=0)
        for row in np.flatnonzero(closed | (of_compact & ~is_closed))
    ]
    rows = [_row(estimates, truths) for estimates in (shapes, ours)]
    return SceneScores(np.array(METHODS), *np.array(rows).T)


def scene_metrics(map_name: str, table: SceneScores) -> list[Metric]:
    """Scene GOSPA of both methods, and its parts."""
    metrics = []
    for row, method in enumerate(table.method):
        prefix = f"{method}.{map_name}.scene_gospa"
        metrics.append(Metric(prefix, table.gospa[row], "1", "lower"))
        for part in ("localisation", "missed", "false"):
            metrics.append(Metric(f"{prefix}.{part}", getattr(table, part)[row], "1", "info"))
    return metrics


def _row(estimates_m: Sequence[FloatArray], truths_m: Sequence[FloatArray]) -> list[float]:
    distance = scene_gospa(estimates_m, truths_m)
    return [distance.value, distance.localisation, distance.missed, distance.false]
