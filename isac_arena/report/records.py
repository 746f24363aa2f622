"""Pictures and notebook tables of single records: what `.plot()` draws and `_repr_html_` shows.

`plot` takes the record and, for all that lies in the plan, the scene; it returns the matplotlib axes.
"""

from functools import singledispatch
from html import escape
from typing import Any, Literal, get_args

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from estimation.channel.beam_power_map import BeamPowerMap, beam_power_map
from estimation.channel.record import ChannelEstimate
from estimation.shape.record import Contours, Shapes
from estimation.slam.record import IncidencePoints, PoseEstimates
from isac_arena.campaign.campaign import Campaign
from isac_arena.campaign.chain.memory import RunResults
from isac_arena.campaign.results import MapResult
from isac_arena.report.figures.bands import contour_curve, shape_curve
from isac_arena.report.figures.map import draw_contours, object_handles
from isac_arena.report.figures.path_lines import path_summary
from isac_arena.report.figures.plan import draw_legend, draw_paths, draw_plan
from isac_arena.report.figures.power import draw_power
from isac_arena.report.figures.scene3d import scene_figure
from isac_arena.report.page.tables import headline_table, legend_text
from isac_arena.report.style import ESTIMATE, GHOST, SLAM, cluster_look, html_table, styled
from isac_arena.scoring.score import Scores
from scenes.arguments import need
from scenes.record import Record, columns, parts_of
from scenes.scene import Scene
from sim.observation import BeamSweep
from sim.propagation.paths import Paths
from sim.truth import Truth

View = Literal["plan", "3d", "delay"]
FLOOR_DB = 60.0  # of a power-delay profile below its strongest path


