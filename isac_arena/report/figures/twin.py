"""Figures of a twin: the measured single bounces that it explains, and their residuals."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from isac_arena.insight.twin.record import NARROW_GATE, WIDE_GATE, TwinPaths
from isac_arena.insight.twin.scores import is_pillar
from isac_arena.insight.twin.twin import Twin
from isac_arena.report.figures.plan import draw_plan, plan_view
from isac_arena.report.style import CLUSTER_COLORS, ESTIMATE, GHOST, SLAM, legend_below, new_figure, styled
from isac_arena.scoring.metrics.statistics import ratio
from scenes.record import FloatArray
from scenes.scene import Scene

PLAN_WIDTH_IN = 7.5
N_BINS = 24
MOST_OBJECTS = 14


@styled()
def twin_map_figure(scene: Scene, twin: Twin, model: str) -> Figure:
    """Plan with the labelled incidence points that a model explains and those that it does not explain."""
    paths = twin.models[model].paths
    x_min, y_min, x_max, y_max = plan_view(scene, "walk")
    figure = new_figure(PLAN_WIDTH_IN, PLAN_WIDTH_IN * (y_max - y_min) / (x_max - x_min) + 1.0)
    ax = figure.subplots()
    draw_plan(ax, scene, labels=False)
    single, narrow = paths.is_single_bounce, paths.simulated_narrow >= 0
    groups = (
        ("narrow gate", narrow, {"color": ESTIMATE, "marker": "o"}),
        ("wide gate only", paths.is_explained & ~narrow, {"color": CLUSTER_COLORS[5], "marker": "s"}),
        ("not explained", ~paths.is_explained & ~narrow, {"color": SLAM, "marker": "X"}),
    )
    handles = []
    for label, mask, look in groups:
        point = paths.landmark_m[single & mask]
        inside = (point >= (x_min, y_min)).all(axis=1) & (point <= (x_max, y_max)).all(axis=1)
        hidden = f" ({int((~inside).sum())} off the plan)" if not inside.all() else ""
        marker: dict[str, Any] = {
            **look,
            "markersize": 5,
            "markeredgecolor": "white",
            "markeredgewidth": 0.5,
            "linestyle": "none",
        }
        ax.plot(*point[inside].T, zorder=4, **marker)
        handles.append(Line2D([], [], label=f"{label}: {len(point)}{hidden}", **marker))
    legend_below(figure, handles, 3)
    ax.set_title(f"Measured single bounces explained by simulated paths, {_name(model)}")
    return figure


@styled()
def twin_residual_figure(scene: Scene, twin: Twin) -> Figure:
    """Shares explained, residuals of delay and angles, and power: measured over predicted, and by object."""
    figure = new_figure(11.0, 7.0)
    axes = figure.subplots(2, 3)
    fullest = list(twin.models)[-1]
    _draw_shares(axes[0, 0], twin)
    columns = (
        ("delay_residual_s", 1e9, "delay residual in ns"),
        ("aod_residual_rad", float(np.rad2deg(1)), "departure residual in deg"),
        ("aoa_residual_rad", float(np.rad2deg(1)), "arrival residual in deg"),
    )
    places = (axes[0, 1], axes[0, 2], axes[1, 0])
    for place, (ax, (field, scale, label)) in enumerate(zip(places, columns, strict=True)):
        _draw_residuals(ax, twin, field, scale, place)
        ax.set(xlabel=label, ylabel="single bounces")
    _draw_power(axes[1, 1], twin.models[fullest].paths, scene)
    _draw_objects(axes[1, 2], twin.models[fullest].paths)
    figure.suptitle(f"{scene.name}: measured against simulated paths", fontsize=11, fontweight="bold")
    return figure


def _draw_shares(ax: Any, twin: Twin) -> None:
    """Draw bars for both gates of every model, with marks for the chance level and for the calibrated share."""
    for index, model in enumerate(twin.models.values()):
        for side, color in ((-0.2, ESTIMATE), (0.2, CLUSTER_COLORS[4])):
            share, calibrated = (100 * _share(p, side < 0) for p in (model.paths, model.calibrated))
            ax.bar(index + side, share, 0.36, color=color)
            ax.plot(index + side, calibrated, "D", color="black", markersize=4)
            ax.text(index + side, share / 2, f"{share:.0f}", ha="center", va="center", color="white", fontsize=9)
        ax.plot([index - 0.4, index + 0.4], 2 * [100 * model.chance], color=SLAM, linewidth=2)
    ax.set_xticks(range(len(twin.models)), [_name(name).replace("to ", "to\n") for name in twin.models])
    ax.set(ylim=(0, 100), ylabel="explained single bounces in %")
    handles = [
        Line2D([], [], color=ESTIMATE, linewidth=6, label=f"within {_gate(WIDE_GATE)}"),
        Line2D([], [], color=CLUSTER_COLORS[4], linewidth=6, label=f"within {_gate(NARROW_GATE)}"),
        Line2D(
            [], [], color="black", marker="D", markersize=4, linestyle="none", label="calibrated on other stops"
        ),
        Line2D([], [], color=SLAM, linewidth=2, label="by paths of distant stops (chance)"),
    ]
    ax.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize=7)


def _draw_residuals(ax: Any, twin: Twin, field: str, scale: float, column: int) -> None:
    limit = 1.1 * scale * WIDE_GATE[column]
    edges = np.linspace(-limit, limit, N_BINS + 1)
    first, *_, last = twin.models
    for name, color, filled in ((last, GHOST, True), (first, ESTIMATE, False)):
        paths = twin.models[name].paths
        value = scale * getattr(paths, field)[paths.is_explained & paths.is_single_bounce]
        kind = "stepfilled" if filled else "step"
        ax.hist(value, edges, histtype=kind, color=color, label=_name(name), alpha=0.5 if filled else 1.0)
    for gate, style in ((WIDE_GATE, "-"), (NARROW_GATE, "--")):
        for sign in (-1, 1):
            ax.axvline(sign * scale * gate[column], color="0.3", linewidth=0.9, linestyle=style)
    ax.set_ylim(top=1.3 * ax.get_ylim()[1])
    ax.legend(loc="upper center", ncols=2, fontsize=7, frameon=True, framealpha=1, edgecolor="none")


def _draw_power(ax: Any, paths: TwinPaths, scene: Scene) -> None:
    used = paths.is_explained & paths.is_single_bounce & np.isfinite(paths.predicted_dbm)
    pillar = is_pillar(paths, scene.kinds)
    for mask, color, label in ((~pillar, GHOST, "others"), (pillar, ESTIMATE, "pillars")):
        shown = used & mask
        ax.plot(paths.predicted_dbm[shown], paths.power_dbm[shown], "o", color=color, markersize=4, label=label)
    if used.any():
        low = float(min(paths.predicted_dbm[used].min(), paths.power_dbm[used].min())) - 1
        high = float(max(paths.predicted_dbm[used].max(), paths.power_dbm[used].max())) + 1
        ax.plot([low, high], [low, high], color="0.3", linewidth=0.9)
        ax.set(xlim=(low, high), ylim=(low, high))
    ax.set(xlabel="predicted power in dBm (floor included)", ylabel="measured power in dBm")
    ax.legend(loc="upper left")


def _draw_objects(ax: Any, paths: TwinPaths) -> None:
    """Draw power residuals by object, the most frequent object at the top."""
    used = paths.is_explained & paths.is_single_bounce & (paths.object != "")
    names, counts = np.unique(paths.object[used], return_counts=True)
    order = np.argsort(-counts, kind="stable")[:MOST_OBJECTS][::-1]
    for row, name in enumerate(names[order]):
        residual = paths.power_residual_db[used & (paths.object == name)]
        ax.plot(residual, np.full(len(residual), row), "o", color=ESTIMATE, markersize=3.5, alpha=0.6)
        ax.plot(np.median(residual), row, "|", color=SLAM, markersize=12, markeredgewidth=2)
    ax.axvline(0, color="0.3", linewidth=0.9)
    ax.set_yticks(range(len(order)), names[order], fontsize=7)
    ax.legend(handles=[Line2D([], [], color=SLAM, marker="|", linestyle="none", label="median")], loc="lower left")
    ax.set(xlabel="measured over predicted power in dB")


def _share(paths: TwinPaths, wide: bool) -> float:
    found = paths.is_explained if wide else paths.simulated_narrow >= 0
    single = paths.is_single_bounce
    return ratio(int((found & single).sum()), int(single.sum()))


def _gate(gate: FloatArray) -> str:
    return f"{1e9 * gate[0]:g} ns, {np.rad2deg(gate[1]):g} deg"


def _name(model: str) -> str:
    return f"up to {model.replace('_', ' ')}" if model.endswith("bounces") else model.replace("_", " ")
