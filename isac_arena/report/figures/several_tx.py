"""Bounds of positions and outlines over the plan, and which TX lights which part of every pillar."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from isac_arena.insight.bounds.several_tx import SeveralTx, WalkBounds, lit_samples
from isac_arena.report.figures.bound import COLOR_MAP, log_axis, log_scale
from isac_arena.report.figures.by_tx import TX_COLORS, offset_outline
from isac_arena.report.figures.plan import draw_plan, plan_view
from isac_arena.report.style import legend_below, new_figure, styled
from scenes.pose import Pose
from scenes.record import FloatArray

OFFSET_M = 0.15  # of the line of a TX from the outline, times its number
HEADING_M = 0.8  # of the line that shows where a TX looks


@styled()
def several_tx_figure(
    several: SeveralTx,
    chosen: Sequence[int],
    bounds: WalkBounds,
    candidates: Sequence[Pose] = (),
    title: str = "expected errors",
) -> Figure:
    """Stops and outlines of pillars in the colour of their bounds; beside an outline the TX that light it.

    `chosen` are the rows of the TX, `candidates` the places of those that were not chosen.
    """
    scene = several.scene
    x_min, y_min, x_max, y_max = plan_view(scene, "all")
    figure = new_figure(9.5, float(np.clip(8.0 * (y_max - y_min) / (x_max - x_min) + 1.4, 4.0, 9.0)))
    ax = figure.subplots()
    alone = replace(scene, tx=several.walks[chosen[0]].tx, other_txs={}, other_walks={})
    draw_plan(ax, alone, stops=(), labels=False, extent="all")
    every = np.concatenate([bounds.position_m, bounds.contours.outline_m])
    scale = log_scale(every[np.isfinite(every)])
    for pose in candidates:
        _draw_tx(ax, pose, {"color": "#bbbbbb", "markersize": 4.0, "zorder": 5.5})
    handles = []
    for number, row in enumerate(chosen):
        walk, color = several.walks[row], TX_COLORS[number % len(TX_COLORS)]
        _draw_tx(ax, walk.tx, {"color": color, "markeredgecolor": "black", "markersize": 8.0, "zorder": 7})
        handles.append(Line2D([], [], marker="D", color=color, markeredgecolor="black", label=walk.name))
        for outline, points in zip(several.outline_m, walk.point_m, strict=True):
            line = offset_outline(outline, OFFSET_M * (number + 1))
            line[~lit_samples(outline, points)] = np.nan
            ax.plot(*line.T, color=color, linewidth=2.0, zorder=6)
    _draw_errors(figure, ax, several, bounds, scale)
    ax.set_title(title)
    legend_below(figure, handles, min(len(handles), 4))
    return figure


def _draw_errors(figure: Figure, ax: Any, several: SeveralTx, bounds: WalkBounds, scale: LogNorm) -> None:
    """Outlines and stops in the colours of a common scale; a stop without a bound is a cross."""
    rings = [np.vstack([outline, outline[:1]]) for outline in several.outline_m]
    drawn = LineCollection(rings, norm=scale, cmap=COLOR_MAP, linewidths=3.5, zorder=6)
    drawn.set_array(bounds.contours.outline_m)
    ax.add_collection(drawn)
    stops = several.scene.walk.positions_m()[list(several.stops), :2]
    known = np.isfinite(bounds.position_m)
    look = {"norm": scale, "cmap": COLOR_MAP, "edgecolors": "black", "linewidths": 0.5, "s": 34, "zorder": 6}
    points = ax.scatter(*stops[known].T, c=bounds.position_m[known], **look)
    ax.plot(*stops[~known].T, "x", color="black", zorder=6)
    bar = figure.colorbar(points, ax=ax, extend="both", shrink=0.85, label="bound of stops and outlines in m")
    log_axis(bar)


def _draw_tx(ax: Any, pose: Pose, look: dict[str, Any]) -> None:
    """A diamond with a line to where the TX looks."""
    ahead = HEADING_M * np.array([np.cos(pose.heading_rad), np.sin(pose.heading_rad)])
    ends: FloatArray = np.array([pose.position_m[:2], pose.position_m[:2] + ahead])
    ax.plot(*ends.T, color=look["color"], linewidth=1.5, zorder=look["zorder"])
    ax.plot(*ends[0], "D", **look)