def plot(thing: Any, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    """Draw a record; returns the matplotlib axes.

    Parameters
    ----------
    scene
        The scene under what lies in the plan: poses, points, contours, paths.
    ax
        Axes to draw into; new ones by default.
    view
        Scenes: `plan` or `3d`. Truths: `plan` or `3d` with the paths; `delay` for the power-delay profile, as
        without a scene.
    """
    need("scene", scene, Scene, type(None))
    need("ax", ax, Axes, type(None))
    if view not in get_args(View):
        raise ValueError(f"view = {view!r}: must be one of {', '.join(get_args(View))}")
    return _drawn(thing, scene, ax=ax, view=view)


@singledispatch
def _drawn(thing: Any, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    known = ", ".join(kind.__name__ for kind in _drawn.registry if kind is not object)
    raise TypeError(f"{type(thing).__name__} has no picture; these have: {known}")


@_drawn.register
@styled()
def _(thing: Scene, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    if view == "3d":
        return scene_figure(thing, extent="all", figure=plt.figure(figsize=(10.5, 7.5))).axes[0]
    ax = _axes(ax)
    draw_plan(ax, thing, extent="all")
    ax.set_title(thing.name)
    return ax


@_drawn.register
def _(thing: Campaign, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    return plot(thing.scene, ax=ax, view=view)


@_drawn.register
@styled()
def _(thing: Truth, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    if scene is None or view == "delay":
        ax = plot(thing.paths, ax=ax)
        ax.set_title(f"stop {thing.stop}: {path_summary(thing.paths)}")
        return ax
    if view == "3d":
        figure = plt.figure(figsize=(10.5, 7.5))
        return scene_figure(scene, extent="all", paths=thing.paths, stop=thing.stop, figure=figure).axes[0]
    ax = _axes(ax)
    draw_paths(ax, scene, thing.paths, thing.rx_pose.position_m)
    draw_plan(ax, scene, extent="all")
    ax.set_title(f"{scene.name}, stop {thing.stop}: {path_summary(thing.paths)}")
    return ax


@_drawn.register
@styled()
def _(thing: Paths, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    level_db = 20 * np.log10(np.maximum(np.abs(thing.gain), 1e-30))
    kinds = {"diffuse": (thing.is_diffuse, GHOST), "specular": (~thing.is_diffuse, ESTIMATE)}
    ax = _profile(ax, thing.delay_s, level_db, kinds | {"line of sight": (thing.is_los, SLAM)})
    ax.set(xlabel="delay in ns", ylabel="path gain in dB")
    return ax


@_drawn.register
@styled()
def _(thing: ChannelEstimate, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    kinds = {"marked weak (is_weak)": (thing.is_weak, GHOST), "path": (~thing.is_weak & ~thing.is_los, ESTIMATE)}
    ax = _profile(ax, thing.delay_s, thing.power_dbm, kinds | {"taken as line of sight": (thing.is_los, SLAM)})
    ax.set(xlabel="delay with the clock bias in ns", ylabel="power in the best beam pair in dBm")
    what = "estimated path" if len(thing) == 1 else "estimated paths"
    ax.set_title(f"stop {thing.stop}: {len(thing)} {what}, method {thing.method}")
    return ax


@_drawn.register
@styled()
def _(thing: BeamPowerMap, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    ax = _axes(ax)
    ax.grid(visible=False)
    ax.figure.colorbar(draw_power(ax, thing), ax=ax, label="received power per beam pair in dBm", extend="min")
    ax.set(xlabel="azimuth of arrival in the RX frame, deg", ylabel="azimuth of departure in the TX frame, deg")
    ax.set_title(f"stop {thing.stop}: beam power map")
    return ax


@_drawn.register
def _(thing: BeamSweep, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    return plot(beam_power_map(thing), ax=ax)


@_drawn.register
@styled()
def _(thing: PoseEstimates, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    ax = _over_plan(ax, scene)
    u, v = np.cos(thing.heading_rad), np.sin(thing.heading_rad)
    ax.quiver(*thing.position_m.T, u, v, color=SLAM, angles="xy", width=0.003, scale=30, zorder=4)
    look = {"markersize": 7, "markeredgewidth": 1.4, "linestyle": "none", "zorder": 4}
    ax.plot(*thing.position_m.T, "+", color=SLAM, label="receiver pose", **look)
    draw_legend(ax, scene)
    return ax


@_drawn.register
@styled()
def _(thing: IncidencePoints, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    ax = _over_plan(ax, scene)
    looks: dict[str, Any] = {"incidence point": {"marker": "o", "color": ESTIMATE, "markersize": 3.8, "zorder": 4}}
    looks["outlier"] = {"marker": ".", "color": GHOST, "markersize": 3.5, "zorder": 3}
    for chosen, (label, look) in zip((thing.is_inlier, ~thing.is_inlier), looks.items(), strict=True):
        if chosen.any():
            ax.plot(*thing.position_m[chosen].T, linestyle="none", label=label, **look)
    draw_legend(ax, scene)
    return ax


@_drawn.register(Contours)
@_drawn.register(Shapes)
@styled()
def _(thing: Contours | Shapes, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    ax = _over_plan(ax, scene)
    if isinstance(thing, Contours):
        curves = [contour_curve(thing, row) for row in range(len(thing))]
    else:
        curves = [shape_curve(thing, row) for row in range(len(thing.center_m))]
    draw_contours(ax, curves, None, [cluster_look(row) for row in range(len(curves))])
    draw_legend(ax, scene, more=object_handles()[1:])
    return ax


@_drawn.register
@styled()
def _(thing: MapResult, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    ax = plot(thing.poses, scene, ax=ax)
    curves = [contour_curve(thing.contours, row) for row in range(len(thing.contours))]
    looks = [cluster_look(row) for row in range(len(curves))]
    position_m, label = thing.ips.position_m, thing.contours.object
    alone = position_m[thing.ips.is_inlier & (label < 0)]
    ax.plot(*alone.T, ".", color=GHOST, markersize=3.5, zorder=3, label="incidence point of no object")
    draw_contours(ax, curves, [position_m[label == row] for row in range(len(curves))], looks)
    ax.set_title("contours with their incidence points and 95 % bands")
    draw_legend(ax, scene, more=object_handles())
    return ax


@_drawn.register
def _(thing: RunResults, scene: Scene | None = None, *, ax: Any = None, view: View = "plan") -> Any:
    return plot(thing.mapping, scene or thing.scene, ax=ax)


@singledispatch
def html(thing: Any) -> str:
    """An HTML table of what a thing holds."""
    return f"<code>{escape(repr(thing))}</code>"


@html.register
def _(thing: Record) -> str:
    rows = [
        [escape(name), escape(", ".join(axes) or "-"), escape(_values(values)), escape(about["unit"]),
         escape(about["doc"])]
        for name, axes, values, about in columns(thing)
    ]  # fmt: skip
    table = html_table(["field", "axes", "values", "unit", "meaning"], rows)
    inner = "".join(f"<details><summary>{name}</summary>{html(part)}</details>" for name, part in _parts(thing))
    return f"<b>{type(thing).__name__}</b>{table}{inner}"


@html.register
def _(thing: Scores) -> str:
    doubts = "".join(f"<p>doubtful: {escape(doubt)}</p>" for doubt in thing.doubts)
    more = f"<p><code>.to_dataframe()</code> has all {len(thing.metrics)} scores</p>"
    return headline_table(thing.metrics) + doubts + legend_text(thing) + more


def _parts(thing: Record) -> list[tuple[str, Record]]:
    return list(parts_of(thing).items())


def _values(values: Any) -> str:
    """The values of a field in a few words: one value, or the range of many."""
    if values.ndim == 0:
        return f"{values.item():.6g}" if values.dtype.kind == "f" else str(values.item())
    shape = " x ".join(map(str, values.shape))
    if values.dtype.kind in "iuf" and np.isfinite(values).any():
        return f"{shape}: {np.nanmin(values):.4g} to {np.nanmax(values):.4g}"
    return shape


def _profile(ax: Any, delay_s: Any, level_db: Any, kinds: dict[str, tuple[Any, str]]) -> Any:
    """Stems of levels over delay, from a common floor."""
    ax = _axes(ax)
    floor_db = float(np.max(level_db, initial=-np.inf)) - FLOOR_DB if len(level_db) else 0.0
    for label, (of_kind, color) in kinds.items():
        chosen = of_kind & (level_db > floor_db)
        if chosen.any():
            ax.vlines(1e9 * delay_s[chosen], floor_db, level_db[chosen], color=color, linewidth=1.2, label=label)
            ax.plot(1e9 * delay_s[chosen], level_db[chosen], "o", color=color, markersize=3)
    if len(level_db):
        ax.set_ylim(floor_db, None)
        ax.legend()
    return ax


def _over_plan(ax: Any, scene: Scene | None) -> Any:
    ax = _axes(ax)
    if scene is not None:
        draw_plan(ax, scene, extent="all", labels=False)
    ax.set(aspect="equal", xlabel="x in m", ylabel="y in m")
    return ax


def _axes(ax: Any) -> Any:
    return plt.subplots(figsize=(9, 6), layout="compressed")[1] if ax is None else ax  # room for the legend
