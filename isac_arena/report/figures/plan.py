"""Plan of a scene: objects by kind, the TX with its boresight, the walk of the RX, paths to a stop."""

from collections.abc import Iterable
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from isac_arena.report.figures.object_names import (
    BORESIGHT_LENGTH_M,
    TX_LABEL_PT,
    Box,
    halo,
    overlaps,
    write_names,
)
from isac_arena.report.figures.path_lines import (
    COLORS,
    SCATTER_COLOR,
    line_style,
    path_lines,
    path_summary,
    scatter_points,
)
from isac_arena.report.style import fill_area
from scenes.objects.clutter import Clutter
from scenes.objects.scene_object import KIND_COLORS
from scenes.record import FloatArray
from scenes.scene import Scene, SceneObject
from sim.propagation.paths import Paths

KIND_WORDS = {"clutter": "mesh"}  # in legends, where they are not the name of the kind
RX_COLOR = "#1e8449"
FIGURE_WIDTH_IN, PLAN_WIDTH_IN, MARGIN_IN = 10.5, 8.4, 0.9
DRAWN_SAGITTA_M = 0.002
CROP_MARGIN_M = 5.0
EDGE_MARGIN_M = 0.5
STOP_LABEL_STEP = 5
LABEL_OFFSET_PT = 8.5
MOST_NAMES = 40  # of objects: more would cover the plan


def plan_figure(
    scene: Scene, *, extent: Literal["walk", "all"] = "walk", paths: Paths | None = None, stop: int | None = None
) -> Figure:
    """The plan of a scene as a figure, with `paths` over it: those from the TX to the RX at `stop`."""
    x_min, y_min, x_max, y_max = plan_view(scene, extent)
    height_in = PLAN_WIDTH_IN * (y_max - y_min) / (x_max - x_min) + MARGIN_IN
    figure = Figure(figsize=(FIGURE_WIDTH_IN, float(np.clip(height_in, 3.0, 8.0))), layout="compressed")
    ax = figure.subplots()
    title = scene.name
    if paths is not None and stop is not None:
        draw_paths(ax, scene, paths, scene.walk.positions_m()[stop])
        title = f"{scene.name}, stop {stop}: {path_summary(paths)}"
    draw_plan(ax, scene, extent=extent, label_objects=len(scene.objects) <= MOST_NAMES)
    ax.set_title(title, fontsize=11, weight="bold")
    return figure


def draw_plan(
    ax: Any,
    scene: Scene,
    *,
    stops: Iterable[int] | None = None,
    labels: bool = True,
    extent: Literal["walk", "all"] = "walk",
    label_objects: bool = False,
) -> None:
    """Draw the plan of a scene on matplotlib axes in m, with equal scales.

    The legend is to the right of the axes: a figure with layout='compressed' makes room for it.

    Parameters
    ----------
    stops : indices of the RX stops to show; all by default
    labels : number every fifth stop, name the TX and add the legend outside the axes
    extent : 'walk' crops to the walk and the TX with a margin, 'all' shows the bounds of the scene
    label_objects : write the names of the objects and meshes in view
    """
    view = plan_view(scene, extent)
    for item in scene.objects:
        _draw_object(ax, item)
    for mesh in scene.clutter:
        _draw_clutter(ax, mesh)
    _draw_others(ax, scene, labels=labels)
    _draw_walk(ax, scene, stops, labels=labels)
    _draw_tx(ax, scene, labels=labels)
    ax.set(xlim=view[::2], ylim=view[1::2], aspect="equal", xlabel="x in m", ylabel="y in m")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(integer=True))
    ax.grid(color="0.92", linewidth=0.6)
    ax.set_axisbelow(True)
    if label_objects:
        write_names(ax, scene, view)
    if labels:
        draw_legend(ax, scene, view)


def plan_view(scene: Scene, extent: Literal["walk", "all"]) -> Box:
    """The part of a scene that is shown: (x_min, y_min, x_max, y_max) in m."""
    meshes = [np.ravel([corner[:2] for corner in item.bounds_m]) for item in scene.clutter]
    boxes = np.array([scene.bounds_m, *(item.contour.bounds_m for item in scene.objects), *meshes])
    low, high = boxes[:, :2].min(axis=0) - EDGE_MARGIN_M, boxes[:, 2:].max(axis=0) + EDGE_MARGIN_M
    if extent == "walk":
        points = np.vstack([scene.walk.line_m(), scene.tx.position_m[:2]])
        low = np.maximum(points.min(axis=0) - CROP_MARGIN_M, low)
        high = np.minimum(points.max(axis=0) + CROP_MARGIN_M, high)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _draw_object(ax: Any, item: SceneObject) -> None:
    color, outline = KIND_COLORS[item.kind], item.contour.vertices(DRAWN_SAGITTA_M)
    if item.contour.closed:
        fill_area(ax, outline, facecolor=color, alpha=0.35, linewidth=0)
        fill_area(ax, outline, facecolor="none", edgecolor=color, linewidth=1.2)
    else:
        ax.plot(*outline.T, color=color, linewidth=1.8, solid_capstyle="round")


def _draw_clutter(ax: Any, mesh: Clutter) -> None:
    color = KIND_COLORS[mesh.kind]
    for outline in mesh.plan_outlines_m:
        fill_area(ax, outline, facecolor=color + "59", edgecolor=color, linewidth=1.0)


