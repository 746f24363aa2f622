"""What each of several TX shows: paths, incidence points, and the parts of the contours that it saw."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from isac_arena.campaign.results import MapResult
from isac_arena.report.figures.plan import draw_plan
from isac_arena.report.style import legend_below, new_figure, styled
from isac_arena.scoring.record import PathStatus, ScoreTables
from isac_arena.scoring.stages.shapes import SEEN_MARGIN_RAD, seen_samples
from scenes.record import BoolArray, FloatArray
from scenes.scene import Scene

TX_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
LEGEND_COLUMNS = 4
OFFSET_M = 0.08  # of the line of a TX from the contour, times its number


@dataclass(frozen=True)
class TxShare:
    """What one TX contributed to a campaign, and to its map with the known receiver."""

    name: str
    n_paths: int  # significant true paths
    n_detected: int
    n_false: int
    n_points: int  # incidence points taken as single bounces
    seen: float  # mean share of the outlines of closed contours that it saw; NaN without any
    alone: float  # and that no other TX saw

    @property
    def text(self) -> str:
        """A line for the head of the report."""
        outline = f"; saw {self.seen:.0%} of the outlines of closed contours, {self.alone:.0%} alone"
        return (
            f"{self.n_detected} of {self.n_paths} significant paths detected, {self.n_false} false;"
            f" {self.n_points} incidence points{outline if np.isfinite(self.seen) else ''}"
        )


def tx_shares(names: Sequence[str], result: MapResult, tables: ScoreTables) -> list[TxShare]:
    """The share of every TX, in the order of the campaign."""
    seen = [_seen_by_tx(result, row, len(names)) for row in _closed(result)]
    found = []
    for tx, name in enumerate(names):
        paths, true = tables.paths, tables.significant
        own = [float(one[tx].mean()) for one in seen]
        alone = [float((one[tx] & (one.sum(axis=0) == 1)).mean()) for one in seen]
        found.append(
            TxShare(
                name,
                int((true.tx == tx).sum()),
                int(((paths.tx == tx) & (paths.status == PathStatus.DETECTED)).sum()),
                int(((paths.tx == tx) & (paths.status == PathStatus.FALSE)).sum()),
                int((result.ips.is_inlier & (result.ips.tx == tx)).sum()),
                float(np.mean(own)) if own else np.nan,
                float(np.mean(alone)) if alone else np.nan,
            )
        )
    return found


@styled()
def by_tx_figure(scene: Scene, txs: Mapping[str, str], result: MapResult) -> Figure:
    """Plan with the incidence points in the colour of their TX, and a line along what it saw of each contour.

    `txs` are the TX of the scene by the names of their links.
    """
    figure = new_figure(8.4, 6.4)
    ax = figure.subplots()
    draw_plan(ax, scene, labels=False, extent="all")
    ips = result.ips
    handles = []
    for tx, (name, node) in enumerate(txs.items()):
        color = TX_COLORS[tx % len(TX_COLORS)]
        ax.plot(*ips.position_m[ips.is_inlier & (ips.tx == tx)].T, ".", color=color, markersize=3.0, zorder=3)
        ax.plot(*scene.txs[node].position_m[:2], "D", color=color, markeredgecolor="black", markersize=7, zorder=7)
        handles.append(Line2D([], [], marker="D", color=color, markeredgecolor="black", label=name))
        for row in _closed(result):
            line = offset_outline(result.contours.contour_m[row], OFFSET_M * (tx + 1))
            line[~_seen_by_tx(result, row, len(txs))[tx]] = np.nan
            ax.plot(*line.T, color=color, linewidth=2.0, zorder=5)
    legend_below(figure, handles, min(len(txs), LEGEND_COLUMNS))
    return figure


def _closed(result: MapResult) -> list[int]:
    """Rows of the closed contours."""
    return np.flatnonzero(result.contours.is_closed).tolist()


def _seen_by_tx(result: MapResult, row: int, n_tx: int) -> BoolArray:
    """Samples (tx, sample) of a closed contour within the margin of an incidence point of each TX."""
    contours, ips = result.contours, result.ips
    centre = contours.center_m[row]
    angle = np.arctan2(*(contours.contour_m[row] - centre).T[::-1])
    mine = contours.object == row
    members = [ips.position_m[mine & (ips.tx == tx)] - centre for tx in range(n_tx)]
    return np.array([seen_samples(angle, np.arctan2(*one.T[::-1]), SEEN_MARGIN_RAD) for one in members])


def offset_outline(points_m: FloatArray, distance_m: float) -> FloatArray:
    """Points (sample, xy) of a closed contour moved outwards from its middle."""
    away = points_m - points_m.mean(axis=0)
    return np.asarray(points_m + distance_m * away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9))
