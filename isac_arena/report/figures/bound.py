"""Position error bound (PEB) over the plan of a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from isac_arena.report.figures.plan import draw_plan
from isac_arena.report.style import new_figure, styled
from scenes.record import BoolArray, FloatArray
from scenes.scene import Scene

PEB_RANGE_M = (0.05, 5.0)
COLOR_MAP = "viridis_r"
UNBOUNDED_COLOR = "#f2d7d5"


@dataclass(frozen=True)
class BoundMap:
    """PEB on a regular grid: NaN inside objects, infinite where the paths leave the position free."""

    x_m: FloatArray  # (x,)
    y_m: FloatArray  # (y,)
    peb_m: FloatArray  # (y, x)
    has_los: BoolArray  # (y, x)


@styled
def bound_figure(scene: Scene, bound: BoundMap) -> Figure:
    """PEB of a receiver at every place, in colour on a logarithmic scale; the edge of the LOS region dashed."""
    figure = new_figure(9.5, 7.5)
    ax = figure.subplots()
    draw_plan(ax, scene, labels=False)
    ax.grid(visible=False)
    free = np.where(np.isinf(bound.peb_m), 1.0, np.nan)
    ax.pcolormesh(bound.x_m, bound.y_m, free, cmap=ListedColormap([UNBOUNDED_COLOR]), zorder=0.5)
    mesh = ax.pcolormesh(
        bound.x_m,
        bound.y_m,
        np.where(np.isfinite(bound.peb_m), bound.peb_m, np.nan),
        norm=LogNorm(*PEB_RANGE_M),
        cmap=COLOR_MAP,
        zorder=0.6,
    )
    if bound.has_los.any() and not bound.has_los.all():
        ax.contour(
            bound.x_m, bound.y_m, bound.has_los.astype(float), [0.5], colors="black", linestyles="--",
            linewidths=0.9, zorder=0.7,
        )  # fmt: skip
    bar = figure.colorbar(mesh, ax=ax, label="position error bound in m", extend="both", shrink=0.85)
    bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    bar.ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    bar.ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_title(f"{scene.name}: position error bound (dashed: edge of line of sight, pink: unbounded)")
    return figure
