"""Cramer-Rao bounds of delay and angles over the plan of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from isac_arena.report.figures.bound import COLOR_MAP, UNBOUNDED_COLOR
from isac_arena.report.figures.plan import draw_plan, plan_view
from isac_arena.report.style import new_figure, styled
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import BoolArray, FloatArray
from scenes.scene import Scene

WIDTH_IN, BARS_IN = 13.0, 1.5  # of the figure; height of colour bars and titles
LEAST_DECADES = 1.0  # of a colour scale
SHOWN_PERCENTILES = (
    1.0,
    98.0,
)  # of the finite bounds: a few places behind the beams would take the whole scale


@dataclass(frozen=True)
class ChannelBoundMap:
    """Bounds of the strongest path on a regular grid: NaN inside objects, infinite where no path is seen."""

    x_m: FloatArray  # (x,)
    y_m: FloatArray  # (y,)
    delay_std_s: FloatArray  # (y, x)
    aod_std_rad: FloatArray  # (y, x)
    aoa_std_rad: FloatArray  # (y, x)
    has_los: BoolArray  # (y, x)
    is_coherent: bool


@styled
def channel_bound_figure(scene: Scene, bound: ChannelBoundMap) -> Figure:
    """Path length, AoD and AoA side by side, colours on logarithmic scales; the edge of the LOS region dashed."""
    x_min, y_min, x_max, y_max = plan_view(scene, "walk")
    panel_in = WIDTH_IN / 3 - 0.3
    figure = new_figure(WIDTH_IN, panel_in * (y_max - y_min) / (x_max - x_min) + BARS_IN)
    panels = [
        ("path length (delay)", "mm", 1e3 * SPEED_OF_LIGHT_M_S * bound.delay_std_s),
        ("angle of departure", "mdeg", 1e3 * np.rad2deg(bound.aod_std_rad)),
        ("angle of arrival", "mdeg", 1e3 * np.rad2deg(bound.aoa_std_rad)),
    ]
    for ax, (name, unit, std) in zip(figure.subplots(1, 3, sharey=True), panels, strict=True):
        _draw_bound(figure, ax, scene, bound, std, f"{name}: standard deviation in {unit}")
        ax.label_outer()
    phases = "phases kept between beam pairs" if bound.is_coherent else "a random phase per beam pair"
    figure.suptitle(
        f"{scene.name}: Cramér-Rao bounds of the strongest path, {phases}"
        " (dashed: edge of line of sight, pink: no path)",
        fontsize=10,
        fontweight="bold",
    )
    return figure


def _draw_bound(
    figure: Figure, ax: Any, scene: Scene, bound: ChannelBoundMap, std: FloatArray, label: str
) -> None:
    draw_plan(ax, scene, labels=False)
    ax.grid(visible=False)
    none = np.where(np.isinf(std), 1.0, np.nan)
    ax.pcolormesh(bound.x_m, bound.y_m, none, cmap=ListedColormap([UNBOUNDED_COLOR]), zorder=0.5)
    shown = np.where(np.isfinite(std), std, np.nan)
    mesh = ax.pcolormesh(bound.x_m, bound.y_m, shown, norm=_scale(shown), cmap=COLOR_MAP, zorder=0.6)
    if bound.has_los.any() and not bound.has_los.all():
        ax.contour(
            bound.x_m, bound.y_m, bound.has_los.astype(float), [0.5], colors="black", linestyles="--",
            linewidths=0.9, zorder=0.7,
        )  # fmt: skip
    bar = figure.colorbar(
        mesh, ax=ax, label=label, extend="both", orientation="horizontal", aspect=30, pad=0.02
    )
    bar.ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    bar.ax.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    bar.ax.xaxis.set_minor_formatter(NullFormatter())


def _scale(std: FloatArray) -> LogNorm:
    """A logarithmic scale over most of the finite values, at least a decade."""
    finite = std[np.isfinite(std) & (std > 0)]
    if not len(finite):
        return LogNorm(0.1, 1.0)
    low, high = np.percentile(finite, SHOWN_PERCENTILES)
    middle = np.sqrt(low * high)
    half = 10 ** (LEAST_DECADES / 2)
    return LogNorm(min(low, middle / half), max(high, middle * half))
