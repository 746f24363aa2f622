"""The maps of mapping and SLAM side by side, as in the paper's figure 3."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from isac_arena.campaign.results import CampaignResults, MapResult
from isac_arena.report.figures.bands import Curve, contour_curve, line_m, shape_curve
from isac_arena.report.figures.plan import draw_plan
from isac_arena.report.style import BAND_ALPHA, GHOST, SLAM, TRUTH, cluster_look, legend_below, new_figure, styled
from isac_arena.scoring.record import MapScores, PoseScores, ScoreTables
from scenes.record import FloatArray
from scenes.scene import Scene

WIDTH_IN = 12.0
AXES_WIDTH_IN = 5.5  # of one plan
SURROUND_IN = 1.15  # height of title, axis labels and legend
VIEW_MARGIN_M = 1.0
TRACK_COLOR = "#1e8449"  # of the walk in the plan


@styled
def map_figure(scene: Scene, results: CampaignResults, tables: ScoreTables) -> Figure:
    """Incidence points and contours over the plan: receiver known (left) and unknown (right).

    A map with contours of ours shows them with filled bands, gives the points their colours and draws the paper's
    contours dashed. A map without them shows the paper's contours with filled bands.
    """
    figure = new_figure(WIDTH_IN, WIDTH_IN / 2)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    stops = tables.poses.stop.tolist()
    draw_plan(axes[0], scene, stops=stops, labels=False)
    axes[0].set_title("Mapping: receiver pose and clock known")
    _draw_map(axes[0], results.mapping, tables.mapping)
    draw_plan(axes[1], scene, stops=stops, labels=False)
    axes[1].set(title="SLAM: receiver pose and clock unknown", ylabel="")
    _draw_track(axes[1], results, tables.poses)
    _draw_map(axes[1], results.slam, tables.slam)
    _fit(figure, axes[0], [results.mapping, results.slam])
    legend_below(figure, _legend_handles(), 8)
    return figure


def _fit(figure: Figure, ax: Any, maps: list[MapResult]) -> None:
    """Extend the view to all clustered incidence points and set the height of the figure to match it."""
    points = np.vstack([one.ips.position_m[one.shapes.label >= 0] for one in maps])
    low = np.array([ax.get_xlim()[0], ax.get_ylim()[0]])
    high = np.array([ax.get_xlim()[1], ax.get_ylim()[1]])
    if len(points):
        low = np.minimum(low, points.min(axis=0) - VIEW_MARGIN_M)
        high = np.maximum(high, points.max(axis=0) + VIEW_MARGIN_M)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    width, height = high - low
    figure.set_size_inches(WIDTH_IN, AXES_WIDTH_IN * height / width + SURROUND_IN)


def _draw_map(ax: Any, result: MapResult, scores: MapScores) -> None:
    """Draw incidence points and contours; points without object and ghosts are grey."""
    ips, shapes, contours = result.ips, result.shapes, result.contours
    paper = [shape_curve(shapes, cluster) for cluster in range(len(shapes.center_m))]
    curves, label, is_ghost = paper, shapes.label, scores.clusters.is_ghost
    if len(contours):
        for curve in paper:
            line = line_m(curve.points_m, is_closed=curve.is_closed)
            ax.plot(*line.T, color=TRUTH, linewidth=0.8, linestyle="--", zorder=2.6)
        curves = [contour_curve(contours, row) for row in range(len(contours))]
        label, is_ghost = contours.object, scores.contours.is_ghost
    ax.plot(*ips.position_m[ips.is_inlier & (label < 0)].T, ".", color=GHOST, markersize=3.5, zorder=3)
    looks = [{"color": GHOST, "marker": "x"} if ghost else cluster_look(row) for row, ghost in enumerate(is_ghost)]
    draw_contours(ax, curves, [ips.position_m[label == row] for row in range(len(curves))], looks)


def draw_contours(
    ax: Any, curves: Sequence[Curve], points_m: Sequence[FloatArray] | None, looks: Sequence[dict[str, Any]]
) -> None:
    """Draw numbered contours with their bands and, where given, the points (ip, xy) that each was fitted to."""
    for row, curve in enumerate(curves):
        _draw_curve(ax, curve, np.zeros((0, 2)) if points_m is None else points_m[row], row, looks[row])


def _draw_curve(ax: Any, curve: Curve, points_m: FloatArray, row: int, look: dict[str, Any]) -> None:
    edge = {} if look["marker"] == "x" else {"markeredgecolor": "white", "markeredgewidth": 0.4}
    ax.plot(*points_m.T, linestyle="none", markersize=3.8, zorder=4, **look, **edge)
    line, outer, inner = (
        line_m(points, is_closed=curve.is_closed) for points in (curve.points_m, curve.outer_m, curve.inner_m)
    )
    band = np.concatenate([outer, inner[::-1]])
    ax.fill(*band.T, color=look["color"], alpha=BAND_ALPHA, linewidth=0, zorder=2.5)
    ax.plot(*line.T, color=look["color"], linewidth=1.4, zorder=5)
    ax.annotate(
        str(row), curve.points_m.mean(axis=0), xytext=(7, 7), textcoords="offset points", ha="center",
        va="center", fontsize=8, fontweight="bold", color=TRUTH, zorder=6, annotation_clip=True,
        path_effects=[patheffects.withStroke(linewidth=2.5, foreground="white")],
    )  # fmt: skip


def _draw_track(ax: Any, results: CampaignResults, poses: PoseScores) -> None:
    """Draw the estimated positions; a thin line connects each one to the true position."""
    row = {int(stop): position for position, stop in enumerate(results.slam.poses.stop)}
    estimate = results.slam.poses.position_m[[row[int(stop)] for stop in poses.stop]]
    ties = np.stack([poses.true_position_m, estimate, np.full_like(estimate, np.nan)], axis=1).reshape(-1, 2)
    ax.plot(*ties.T, color=SLAM, linewidth=0.8, zorder=3)
    ax.plot(*estimate.T, "+", color=SLAM, markersize=6, markeredgewidth=1.4, zorder=4)


def _legend_handles() -> list[Any]:
    return [
        Line2D([], [], marker="D", linestyle="none", color="black", markersize=5, label="TX, boresight"),
        Line2D([], [], marker="o", color=TRACK_COLOR, markersize=3.5, linewidth=0.8, label="true RX stops"),
        Line2D([], [], marker="+", linestyle="none", color=SLAM, markeredgewidth=1.4, label="RX by SLAM"),
        Line2D([], [], marker="o", linestyle="none", color="0.45", label="IPs of an object"),
        Patch(facecolor="0.85", edgecolor="0.45", label="its contour, 95 % interval"),
        Line2D([], [], color=TRUTH, linewidth=0.8, linestyle="--", label="the paper's contours"),
        Line2D([], [], marker="x", linestyle="none", color=GHOST, label="ghost"),
        Line2D([], [], marker=".", linestyle="none", color=GHOST, label="IP of no object"),
    ]
