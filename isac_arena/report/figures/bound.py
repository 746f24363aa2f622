"""Cramer-Rao bounds over the plan of a scene: of the position, and of delay and angles of the strongest path."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from isac_arena.report.figures.plan import draw_plan, plan_view
from isac_arena.report.style import new_figure, styled
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import BoolArray, FloatArray
from scenes.scene import Scene

INSIDE = "white: inside an object or a mesh, or outside the walls"
FROM_SIGNAL = "from the signal, the arrays and all paths of a stop together"
COLOR_MAP = "viridis_r"
UNBOUNDED_COLOR = "#f2d7d5"
WIDTH_IN, BARS_IN = 13.0, 1.5  # width of the channel figure; height of its colour bars and titles
LEAST_DECADES = 1.0  # of a colour scale
SHOWN_PERCENTILES = (1.0, 98.0)  # of the finite bounds: a few places behind the beams would fill the scale


@dataclass(frozen=True)
class BoundMap:
    """Position error bound (PEB) on a regular grid.

    The PEB is NaN inside objects and outside the walls, and infinite where the paths do not determine the
    position. `has_los` is where nothing stands between a TX and the place, also where its beams do not point.
    """

    x_m: FloatArray  # (x,)
    y_m: FloatArray  # (y,)
    peb_m: FloatArray  # (y, x)
    has_los: BoolArray  # (y, x)


@dataclass(frozen=True)
class ChannelBoundMap:
    """Bounds of the strongest path on a regular grid: NaN as in `BoundMap`, infinite where there is no path.

    `has_los` is as in `BoundMap`.
    """

    x_m: FloatArray  # (x,)
    y_m: FloatArray  # (y,)
    delay_std_s: FloatArray  # (y, x)
    aod_std_rad: FloatArray  # (y, x)
    aoa_std_rad: FloatArray  # (y, x)
    has_los: BoolArray  # (y, x)
    is_coherent: bool


@styled()
def bound_figure(scene: Scene, bound: BoundMap, errors: str = FROM_SIGNAL) -> Figure:
    """PEB of a receiver at every place, in colour on a logarithmic scale; the edge of the LOS region is dashed.

    `errors` says where the errors of the paths come from.
    """
    x_min, y_min, x_max, y_max = plan_view(scene, "all")
    figure = new_figure(9.5, float(np.clip(8.0 * (y_max - y_min) / (x_max - x_min) + 1.0, 4.0, 9.0)))
    ax = figure.subplots()
    bar = {"label": "position error bound in m", "shrink": 0.85}
    _draw_bound(figure, ax, scene, bound, bound.peb_m, log_scale(bound.peb_m[np.isfinite(bound.peb_m)]), bar)
    key = f"dashed: edge of line of sight, pink: unbounded, {INSIDE}"
    ax.set_title(f"{scene.name}: position error bound {errors}\n({key})")
    return figure


@styled()
def channel_bound_figure(scene: Scene, bound: ChannelBoundMap) -> Figure:
    """Bounds of path length, AoD and AoA side by side, in colours on logarithmic scales.

    The edge of the LOS region is dashed.
    """
    x_min, y_min, x_max, y_max = plan_view(scene, "all")
    panel_in = WIDTH_IN / 3 - 0.3
    figure = new_figure(WIDTH_IN, panel_in * (y_max - y_min) / (x_max - x_min) + BARS_IN)
    panels = [
        ("path length (delay)", "mm", 1e3 * SPEED_OF_LIGHT_M_S * bound.delay_std_s),
        ("angle of departure", "0.001 deg", 1e3 * np.rad2deg(bound.aod_std_rad)),
        ("angle of arrival", "0.001 deg", 1e3 * np.rad2deg(bound.aoa_std_rad)),
    ]
    for ax, (name, unit, std) in zip(figure.subplots(1, 3, sharey=True), panels, strict=True):
        bar = {"label": f"{name}: standard deviation in {unit}", "orientation": "horizontal"}
        scale = log_scale(std[np.isfinite(std) & (std > 0)])
        _draw_bound(figure, ax, scene, bound, std, scale, {**bar, "aspect": 30, "pad": 0.02})
        ax.label_outer()
    phases = "phases kept between beam pairs" if bound.is_coherent else "a random phase per beam pair"
    figure.suptitle(
        f"{scene.name}: Cramér-Rao bounds of the strongest path, {phases}"
        f"\n(dashed: edge of line of sight, pink: no path, {INSIDE})",
        fontsize=10,
        fontweight="bold",
    )
    return figure


def _draw_bound(
    figure: Figure,
    ax: Any,
    scene: Scene,
    bound: BoundMap | ChannelBoundMap,
    value: FloatArray,
    scale: LogNorm,
    bar: dict[str, Any],
) -> None:
    """Draw the plan with a bound (y, x) under it, its colour bar and the edge of the LOS region."""
    draw_plan(ax, scene, labels=False, extent="all")
    ax.grid(visible=False)
    unbounded = np.where(np.isinf(value), 1.0, np.nan)
    ax.pcolormesh(bound.x_m, bound.y_m, unbounded, cmap=ListedColormap([UNBOUNDED_COLOR]), zorder=0.5)
    shown = np.where(np.isfinite(value), value, np.nan)
    mesh = ax.pcolormesh(bound.x_m, bound.y_m, shown, norm=scale, cmap=COLOR_MAP, zorder=0.6)
    if bound.has_los.any() and not bound.has_los.all():
        ax.contour(
            bound.x_m, bound.y_m, bound.has_los.astype(float), [0.5], colors="black", linestyles="--",
            linewidths=0.9, zorder=0.7,
        )  # fmt: skip
    log_axis(figure.colorbar(mesh, ax=ax, extend="both", **bar))


def log_axis(bar: Any) -> None:
    """Plain numbers at 1, 2 and 5 along a logarithmic colour bar."""
    axis = bar.long_axis
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def log_scale(std: FloatArray) -> LogNorm:
    """A logarithmic scale over most of the positive values (place,), at least a decade."""
    if not len(std):
        return LogNorm(0.1, 1.0)
    low, high = np.percentile(std, SHOWN_PERCENTILES)
    middle = np.sqrt(low * high)
    half = 10 ** (LEAST_DECADES / 2)
    return LogNorm(min(low, middle / half), max(high, middle * half))
