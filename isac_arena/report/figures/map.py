"""The maps of mapping and SLAM side by side, as in the paper's figure 3."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from estimation.slam.record import SolveStatus
from isac_arena.campaign.results import CampaignResults, MapResult
from isac_arena.report.figures.bands import Curve, contour_curve, line_m, shape_curve
from isac_arena.report.figures.object_names import Box
from isac_arena.report.figures.plan import draw_plan, plan_view
from isac_arena.report.style import (
    BAND_ALPHA,
    GHOST,
    SLAM,
    TRUTH,
    cluster_look,
    fill_area,
    legend_below,
    new_figure,
    styled,
)
from isac_arena.scoring.causes import LEVEL, LEVEL_WORDS, PHANTOM, RIGHT_SURFACE
from isac_arena.scoring.record import MapScores, PoseScores, ScoreTables
from scenes.record import FloatArray
from scenes.scene import Scene

WIDTH_IN = 12.0
AXES_WIDTH_IN = 5.5  # of one plan
SURROUND_IN = 1.6  # height of title, axis labels and legend
ROW_GAP_IN = 0.8
SMALL_SHARE = 0.6  # of the scene, in both directions: below it the part around the walk is shown as well
FAR_SHARE = 0.2  # of the scene: points farther outside are not shown
VIEW_MARGIN_M = 1.0
GHOST_LOOK: dict[str, Any] = {"color": GHOST, "marker": "x"}
LEVEL_LOOK: dict[str, Any] = {"color": GHOST, "marker": "_"}  # of what floor or ceiling scattered
PHANTOM_LOOK: dict[str, Any] = {"color": GHOST, "marker": "+"}
RIGHT_LOOK: dict[str, Any] = {"color": GHOST, "marker": "2"}  # of a ghost on a true surface
LOST_LOOK: dict[str, Any] = {
    "color": SLAM, "marker": "o", "markersize": 7, "markerfacecolor": "none", "markeredgewidth": 1.4,
    "linestyle": "none",
}  # fmt: skip
TRACK_COLOR = "#1e8449"  # of the walk in the plan


@styled()
def map_figure(scene: Scene, results: CampaignResults, tables: ScoreTables) -> Figure:
    """Incidence points and contours over the plan: receiver known (left) and unknown (right).

    The plan is that of the whole scene. Where the walk is a small part of it, a second row shows the part around
    the walk. A map with contours of ours shows them with filled bands, gives the points their colours and draws
    the paper's contours dashed. A map without them shows the paper's contours with filled bands.
    """
    maps = [results.mapping, results.slam]
    views = [whole_view(scene, maps)]
    near = plan_view(scene, "walk")
    if max((near[2] - near[0]) / _width(views[0]), (near[3] - near[1]) / _height(views[0])) < SMALL_SHARE:
        views.append(near)
    tall = [_height(view) / _width(view) for view in views]
    figure = new_figure(WIDTH_IN, AXES_WIDTH_IN * sum(tall) + SURROUND_IN + ROW_GAP_IN * (len(views) - 1))
    grid = figure.subplots(len(views), 2, sharex="row", sharey="row", squeeze=False, height_ratios=tall)
    for (left, right), view in zip(grid, views, strict=True):
        for ax, result, scores in ((left, results.mapping, tables.mapping), (right, results.slam, tables.slam)):
            draw_plan(ax, scene, stops=tables.poses.stop.tolist(), labels=False, extent="all")
            if ax is right:
                _draw_track(ax, results, tables.poses)
            _draw_map(ax, result, scores)
            ax.set(xlim=view[::2], ylim=view[1::2])
        right.set_ylabel("")
    grid[0, 0].set_title("Mapping: receiver pose and clock known")
    is_given = bool((results.slam.poses.status == SolveStatus.GIVEN).all())
    grid[0, 1].set_title(f"SLAM: receiver pose and clock {'those of nodes' if is_given else 'unknown'}")
    for ax, result in zip(grid[0], maps, strict=True):
        if not len(result.contours) and len(result.shapes.center_m):
            ax.set_title(f"{ax.get_title()}\nno contours of ours; those of the published method in colour")
    if len(views) > 1:
        for ax in grid[1]:
            ax.set_title("the same around the walk")
    has_lost = bool((tables.poses.status == SolveStatus.FAILED).any())
    legend_below(figure, _legend_handles(has_others=bool(scene.other_txs), has_lost=has_lost), 5)
    return figure


def whole_view(scene: Scene, maps: Sequence[MapResult]) -> Box:
    """The scene with all clustered incidence points and contours, unless they lie far outside of it."""
    x_min, y_min, x_max, y_max = view = plan_view(scene, "all")
    drawn = [(one.ips.position_m[one.shapes.label >= 0], one.contours.contour_m.reshape(-1, 2)) for one in maps]
    points = np.vstack([points for pair in drawn for points in pair])
    low, high, size = np.array([x_min, y_min]), np.array([x_max, y_max]), np.array([_width(view), _height(view)])
    near = np.clip(points, low - FAR_SHARE * size, high + FAR_SHARE * size)
    low, high = (
        np.vstack([near - VIEW_MARGIN_M, low]).min(axis=0),
        np.vstack([near + VIEW_MARGIN_M, high]).max(axis=0),
    )
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _width(view: Box) -> float:
    return view[2] - view[0]


def _height(view: Box) -> float:
    return view[3] - view[1]


def _draw_map(ax: Any, result: MapResult, scores: MapScores) -> None:
    """Draw incidence points and contours; points without object and ghosts are grey."""
    ips, shapes, contours = result.ips, result.shapes, result.contours
    paper = [shape_curve(shapes, cluster) for cluster in range(len(shapes.center_m))]
    curves, label, table = paper, shapes.label, scores.clusters
    if len(contours):
        for curve in paper:
            line = line_m(curve.points_m, is_closed=curve.is_closed)
            ax.plot(*line.T, color=TRUTH, linewidth=0.8, linestyle="--", zorder=2.6)
        curves = [contour_curve(contours, row) for row in range(len(contours))]
        label, table = contours.object, scores.contours
    ax.plot(*ips.position_m[ips.is_inlier & (label < 0)].T, ".", color=GHOST, markersize=3.5, zorder=3)
    looks = [
        LEVEL_LOOK if name in LEVEL
        else RIGHT_LOOK if right
        else GHOST_LOOK if ghost
        else PHANTOM_LOOK if false
        else cluster_look(row)
        for row, (name, right, ghost, false) in enumerate(
            zip(table.object.tolist(), table.is_right_surface, table.is_ghost, table.is_false, strict=True)
        )
    ]  # fmt: skip
    draw_contours(ax, curves, [ips.position_m[label == row] for row in range(len(curves))], looks)


def draw_contours(
    ax: Any, curves: Sequence[Curve], points_m: Sequence[FloatArray] | None, looks: Sequence[dict[str, Any]]
) -> None:
    """Draw numbered contours with their bands and, where given, the points (ip, xy) that each was fitted to."""
    for row, curve in enumerate(curves):
        _draw_curve(ax, curve, np.zeros((0, 2)) if points_m is None else points_m[row], row, looks[row])


def _draw_curve(ax: Any, curve: Curve, points_m: FloatArray, row: int, look: dict[str, Any]) -> None:
    edge = {} if look["color"] == GHOST else {"markeredgecolor": "white", "markeredgewidth": 0.4}
    ax.plot(*points_m.T, linestyle="none", markersize=3.8, zorder=4, **look, **edge)
    line, outer, inner = (
        line_m(points, is_closed=curve.is_closed) for points in (curve.points_m, curve.outer_m, curve.inner_m)
    )
    band = np.concatenate([outer, inner[::-1]])
    fill_area(ax, band, color=look["color"], alpha=BAND_ALPHA, linewidth=0, zorder=2.5)
    ax.plot(*line.T, color=look["color"], linewidth=1.4, zorder=5)
    ax.annotate(
        str(row), curve.points_m.mean(axis=0), xytext=(7, 7), textcoords="offset points", ha="center",
        va="center", fontsize=8, fontweight="bold", color=TRUTH, zorder=6, annotation_clip=True,
        path_effects=[patheffects.withStroke(linewidth=2.5, foreground="white")],
    )  # fmt: skip


def _draw_track(ax: Any, results: CampaignResults, poses: PoseScores) -> None:
    """Draw the estimated positions, each with a thin line to the true one, and where stops were not located."""
    row = {int(stop): position for position, stop in enumerate(results.slam.poses.stop)}
    estimate = results.slam.poses.position_m[[row[int(stop)] for stop in poses.stop]]
    ax.plot(*poses.true_position_m[poses.status == SolveStatus.FAILED].T, **LOST_LOOK, zorder=4)
    ties = np.stack([poses.true_position_m, estimate, np.full_like(estimate, np.nan)], axis=1).reshape(-1, 2)
    ax.plot(*ties.T, color=SLAM, linewidth=0.8, zorder=3)
    ax.plot(*estimate.T, "+", color=SLAM, markersize=6, markeredgewidth=1.4, zorder=4)


def object_handles() -> list[Any]:
    """Entries of a legend for the points and the contour of an object, in a colour that stands for all."""
    return [
        Line2D([], [], marker="o", linestyle="none", color="0.45", label="incidence points of an object"),
        Patch(facecolor="0.85", edgecolor="0.45", label="contour with its number, 95 % interval"),
    ]


def _legend_handles(*, has_others: bool, has_lost: bool) -> list[Any]:
    other = Line2D([], [], marker="D", linestyle="none", color="0.55", markerfacecolor="white", label="other TX")
    return [
        Line2D([], [], marker="D", linestyle="none", color="black", markersize=5, label="TX, boresight"),
        Line2D([], [], marker="o", color=TRACK_COLOR, markersize=3.5, linewidth=0.8, label="true RX stops"),
        Line2D([], [], marker="+", linestyle="none", color=SLAM, markeredgewidth=1.4, label="RX by SLAM"),
        *([Line2D([], [], label="stop that SLAM did not locate", **LOST_LOOK)] if has_lost else []),
        *object_handles(),
        Line2D([], [], color=TRUTH, linewidth=0.8, linestyle="--", label="published method"),
        Line2D([], [], linestyle="none", label="ghost", **GHOST_LOOK),
        Line2D([], [], linestyle="none", label=f"{PHANTOM}: no object is there", **PHANTOM_LOOK),
        Line2D([], [], linestyle="none", label=RIGHT_SURFACE, **RIGHT_LOOK),
        Line2D([], [], linestyle="none", label=LEVEL_WORDS, **LEVEL_LOOK),
        Line2D([], [], marker=".", linestyle="none", color=GHOST, label="incidence point of no object"),
        *([other] if has_others else []),
    ]