def _draw_others(ax: Any, scene: Scene, *, labels: bool) -> None:
    """Draw the TXs and walks that are not in use in grey."""
    for name, walk in scene.other_walks.items():
        line = walk.line_m()
        ax.plot(*line.T, color="0.55", linewidth=0.8, linestyle=":")
        ax.plot(*walk.positions_m()[:, :2].T, "o", color="0.55", markersize=2)
        if labels:
            _write(ax, name, line[0], (0, -9))
    for name, tx in scene.other_txs.items():
        ax.plot(*tx.position_m[:2], "D", color="0.55", markerfacecolor="white", markersize=6)
        if labels:
            middle_m = (scene.bounds_m[1] + scene.bounds_m[3]) / 2
            _write(ax, name, tx.position_m[:2], (0, 10 if tx.position_m[1] > middle_m else -10))


def _write(ax: Any, text: str, place_m: FloatArray, offset_pt: tuple[float, float]) -> None:
    ax.annotate(
        text, place_m[:2], xytext=offset_pt, textcoords="offset points", fontsize=7, color="0.35",
        ha="center", va="center", path_effects=halo(),
    )  # fmt: skip


def draw_paths(ax: Any, scene: Scene, paths: Paths, here: FloatArray) -> None:
    """Draw the paths from the TX to the RX at `here` (xyz,), before the plan."""
    scattered = scatter_points(paths)
    if len(scattered):
        ax.plot(*scattered[:, :2].T, "o", color=SCATTER_COLOR, markersize=1.0, alpha=0.4, zorder=2.1)
    kinds = set()
    for line in path_lines(paths, scene.tx.position_m, here):
        kinds.add(line.kind)
        ax.plot(
            *line.points_m[:, :2].T, color=COLORS[line.kind], linestyle=line_style(line.kind),
            alpha=line.opacity, linewidth=0.9, zorder=2.2,
        )  # fmt: skip
    for kind, color in COLORS.items():
        if kind in kinds:
            ax.plot([], [], color=color, linestyle=line_style(kind), label=kind)
    if len(scattered):
        ax.plot([], [], "o", color=SCATTER_COLOR, markersize=3, label="diffuse scattering", linestyle="none")
    ax.plot(*here[:2], "o", color=RX_COLOR, markersize=9, markerfacecolor="none", markeredgewidth=1.6)


def _draw_walk(ax: Any, scene: Scene, stops: Iterable[int] | None, *, labels: bool) -> None:
    position, heading = scene.walk.positions_m()[:, :2], scene.walk.headings_rad()
    chosen = np.arange(len(position)) if stops is None else np.array(sorted(stops), dtype=int)
    ax.plot(*scene.walk.line_m().T, color=RX_COLOR, linewidth=0.8, alpha=0.5)
    ax.plot(*position[chosen].T, "o", color=RX_COLOR, markersize=3.5, label="RX stop")
    if not labels:
        return
    numbered = [index for index in chosen if index % STOP_LABEL_STEP == 0 or index == chosen[-1]]
    for index in numbered:
        offset = _label_offset(position, heading, index)
        ax.annotate(
            str(index), position[index], xytext=offset, textcoords="offset points", fontsize=7,
            color="#145a32", ha="center", va="center", path_effects=halo(),
        )  # fmt: skip


def _label_offset(position: FloatArray, heading: FloatArray, index: int) -> FloatArray:
    """Offset (xy) in points to the left of the walk, where the label covers no other stop."""
    before, after = position[max(index - 1, 0)], position[min(index + 1, len(position) - 1)]
    along = after - before
    if not np.any(along):
        along = np.array([np.cos(heading[index]), np.sin(heading[index])])
    along = along / np.linalg.norm(along)
    return LABEL_OFFSET_PT * np.array([-along[1], along[0]])


def _draw_tx(ax: Any, scene: Scene, *, labels: bool) -> None:
    here = scene.tx.position_m[:2]
    boresight = np.array([np.cos(scene.tx.heading_rad), np.sin(scene.tx.heading_rad)])
    tip = here + BORESIGHT_LENGTH_M * boresight
    arrow = {"arrowstyle": "-|>", "color": "black", "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", tip, xytext=here, arrowprops=arrow)
    ax.plot(*here, "D", color="black", markersize=6, label="TX, arrow: boresight", linestyle="none")
    if labels:
        ax.annotate(
            "TX", here, xytext=-TX_LABEL_PT * boresight, textcoords="offset points", fontsize=9, weight="bold",
            ha="center", va="center", path_effects=halo(),
        )  # fmt: skip


def kind_patches(kinds: set[str]) -> list[Patch]:
    """Entries of a legend for the kinds of objects given, in the order of `KIND_COLORS`."""
    return [
        Patch(facecolor=color + "59", edgecolor=color, label=KIND_WORDS.get(kind, kind))
        for kind, color in KIND_COLORS.items() if kind in kinds
    ]  # fmt: skip


def draw_legend(ax: Any, scene: Scene | None, view: Box | None = None, more: Iterable[Any] = ()) -> None:
    """Add a legend to the right of the axes: kinds of objects in view, all with a label, and `more` handles.

    What a legend of the axes shows already stays in it.
    """
    objects = () if scene is None else scene.objects
    kinds: set[str] = {item.kind for item in objects if view is None or overlaps(item.contour.bounds_m, view)}
    kinds |= set() if scene is None else {item.kind for item in scene.clutter}
    before, handles = ax.get_legend(), {}
    if before is not None:
        handles = {text.get_text(): one for text, one in zip(before.texts, before.legend_handles, strict=True)}
    handles |= {one.get_label(): one for one in kind_patches(kinds)}
    handles |= {label: one for one, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    handles |= {one.get_label(): one for one in more}
    ax.legend(
        handles.values(), handles.keys(), loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0,
        fontsize=8, frameon=False,
    )  # fmt: skip
