"""Cumulative distributions of the errors."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, PercentFormatter

from isac_arena.report.style import CLUSTER_COLORS, MAPPING, SLAM, legend_below, new_figure, styled
from isac_arena.scoring.metrics.statistics import finite_entries
from isac_arena.scoring.record import MapScores, PathScores, PoseScores, ScoreTables
from isac_arena.scoring.stages.channel_metrics import KIND_KEYS
from scenes.record import FloatArray

SMALLEST_SHARE = 0.02  # the axis starts at this quantile of the errors
MOST_DECADES = 1e3
WIDE_RANGE = 60.0  # ratio of end to start of an axis; below it 1, 2 and 5 have labels
LINE_STYLES = ("-", "--", ":")
KIND_LABELS = {"los": "line of sight", "single_bounce": "single bounce", "multi_bounce": "multiple bounce"}


@styled()
def pose_cdf_figure(poses: PoseScores) -> Figure:
    """Errors of position, heading and clock bias by SLAM, with and without a line of sight."""
    every = np.ones(len(poses.stop), bool)
    groups = {"all stops": every, "LOS stops": poses.has_los, "NLOS stops": ~poses.has_los}
    panels = {
        "position error in m": poses.position_error_m,
        "heading error in deg": np.rad2deg(poses.heading_error_rad),
        "clock bias error in ns": 1e9 * poses.clock_error_s,
    }
    curves = {label: {name: error[members] for name, members in groups.items()} for label, error in panels.items()}
    return _figure(curves, ("#222222", SLAM, MAPPING))


@styled()
def channel_cdf_figure(paths: PathScores) -> Figure:
    """Errors of delay, departure and arrival of the detected paths, by kind of path."""
    panels = {
        "delay error in ns": 1e9 * paths.delay_error_s,
        "AoD error in deg": np.rad2deg(paths.aod_error_rad),
        "AoA error in deg": np.rad2deg(paths.aoa_error_rad),
    }
    curves = {
        label: {KIND_LABELS[key]: error[paths.kind == kind] for kind, key in KIND_KEYS.items()}
        for label, error in panels.items()
    }
    return _figure(curves, CLUSTER_COLORS)


@styled()
def surface_cdf_figure(tables: ScoreTables) -> Figure:
    """Distance of the incidence points of both maps to the nearest surface and to their true points."""
    maps = {"mapping": tables.mapping, "SLAM": tables.slam}
    curves = {
        "distance to the nearest surface in m": _inlier_errors(maps, "surface_distance_m"),
        "distance to the true incidence point in m": _inlier_errors(maps, "position_error_m"),
    }
    return _figure(curves, (MAPPING, SLAM))


def _inlier_errors(maps: Mapping[str, MapScores], name: str) -> dict[str, FloatArray]:
    return {label: getattr(one.ips, name)[one.ips.is_inlier] for label, one in maps.items()}


def _figure(curves: Mapping[str, Mapping[str, FloatArray]], colors: Sequence[str]) -> Figure:
    """One panel per quantity, one curve per group; the logarithmic abscissa ends at the largest error."""
    figure = new_figure(3.4 * len(curves), 3.1)
    axes = np.atleast_1d(figure.subplots(1, len(curves), sharey=True))
    handles: dict[str, Any] = {}
    for ax, (label, groups) in zip(axes, curves.items(), strict=True):
        errors = {name: np.sort(np.abs(finite_entries(error))) for name, error in groups.items()}
        end = max((error[-1] for error in errors.values() if len(error)), default=1.0) or 1.0
        every = np.concatenate([*errors.values(), [end]])
        start = float(np.clip(np.quantile(every, SMALLEST_SHARE), end / MOST_DECADES, end / 10))
        for index, (name, error) in enumerate(errors.items()):
            if len(error):
                look = {"color": colors[index], "linestyle": LINE_STYLES[index]}
                handles.setdefault(name, _draw_cdf(ax, error, (start / 2, end), name, look))
        ax.set(xlabel=label, xscale="log", xlim=(start, 1.1 * end), ylim=(0, 1.02))
        if end < WIDE_RANGE * start:
            ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.xaxis.set_minor_formatter(NullFormatter())
    axes[0].set_ylabel("share at most this large")
    axes[0].yaxis.set_major_formatter(PercentFormatter(1.0))
    legend_below(figure, list(handles.values()), max(len(handles), 1))
    return figure


def _draw_cdf(ax: Any, error: FloatArray, limits: tuple[float, float], name: str, look: Mapping[str, str]) -> Any:
    """Draw the empirical distribution of sorted errors as steps over the whole axis."""
    start, end = limits
    at = np.concatenate([[start], np.maximum(error, start), [1.1 * end]])
    share = np.concatenate([np.arange(len(error) + 1) / len(error), [1.0]])
    (line,) = ax.step(at, share, where="post", label=name, **look)
    return line
