"""Picture of a scene in space: prisms and clutter, the TX, the walk, and the paths to a stop."""

from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
import shapely
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from isac_arena.report.figures.object_names import Box
from isac_arena.report.figures.path_lines import (
    COLORS,
    SCATTER_COLOR,
    line_style,
    path_lines,
    path_summary,
    scatter_points,
)
from isac_arena.report.figures.plan import RX_COLOR, kind_patches, plan_view
from scenes.objects.scene_object import KIND_COLORS
from scenes.record import FloatArray
from scenes.scene import Scene, SceneObject
from sim.propagation.paths import Paths

DRAWN_SAGITTA_M = 0.01
NEAR_OPACITY, FAR_OPACITY, SOLID_OPACITY = 0.03, 0.3, 0.6  # of near and far walls, and of other objects
TALL_SHARE = 0.9  # of the room's height: taller rails, boxes and rooms are transparent like walls
ELEVATION_DEG, AZIMUTH_DEG = 38.0, -60.0
TX_LABEL_M = 0.35  # above the TX
FLOOR_COLOR = "#eceff1"

LIGHT = np.array([0.45, -0.3, 0.84])  # direction towards the light

Color = tuple[float, float, float, float]
Ring = FloatArray  # corners (point, xyz) of a flat face


def scene_figure(
    scene: Scene,
    *,
    extent: Literal["walk", "all"] = "walk",
    paths: Paths | None = None,
    stop: int | None = None,
    figure: Figure | None = None,
) -> Figure:
    """The scene in an oblique view from above, cut off at the extent, with transparent walls and without ceiling.

    With `paths`, the paths from the TX to the RX at `stop` are drawn over it. By default the figure is a new one.
    """
    figure = figure or Figure(figsize=(10.5, 7.5))
    ax: Any = figure.add_axes((0.0, 0.03, 0.86, 0.91), projection="3d", computed_zorder=False)
    ax.autoscale(False)
    view = plan_view(scene, extent)
    kinds = _draw_bodies(ax, scene, view)
    _draw_devices(ax, scene, stop)
    title = scene.name
    shown: list[Line2D] = []
    if paths is not None and stop is not None:
        shown = _draw_paths(ax, scene, paths, stop, view)
        title = f"{scene.name}, stop {stop}: {path_summary(paths)}"
    z_low, z_high = _heights(scene)
    ax.set(xlim=view[::2], ylim=view[1::2], zlim=(z_low, z_high))
    ax.set_box_aspect((view[2] - view[0], view[3] - view[1], z_high - z_low), zoom=1.12)
    slender = (view[2] - view[0]) / (view[3] - view[1])  # long axes are drawn close to their labels
    ax.set_xlabel("x in m", labelpad=8 * max(slender, 1))
    ax.set_ylabel("y in m", labelpad=8 * max(1 / slender, 1))
    ax.set_zlabel("z in m")
    ax.view_init(elev=ELEVATION_DEG, azim=AZIMUTH_DEG)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_major_locator(MaxNLocator(3 if axis is ax.zaxis else 6, integer=True))
        axis.pane.set_alpha(0.0)
    figure.suptitle(title, fontsize=11, weight="bold", x=0.43, y=0.97)
    _draw_legend(figure, kinds, shown)
    return figure


