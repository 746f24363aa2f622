"""The power map of a stop: received power over departure and arrival, with true and estimated paths."""

from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from estimation.channel.beam_power_map import BeamPowerMap
from estimation.channel.record import ChannelEstimate
from isac_arena.report.style import SLAM, legend_below, new_figure, styled
from isac_arena.scoring.record import PathScores, PathStatus, ScoreTables, SignificantPaths
from scenes.pose import wrap_angle
from scenes.record import FloatArray

SHOWN_RANGE_DB = 45.0
AZIMUTH_DECIMALS = 9  # of azimuths in rad that count as the same
MARGIN_DEG = 10.0  # around the beams
STATUS_LOOK = {
    PathStatus.DETECTED: ("estimated, detected", "x", SLAM),
    PathStatus.WEAK: ("estimated, weak or diffuse", "+", "#56B4E9"),
    PathStatus.FALSE: ("estimated, false", "1", "#FF5FC4"),
}


@styled()
def power_figure(power_map: BeamPowerMap, estimate: ChannelEstimate, tables: ScoreTables) -> Figure:
    """Power in dBm per beam pair of one stop, with significant true paths and estimated ones near the beams."""
    figure = new_figure(8.4, 5.2)
    ax = figure.subplots()
    ax.grid(visible=False)
    mesh = draw_power(ax, power_map)
    sides = ax.get_xlim(), ax.get_ylim()
    figure.colorbar(mesh, ax=ax, label="received power per beam pair in dBm", pad=0.02, extend="min")
    every, paths = tables.significant, tables.paths  # the power map is that of the first TX
    true = every.take("true_path", (every.stop == power_map.stop) & (every.tx == 0))
    found = paths.take("estimate", (paths.stop == power_map.stop) & (paths.tx == 0))
    ax.plot(
        *np.rad2deg(reported_angles(true, found, estimate)).T[::-1], "o", markersize=11, markerfacecolor="none",
        markeredgecolor="white", markeredgewidth=1.3, path_effects=_outlined(),
    )  # fmt: skip
    _draw_estimates(ax, estimate, found)
    ax.set(xlabel="azimuth of arrival in the RX frame, deg", ylabel="azimuth of departure in the TX frame, deg")
    x, y = (np.clip([low - MARGIN_DEG, high + MARGIN_DEG], -180, 180) for low, high in sides)
    ax.set(xlim=x, ylim=y)  # paths far outside the beams are left out
    ax.xaxis.set_major_locator(MultipleLocator(30))
    ax.yaxis.set_major_locator(MultipleLocator(20))
    legend_below(figure, _legend_handles(), 4)
    return figure


def reported_angles(true: SignificantPaths, found: PathScores, estimate: ChannelEstimate) -> FloatArray:
    """Departure and arrival (true_path, 2) in rad of true paths of one stop and TX, as an estimate reports them.

    Horizontal beams see cone angles, which differ from azimuths far from the horizontal plane and behind a panel.
    A path that no estimate detected has its azimuths.
    """
    angles = np.stack([true.aod_azimuth_rad, true.aoa_azimuth_rad], axis=1)
    detected = found.take("estimate", found.status == PathStatus.DETECTED)
    errors = np.stack([detected.aod_error_rad, detected.aoa_error_rad], axis=1)
    reported = np.stack([estimate.aod_azimuth_rad, estimate.aoa_azimuth_rad], axis=1)[detected.path]
    _, here, there = np.intersect1d(true.path, detected.true_path, return_indices=True)
    angles[here] = wrap_angle(reported[there] - errors[there])
    return angles


def strongest_by_azimuth(power_map: BeamPowerMap) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Azimuths (tx,), (rx,) in rad in order, each once, and the power (tx, rx) in dBm of the strongest pair there.

    Beams at several elevations share an azimuth.
    """
    tx_rad, row = np.unique(np.round(power_map.tx_azimuth_rad, AZIMUTH_DECIMALS), return_inverse=True)
    rx_rad, column = np.unique(np.round(power_map.rx_azimuth_rad, AZIMUTH_DECIMALS), return_inverse=True)
    power_dbm = np.full((len(tx_rad), len(rx_rad)), -np.inf)
    np.maximum.at(power_dbm, (row[:, None], column[None, :]), power_map.power_dbm)
    return tx_rad, rx_rad, power_dbm


def draw_power(ax: Any, power_map: BeamPowerMap) -> Any:
    """Draw the power per beam pair over departure and arrival in deg; returns the mesh of its colours."""
    tx_rad, rx_rad, power_dbm = strongest_by_azimuth(power_map)
    top = float(power_dbm.max())
    return ax.pcolormesh(
        np.rad2deg(rx_rad),
        np.rad2deg(tx_rad),
        power_dbm,
        shading="nearest",
        cmap="viridis",
        vmax=top,
        vmin=max(top - SHOWN_RANGE_DB, float(power_dbm.min())),
        rasterized=True,
    )


def _draw_estimates(ax: Any, estimate: ChannelEstimate, paths: PathScores) -> None:
    for status, (_, marker, color) in STATUS_LOOK.items():
        chosen = paths.path[paths.status == status]
        ax.plot(
            np.rad2deg(estimate.aoa_azimuth_rad[chosen]), np.rad2deg(estimate.aod_azimuth_rad[chosen]), marker,
            color=color, markersize=8, markeredgewidth=1.8,
        )  # fmt: skip


def _legend_handles() -> list[Any]:
    true = Line2D(
        [], [], marker="o", linestyle="none", markersize=9, markerfacecolor="none", markeredgecolor="white",
        markeredgewidth=1.3, path_effects=_outlined(), label="true, significant",
    )  # fmt: skip
    return [
        true,
        *(
            Line2D([], [], marker=marker, linestyle="none", color=color, markeredgewidth=1.8, label=label)
            for label, marker, color in STATUS_LOOK.values()
        ),
    ]


def _outlined() -> list[Any]:
    return [patheffects.withStroke(linewidth=2.6, foreground="0.15")]
