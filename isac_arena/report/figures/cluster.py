"""One cluster: its radial function and its contour, as in the paper's figure 2."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from isac_arena.campaign.results import MapResult
from isac_arena.report.figures.bands import line_m, shape_curve
from isac_arena.report.style import (
    BAND_ALPHA,
    ESTIMATE,
    SLAM,
    TRUTH,
    fill_area,
    fixed_figure,
    legend_below,
    styled,
)
from isac_arena.scoring.stages.shapes import BAND_SIGMAS
from scenes.record import FloatArray
from scenes.scene import Scene

POINT = {"marker": "o", "linestyle": "none", "color": SLAM, "markersize": 4, "markeredgecolor": "white"}
DRAWN_SAGITTA_M = 0.0002
VIEW_MARGIN = 0.12
WHOLE_OBJECT_M = 1.0  # a true outline up to this size is shown in full, a larger one only around the estimate


@styled()
def cluster_figure(scene: Scene, result: MapResult, cluster: int, object_name: str, title: str) -> Figure:
    """Radius over polar angle (left) and contour in the plane (right) of one cluster.

    `object_name` is the object that the cluster shows, empty for none. Its true radius is drawn at the angles
    where a ray from the centre meets the object.
    """
    figure = fixed_figure(8.4, 3.9, left=0.07, right=0.98, bottom=0.2, top=0.91, wspace=0.2)
    radial, plane = figure.subplots(1, 2, width_ratios=[1.15, 1])
    points_m = result.ips.position_m[result.shapes.label == cluster]
    handles = _draw_radial(radial, scene, result, cluster, points_m, object_name)
    center = _draw_contour(plane, scene, result, cluster, points_m, object_name)
    figure.suptitle(title, fontsize=10, fontweight="bold")
    legend_below(figure, [*handles, *center], 6)
    return figure


def _draw_radial(
    ax: Any, scene: Scene, result: MapResult, cluster: int, points_m: FloatArray, object_name: str
) -> list[Any]:
    shapes = result.shapes
    angle_deg, radius = np.rad2deg(shapes.angle_rad), shapes.radius_m[cluster]
    half_width = BAND_SIGMAS * shapes.radius_std_m[cluster]
    offset = points_m - shapes.center_m[cluster]
    band = ax.fill_between(
        angle_deg, radius - half_width, radius + half_width, color=ESTIMATE, alpha=BAND_ALPHA, linewidth=0,
        label="95 % interval",
    )  # fmt: skip
    (mean,) = ax.plot(angle_deg, radius, color=ESTIMATE, label="GP prediction")
    (points,) = ax.plot(
        np.rad2deg(np.arctan2(offset[:, 1], offset[:, 0])), np.hypot(*offset.T), **POINT,
        label="incidence points",
    )  # fmt: skip
    handles = [mean, band, points]
    top = max(float((radius + half_width).max()), float(np.hypot(*offset.T).max(initial=0)))
    truth = np.full(len(angle_deg), np.nan)
    if object_name in scene.object_names:
        truth = scene.object(object_name).contour.radius(shapes.center_m[cluster], shapes.angle_rad)
        highest = float(np.max(truth, initial=0.0, where=np.isfinite(truth)))
        top = max(top, highest) if highest <= WHOLE_OBJECT_M else top
    handles += ax.plot(angle_deg, truth, color=TRUTH, linestyle="--", linewidth=1.2, label="true outline")
    ax.set(xlabel="polar angle in deg", ylabel="radius in m", xlim=(-180, 180), ylim=(0, 1.08 * top))
    ax.xaxis.set_major_locator(MultipleLocator(60))
    return handles


def _draw_contour(
    ax: Any, scene: Scene, result: MapResult, cluster: int, points_m: FloatArray, object_name: str
) -> list[Any]:
    curve = shape_curve(result.shapes, cluster)
    outer, inner = (line_m(edge, is_closed=True) for edge in (curve.outer_m, curve.inner_m))
    ring = np.concatenate([outer, inner[::-1]])
    fill_area(ax, ring, color=ESTIMATE, alpha=BAND_ALPHA, linewidth=0)
    shown = np.vstack([ring, points_m])
    outlines = {item.name: item.contour.vertices(DRAWN_SAGITTA_M) for item in scene.objects}
    own = outlines.get(object_name)
    if own is not None and np.ptp(own, axis=0).max() <= WHOLE_OBJECT_M:
        shown = np.vstack([shown, own])
    low, high = _view(shown)
    for item in scene.objects:
        line = line_m(outlines[item.name], is_closed=item.contour.closed)
        if (line.min(axis=0) <= high).all() and (line.max(axis=0) >= low).all():
            ax.plot(*line.T, color=TRUTH, linestyle="--", linewidth=1.2)
    ax.plot(*line_m(curve.points_m, is_closed=True).T, color=ESTIMATE)
    ax.plot(*points_m.T, **POINT)
    handles = ax.plot(
        *result.shapes.center_m[cluster], "X", color=TRUTH, markeredgecolor="white", markersize=8,
        label="object centre", linestyle="none",
    )  # fmt: skip
    (x_min, y_min), (x_max, y_max) = low, high
    ax.set(xlabel="x in m", ylabel="y in m", aspect="equal", xlim=(x_min, x_max), ylim=(y_min, y_max))
    return list(handles)


def _view(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest x and y (xy,) of a square around the points."""
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    middle, half = (low + high) / 2, (0.5 + VIEW_MARGIN) * float((high - low).max())
    return middle - half, middle + half