def _draw_bodies(ax: Any, scene: Scene, view: Box) -> set[str]:
    """Draw all faces in one collection, which sorts them by depth; returns the kinds in view."""
    frame = shapely.box(*view)
    z_low, z_high = _heights(scene)
    faces: list[Ring] = []
    colors: list[Color] = []
    edges: list[Ring] = []
    edge_colors: list[Color] = []
    kinds: set[str] = set()
    for item in scene.objects:
        is_tall = item.kind != "pillar" and item.z_max_m - item.z_min_m >= TALL_SHARE * (z_high - z_low)
        sheer = item.kind == "wall" or is_tall or not item.contour.closed
        for rings, rim in _prism(item, frame):
            faces += rings
            opacity = _wall_opacity(rings, view) if sheer else [SOLID_OPACITY] * len(rings)
            shades = zip(rings, opacity, strict=True)
            colors += [_shaded(KIND_COLORS[item.kind], share, ring) for ring, share in shades]
            edges += rim
            edge_colors += [to_rgba(KIND_COLORS[item.kind], 0.7)] * len(rim)
            kinds.add(item.kind)
    for mesh in scene.clutter:
        triangles = mesh.vertices_m[mesh.faces]
        kinds.add(mesh.kind)
        faces += list(triangles)
        colors += [_shaded(KIND_COLORS[mesh.kind], 0.9, ring) for ring in triangles]
    ground = shapely.intersection(frame, shapely.box(*scene.bounds_m))
    if scene.floor is not None and not ground.is_empty:
        floor = _at(shapely.get_coordinates(ground), scene.floor.z_m)
        ax.add_collection3d(Poly3DCollection([floor], facecolor=FLOOR_COLOR, zorder=0))
    if faces:
        ax.add_collection3d(Poly3DCollection(faces, facecolors=colors, edgecolors="none", zorder=1))
        ax.add_collection3d(Line3DCollection(edges, colors=edge_colors, linewidths=0.7, zorder=2))
    return kinds


def _wall_opacity(rings: list[Ring], view: Box) -> list[float]:
    """Opacity of each face of a wall: near faces are more transparent, so that they hide less."""
    (x_min, y_min, x_max, y_max), azimuth = view, np.deg2rad(AZIMUTH_DEG)
    to_eye = np.array([np.cos(azimuth), np.sin(azimuth)])
    middle, half = np.array([x_min + x_max, y_min + y_max]) / 2, np.array([x_max - x_min, y_max - y_min]) / 2
    nearness = [(ring[:, :2].mean(axis=0) - middle) @ to_eye / (half @ np.abs(to_eye)) for ring in rings]
    return list(np.interp(nearness, [-0.5, 0.5], [FAR_OPACITY, NEAR_OPACITY]))


def _prism(item: SceneObject, frame: Any) -> Iterator[tuple[list[Ring], list[Ring]]]:
    """Faces and edges of the part of an object inside the frame: sides and, for a closed object, the top."""
    seen = shapely.intersection(item.contour.body(DRAWN_SAGITTA_M), frame)
    for part in shapely.get_parts(seen):
        if part.is_empty or part.geom_type not in ("Polygon", "LineString"):
            continue
        outline = shapely.get_coordinates(part.exterior if part.geom_type == "Polygon" else part)
        low, high = _at(outline, item.z_min_m), _at(outline, item.z_max_m)
        sides = [np.array([low[k], low[k + 1], high[k + 1], high[k]], float) for k in range(len(outline) - 1)]
        yield [*sides, high] if part.geom_type == "Polygon" else sides, [low, high]


def _draw_devices(ax: Any, scene: Scene, stop: int | None) -> None:
    line = _at(scene.walk.line_m(), scene.walk.height_m)
    ax.plot(*line.T, color=RX_COLOR, linewidth=0.8, alpha=0.6, zorder=4)
    position = scene.walk.positions_m()
    ax.scatter(*position.T, s=9, color=RX_COLOR, depthshade=False, zorder=5)
    if stop is not None:
        ax.scatter(*position[stop], s=60, facecolor="none", edgecolor=RX_COLOR, linewidth=1.6, zorder=6)
    ax.scatter(*scene.tx.position_m, s=45, marker="D", color="black", depthshade=False, zorder=6)
    x, y, z = scene.tx.position_m
    ax.text(x, y, z + TX_LABEL_M, "TX", fontsize=9, weight="bold", ha="center", zorder=7)


