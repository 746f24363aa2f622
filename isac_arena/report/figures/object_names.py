"""Names of the objects in a plan, each where it stands by its own outline and covers nothing."""

from typing import Any

import numpy as np
import shapely
from matplotlib import patheffects

from scenes.objects.clutter import Clutter
from scenes.objects.scene_object import KIND_COLORS
from scenes.scene import Scene, SceneObject

BORESIGHT_LENGTH_M = 1.5
TX_LABEL_PT = 11.0  # behind the TX
OBJECT_LABEL_PT = 6.5
LABEL_GAP_PT = 2.5
ALONG = (0.25, 0.75, 0.1, 0.9)  # of a side: places of a name where others are near its middle

Box = tuple[float, float, float, float]  # x_min, y_min, x_max, y_max


def write_names(ax: Any, scene: Scene, view: Box) -> None:
    """Write names beside the objects in view, where they fit in the view and cover no stop and no other name."""
    ax.apply_aspect()
    to_points = 72 / ax.figure.dpi
    frame = shapely.box(*view)
    limits = tuple(ax.transData.transform(np.reshape(view, (2, 2))).ravel() * to_points)
    taken: list[Box] = [
        (x - 5, y - 5, x + 5, y + 5)
        for x, y in ax.transData.transform(scene.walk.positions_m()[:, :2]) * to_points
    ]
    tx, ahead = scene.tx.position_m[:2], np.array([np.cos(scene.tx.heading_rad), np.sin(scene.tx.heading_rad)])
    ends = ax.transData.transform([tx, tx + BORESIGHT_LENGTH_M * ahead]) * to_points
    for x, y in (ends[0] - TX_LABEL_PT * ahead, *np.linspace(ends[0], ends[1], 5)):
        taken.append((x - 8, y - 8, x + 8, y + 8))
    named: list[tuple[SceneObject | Clutter, Any]] = [(item, item.contour.outline) for item in scene.objects]
    named += [(mesh, shapely.MultiPoint(mesh.vertices_m[:, :2]).convex_hull) for mesh in scene.clutter]
    in_view = [(item, shapely.intersection(outline, frame)) for item, outline in named]
    drawn = [(item, _in_points(ax, seen)) for item, seen in in_view if not seen.is_empty and seen.length]
    for item, outline in drawn:
        others = shapely.union_all([other for one, other in drawn if one is not item])
        center_pt, box = _free_place(outline, others, len(item.name), taken, limits)
        taken.append(box)
        label = ax.text(
            *ax.transData.inverted().transform(np.array(center_pt) / to_points), item.name,
            fontsize=OBJECT_LABEL_PT, color=KIND_COLORS[item.kind], ha="center", va="center",
            path_effects=halo(), clip_on=True,
        )  # fmt: skip
        label.set_in_layout(False)


def _in_points(ax: Any, outline: shapely.Geometry) -> shapely.Geometry:
    """An outline in points of the figure."""
    scale = 72 / ax.figure.dpi
    return shapely.transform(outline, lambda place_m: ax.transData.transform(place_m) * scale)


def _free_place(
    outline: shapely.Geometry, others: shapely.Geometry, n_letters: int, taken: list[Box], limits_pt: Box
) -> tuple[tuple[float, float], Box]:
    """Centre and box in points of a name beside an outline in points.

    It is the first free place that is not nearer to the other outlines, else the first free one, or the first
    place of all where none is free. Tall narrow outlines are labelled at their sides first, all others above or
    below.
    """
    half_width, half_height = 0.32 * OBJECT_LABEL_PT * n_letters, 0.6 * OBJECT_LABEL_PT
    left, low, right, high = outline.bounds
    mid_x, mid_y = (left + right) / 2, (low + high) / 2
    x_left, x_right = left - half_width - LABEL_GAP_PT, right + half_width + LABEL_GAP_PT
    y_low, y_high = low - half_height - LABEL_GAP_PT, high + half_height + LABEL_GAP_PT
    sides, ends = [(x_right, mid_y), (x_left, mid_y)], [(mid_x, y_high), (mid_x, y_low)]
    upright = high - low > 2 * (right - left)
    places = [*(sides + ends if upright else ends + sides)]
    places += [(x, y) for x in (x_right, x_left) for y in (y_high, y_low)]
    places += [(x, low + share * (high - low)) for x in (x_right, x_left) for share in ALONG]
    places += [(left + share * (right - left), y) for y in (y_high, y_low) for share in ALONG]
    boxes = [(x - half_width, y - half_height, x + half_width, y + half_height) for x, y in places]
    free = [
        index
        for index, box in enumerate(boxes)
        if _inside(box, limits_pt) and not any(overlaps(box, other) for other in taken)
    ]
    own = [index for index in free if _is_nearer(shapely.box(*boxes[index]), outline, others)]
    chosen = next(iter([*own, *free, 0]))
    return places[chosen], boxes[chosen]


def _is_nearer(box: shapely.Geometry, outline: shapely.Geometry, others: shapely.Geometry) -> bool:
    """Whether a name is nearer to its own outline than to the others."""
    return others.is_empty or bool(box.distance(outline) < box.distance(others))


def overlaps(box: Box, other: Box) -> bool:
    """Whether two boxes have points in common."""
    return box[0] < other[2] and other[0] < box[2] and box[1] < other[3] and other[1] < box[3]


def _inside(box: Box, limits: Box) -> bool:
    return limits[0] <= box[0] and limits[1] <= box[1] and box[2] <= limits[2] and box[3] <= limits[3]


def halo() -> list[Any]:
    """White around letters."""
    return [patheffects.withStroke(linewidth=2, foreground="white")]
