"""All figures of a report with their captions."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

from isac_arena.campaign.results import CampaignResults, MapResult
from isac_arena.report.figures.by_tx import by_tx_figure
from isac_arena.report.figures.cdf import channel_cdf_figure, pose_cdf_figure, surface_cdf_figure
from isac_arena.report.figures.cluster import cluster_figure
from isac_arena.report.figures.map import map_figure
from isac_arena.report.figures.power import power_figure, strongest_by_azimuth
from isac_arena.report.style import png_bytes
from isac_arena.scoring.causes import LEVEL
from isac_arena.scoring.record import MapScores, PathStatus, ScoreTables
from isac_arena.scoring.score import Scores
from scenes.scene import Scene

Section = Literal["channel", "map", "pose", "shape"]


@dataclass(frozen=True)
class ReportFigure:
    """A figure with its section, title and caption in the report."""

    name: str
    section: Section
    title: str
    caption: str
    figure: Figure

    @cached_property
    def png(self) -> bytes:
        """The figure as a PNG file."""
        return png_bytes(self.figure)


def make_figures(
    scene: Scene,
    results: CampaignResults,
    scores: Scores,
    power_map_stop: int | None = None,
    txs: Mapping[str, str] | None = None,
) -> dict[str, ReportFigure]:
    """All figures of a campaign by name, in the order of the report.

    `power_map_stop` is the stop whose power map is shown: by default the stop with the most detected paths. A
    measured campaign has no power maps and no errors of its channel parameters. `txs` are the TX of
    the scene by the names of their links.

    Raises `ValueError` where the stop has no power map.
    """
    tables = scores.tables
    figures = [
        _map(scene, results, tables),
        *_by_tx(scene, txs or {}, results),
        *_channel(results, tables, power_map_stop),
        _surface_distances(tables),
        _pose_errors(tables),
        *_clusters("mapping", scene, results.mapping, tables.mapping),
        *_clusters("slam", scene, results.slam, tables.slam),
    ]
    return {figure.name: figure for figure in figures}


def _map(scene: Scene, results: CampaignResults, tables: ScoreTables) -> ReportFigure:
    caption = (
        f"Plan of '{scene.name}' with the incidence points (IPs) of {len(tables.poses.stop)} receiver stops, "
        "coloured by the object they support, and the contour of every object with its 95 % interval. Dashed: "
        "contours of clusters by the published method. Left: mapping with the true receiver pose and clock. "
        "Right: SLAM, which estimates both; a thin line connects each estimated position to the true one. "
        "Contours are numbered as in the files. A ghost is a contour with most of its IPs from no single bounce; "
        "if they lie on a true surface all the same, it is a right surface by wrong paths."
        f"{_level_contours(tables)}"
    )
    return ReportFigure("map", "map", "Maps", caption, map_figure(scene, results, tables))


def _level_contours(tables: ScoreTables) -> str:
    """A sentence about the contours off floor and ceiling, which no plan shows in place; empty without any."""
    numbers = {
        label: ", ".join(str(row) for row, name in enumerate(scores.contours.object) if name in LEVEL)
        for label, scores in (("mapping", tables.mapping), ("SLAM", tables.slam))
    }
    found = "; ".join(f"{numbers[label]} in {label}" for label in numbers if numbers[label])
    return f" Contours from points of floor or ceiling have these numbers: {found}." if found else ""


def _by_tx(scene: Scene, txs: Mapping[str, str], results: CampaignResults) -> Iterator[ReportFigure]:
    if len(txs) > 1:
        caption = (
            "Mapping with the true receiver pose: incidence points in the colour of the TX that they come from. A "
            "coloured line follows the part of a closed contour where this TX has points. Where there are several "
            "lines several TX saw it; where there is none no TX did, and the contour is prior."
        )
        figure = by_tx_figure(scene, txs, results.mapping)
        yield ReportFigure("by_tx", "map", "What each TX saw", caption, figure)


def _channel(results: CampaignResults, tables: ScoreTables, stop: int | None) -> Iterator[ReportFigure]:
    if results.power_maps:
        yield _power_map(results, tables, stop)
    if np.isfinite(tables.paths.delay_error_s).any() or results.power_maps:
        yield _channel_errors(tables)


def _power_map(results: CampaignResults, tables: ScoreTables, stop: int | None) -> ReportFigure:
    stop = best_stop(tables) if stop is None else stop
    row = {power_map.stop: index for index, power_map in enumerate(results.power_maps)}
    if stop not in row:
        raise ValueError(f"power_map_stop = {stop}: must be one of the {len(row)} stops of the campaign")
    power_map, estimate = results.power_maps[row[stop]], results.channel[row[stop]]
    n_tx, n_rx = power_map.power_dbm.shape
    cells = strongest_by_azimuth(power_map)[2]
    most = ", of pairs with the same two azimuths the strongest" if cells.size < n_tx * n_rx else ""
    caption = (
        f"Mean received power of each of the {n_tx} x {n_rx} beam pairs at stop {stop}{most}. Circles: true paths "
        "within the estimator's dynamic range, those far outside the beams left out. Marks: estimated paths by "
        "status. Strong paths have side-lobe stripes along both axes; paths that differ only in delay coincide."
    )
    figure = power_figure(power_map, estimate, tables)
    return ReportFigure("power_map", "channel", f"Power map of stop {stop}", caption, figure)


def best_stop(tables: ScoreTables) -> int:
    """The stop with the most detected paths, the first of equal ones."""
    detected = tables.paths.stop[tables.paths.status == PathStatus.DETECTED]
    counts = [(detected == stop).sum() for stop in tables.poses.stop]
    return int(tables.poses.stop[int(np.argmax(counts))])


def _channel_errors(tables: ScoreTables) -> ReportFigure:
    n, angles = int((tables.paths.status == PathStatus.DETECTED).sum()), tables.paths.angle_names
    caption = (
        f"Absolute errors of delay, {angles['aod']} of departure (AoD) and {angles['aoa']} of arrival (AoA) of "
        f"the {n} detected paths, by the kind of the true path. Estimates with errors larger than the gate are "
        "not assigned and not shown."
    )
    figure = channel_cdf_figure(tables.paths)
    return ReportFigure("cdf_channel", "channel", "Errors of the channel parameters", caption, figure)


def _surface_distances(tables: ScoreTables) -> ReportFigure:
    inliers = [one.ips.take("ip", one.ips.is_inlier) for one in (tables.mapping, tables.slam)]
    whole = [len(ips.stop) for ips in inliers]
    known = [np.isfinite(ips.position_error_m).sum() for ips in inliers]
    caption = (
        f"IPs taken as single bounces, {whole[0]} in mapping and {whole[1]} in SLAM. Left: distance to the "
        f"nearest true surface. Right: distance to the true incidence point of the {known[0]} and {known[1]} that "
        "come from detected single bounces: others are sums of many weak paths, with no one true point."
    )
    figure = surface_cdf_figure(tables)
    return ReportFigure("cdf_ip_to_surface", "map", "Errors of the incidence points", caption, figure)


def _pose_errors(tables: ScoreTables) -> ReportFigure:
    n_los = int(tables.poses.has_los.sum())
    caption = (
        "Absolute errors of the receiver states found by SLAM, over the stops it solved. "
        f"{n_los} of {len(tables.poses.stop)} stops have a line of sight within the estimator's dynamic range."
    )
    figure = pose_cdf_figure(tables.poses)
    return ReportFigure("cdf_pose", "pose", "Errors of the receiver state", caption, figure)


def _clusters(name: str, scene: Scene, result: MapResult, table: MapScores) -> Iterator[ReportFigure]:
    label = {"mapping": "Mapping", "slam": "SLAM"}[name]
    shapes, clusters = result.shapes, table.clusters
    for cluster in range(len(shapes.center_m)):
        shown = str(clusters.object[cluster]) or ("ghost" if clusters.is_ghost[cluster] else "several objects")
        title = f"{label}, published method, cluster {cluster}: {shown}"
        caption = (
            f"{clusters.n_ips[cluster]} incidence points. Left: radius about the object centre with its 95 % "
            f"interval. Right: the contour in the plane. Hyperparameters: mean {shapes.mean_m[cluster]:.2f} m, "
            f"sigma_f {shapes.signal_std_m[cluster]:.3f} m, l {shapes.length_scale[cluster]:.2f}, "
            f"sigma_n {shapes.noise_std_m[cluster]:.3f} m."
        )
        figure = cluster_figure(scene, result, cluster, str(clusters.object[cluster]), title)
        yield ReportFigure(f"{name}_cluster_{cluster:02d}", "shape", title, caption, figure)