def _draw_paths(ax: Any, scene: Scene, paths: Paths, stop: int, view: Box) -> list[Line2D]:
    """Draw the paths to a stop and return their legend entries."""
    lines = path_lines(paths, scene.tx.position_m, scene.walk.positions_m()[stop])
    scattered = scatter_points(paths)
    inside = (scattered[:, :2] >= view[:2]) & (scattered[:, :2] <= view[2:])
    scattered = scattered[inside.all(axis=1)]
    if len(scattered):
        ax.scatter(*scattered.T, s=2.5, color=SCATTER_COLOR, alpha=0.5, linewidths=0, zorder=3)
    for line in lines:
        legs = _clipped(line.points_m, view)
        shade = to_rgba(COLORS[line.kind], line.opacity)
        if len(legs):
            look = {"colors": shade, "linestyles": [line_style(line.kind)], "linewidths": 1.1, "zorder": 4}
            ax.add_collection3d(Line3DCollection(legs, **look))
    present = {line.kind for line in lines}
    entries = [
        Line2D([], [], color=COLORS[kind], linestyle=line_style(kind), label=kind)
        for kind in COLORS
        if kind in present
    ]
    if len(scattered):
        entries.append(_mark("o", SCATTER_COLOR, 3, "diffuse scattering"))
    return entries


def _mark(marker: str, color: str, size: float, label: str) -> Line2D:
    return Line2D([], [], marker=marker, color=color, markersize=size, linestyle="none", label=label)


def _clipped(points_m: FloatArray, view: Box) -> FloatArray:
    """Legs (leg, end, xyz) of a path through points (point, xyz), clipped to the view."""
    start, along = points_m[:-1], np.diff(points_m, axis=0)
    step = np.where(along[:, :2] == 0, 1e-300, along[:, :2])
    shares = np.stack([(np.reshape(view, (2, 1, 2))[k] - start[:, :2]) / step for k in (0, 1)])
    enters = np.clip(shares.min(axis=0).max(axis=1), 0, 1)[:, None]
    leaves = np.clip(shares.max(axis=0).min(axis=1), 0, 1)[:, None]
    kept = (enters < leaves).ravel()
    return np.asarray(np.stack([start + enters * along, start + leaves * along], axis=1)[kept])


def _shaded(color: str, opacity: float, ring: Ring) -> Color:
    """Colour of a face: it is darker, the more the face turns away from the light."""
    normal = np.cross(ring[1] - ring[0], ring[2] - ring[0])
    facing = abs(normal @ LIGHT) / max(float(np.linalg.norm(normal)), 1e-12)
    red, green, blue, alpha = to_rgba(color, opacity)
    bright = float(0.65 + 0.35 * facing)
    return red * bright, green * bright, blue * bright, alpha


def _draw_legend(figure: Figure, kinds: set[str], paths_shown: list[Line2D]) -> None:
    devices = [_mark("o", RX_COLOR, 3.5, "RX stop"), _mark("D", "black", 5, "TX")]
    figure.legend(
        handles=[*kind_patches(kinds), *devices, *paths_shown], loc="upper left", bbox_to_anchor=(0.855, 0.9),
        fontsize=8, frameon=False,
    )  # fmt: skip


def _heights(scene: Scene) -> tuple[float, float]:
    """Lowest and highest z of the picture."""
    low = [item.z_min_m for item in scene.objects] + [item.bounds_m[0][2] for item in scene.clutter]
    high = [item.z_max_m for item in scene.objects] + [item.bounds_m[1][2] for item in scene.clutter]
    z_low = scene.floor.z_m if scene.floor else min([*low, 0.0])
    z_high = scene.ceiling.z_m if scene.ceiling else max([*high, scene.tx.position_m[2], scene.walk.height_m])
    return float(z_low), float(z_high)


def _at(xy_m: FloatArray, z_m: float) -> FloatArray:
    return np.column_stack([xy_m, np.full(len(xy_m), z_m)])
