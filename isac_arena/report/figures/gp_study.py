"""The synthetic study of the radial Gaussian process: the three panels of the paper's Fig. 1."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from isac_arena.report.style import BAND_ALPHA, ESTIMATE, TRUTH, cluster_look, legend_below, new_figure, styled
from isac_arena.validation.shape.gp_study import Example, StudyCell
from scenes.record import FloatArray

POINTS: dict[str, Any] = {"color": "#009E73", "marker": ".", "linestyle": "none", "markersize": 6}
BAND_STD = 2.0


@styled()
def radial_function_figure(example: Example) -> Figure:
    """Fig. 1a: fitted radius against angle, its points and its 95 % interval."""
    figure = new_figure(4.4, 3.2)
    ax = figure.subplots()
    angle = np.rad2deg(example.angle_rad)
    band = BAND_STD * example.std_m
    ax.fill_between(
        angle,
        example.mean_m - band,
        example.mean_m + band,
        color=ESTIMATE,
        alpha=BAND_ALPHA,
        linewidth=0,
        label="95 % interval",
    )
    ax.plot(np.rad2deg(example.point_angle_rad), example.point_radius_m, label="points", **POINTS)
    ax.plot(angle, example.true_radius_m, color=TRUTH, linestyle="--", linewidth=1.2, label="truth")
    ax.plot(angle, example.mean_m, color=ESTIMATE, label="estimate")
    ax.set_xlim(-180, 180)
    ax.set_xticks(range(-180, 181, 90))
    ax.set_xlabel("angle in deg")
    ax.set_ylabel("radius in m")
    ax.set_title(f"Radial function from {len(example.point_angle_rad)} points")
    legend_below(figure, ax.get_legend_handles_labels()[0], 4)
    return figure


@styled()
def contour_figure(example: Example) -> Figure:
    """Fig. 1b: the contour about its centre."""
    figure = new_figure(4.0, 4.0)
    ax = figure.subplots()
    around = np.append(np.arange(len(example.angle_rad)), 0)
    angle = example.angle_rad[around]
    looks: tuple[tuple[FloatArray, dict[str, Any]], ...] = (
        (example.true_radius_m, {"color": TRUTH, "linestyle": "--", "linewidth": 1.2, "label": "truth"}),
        (example.mean_m, {"color": ESTIMATE, "label": "estimate"}),
    )
    for radius, look in looks:
        ax.plot(radius[around] * np.cos(angle), radius[around] * np.sin(angle), **look)
    x = example.point_radius_m * np.cos(example.point_angle_rad)
    y = example.point_radius_m * np.sin(example.point_angle_rad)
    ax.plot(x, y, label="points", **POINTS)
    ax.plot(0, 0, "+", color="0.4", label="centre")
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("x in m")
    ax.set_ylabel("y in m")
    ax.set_title("Contour")
    legend_below(figure, ax.get_legend_handles_labels()[0], 4)
    return figure


@styled()
def rmse_figure(cells: Sequence[StudyCell]) -> Figure:
    """Fig. 1c: RMSE at the training angles against the number of points, one panel per mode."""
    modes = list(dict.fromkeys(cell.mode for cell in cells))
    shapes = list(dict.fromkeys(cell.shape for cell in cells))
    figure = new_figure(1.0 + 2.6 * len(modes), 3.2)
    panels = figure.subplots(1, len(modes), sharey=True, squeeze=False)[0]
    for ax, mode in zip(panels, modes, strict=True):
        for number, shape in enumerate(shapes):
            of_shape = [cell for cell in cells if (cell.mode, cell.shape) == (mode, shape)]
            _rmse_line(ax, of_shape, number)
        ax.set_xscale("log", base=2)
        ax.set_yscale("log")
        ticks = sorted({cell.n_points for cell in cells})
        ax.set_xticks(ticks, [str(tick) for tick in ticks])
        ax.set_title(mode)
        ax.set_xlabel("number of points M")
    panels[0].set_ylabel("RMSE in m")
    legend_below(figure, panels[0].get_legend_handles_labels()[0], len(shapes))
    return figure


def _rmse_line(ax: Axes, cells: Sequence[StudyCell], number: int) -> None:
    ax.errorbar(
        [cell.n_points for cell in cells],
        [cell.rmse_m for cell in cells],
        yerr=[BAND_STD * cell.rmse_error_m for cell in cells],
        markersize=4,
        label=cells[0].shape,
        **cluster_look(number),
    )
