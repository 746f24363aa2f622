"""The data of the report page: one dictionary of plain numbers and texts from the records of a campaign."""

from collections.abc import Collection, Iterable, Mapping
from itertools import groupby
from typing import Any

import matplotlib
import numpy as np
from matplotlib.colors import to_hex

from isac_arena.campaign.results import CampaignResults
from isac_arena.report.figures.map import whole_view
from isac_arena.report.figures.plan import plan_view
from isac_arena.report.figures.power import strongest_by_azimuth
from isac_arena.report.page.payload.maps import map_payload
from isac_arena.report.page.payload.numbers import POWER_STEP_DB, number, quantised_power, rounded, significant
from isac_arena.report.page.payload.paths import estimated_paths, true_paths
from isac_arena.report.page.payload.thinning import drawn_stops
from isac_arena.report.page.payload.tracks import track_payload
from isac_arena.scoring.record import PoseScores, ScoreTables
from isac_arena.scoring.words import WORDS
from scenes.scene import Scene
from sim.truth import Truth

OUTLINE_SAGITTA_M = 0.0005
POWER_COLORS = 33  # colours of the map, from the weakest to the strongest power

Payload = dict[str, Any]


def report_payload(
    name: str,
    scene: Scene,
    results: CampaignResults,
    tables: ScoreTables,
    truths: Iterable[Truth] = (),
    budget: list[dict[str, Any]] | None = None,
    txs: Mapping[str, str] | None = None,
    uplinks: Collection[str] = (),
) -> Payload:
    """All data of the page, ready for JSON: lengths in m, delays in ns, angles in deg, powers in dBm.

    Numbers are rounded to the resolution of a screen. Points are flat lists of x and y. None stands for an unknown
    value. Rows of stops, paths, incidence points and contours keep the order of their records; of a long campaign
    only the `drawn_stops` and their points are there. `truths` gives the corners of the true paths, one stop at a
    time; a measured campaign has no truths and no power maps. `budget` has the rows of the error budget,
    None if there is none. `txs` are the TX of the scene by the names of their links; those of `uplinks` receive.
    """
    stops = drawn_stops(results)
    every = {estimate.stop: estimate for estimate in results.channel}
    channel = {stop: every[stop] for stop in stops}
    by_stop = {
        stop: true_paths(group, channel[stop], tables)
        for stop, group in groupby(truths, key=lambda truth: truth.stop)
        if stop in channel
    }
    poses = tables.poses.take("stop", np.isin(tables.poses.stop, stops))
    return {
        "name": name,
        "words": WORDS,
        "has_truth": bool(by_stop),
        "angles": tables.paths.angle_names,
        "scene": {
            **_scene(scene, txs or {scene.tx_name: scene.tx_name}, uplinks),
            "extent": rounded(whole_view(scene, [results.mapping, results.slam]), 2),
        },
        "n_stops": len(tables.poses.stop),
        "stops": _stops(scene, poses),
        "estimated": [estimated_paths(channel[stop], tables) for stop in stops],
        "true": [by_stop.get(stop) for stop in stops],
        "power": _power(results, stops),
        "maps": {
            "mapping": map_payload(results.mapping, tables.mapping, stops),
            "slam": map_payload(results.slam, tables.slam, stops),
        },
        "tracks": track_payload(scene, list(channel.values()), results.slam.tracks),
        "budget": budget,
    }


def _scene(scene: Scene, txs: Mapping[str, str], uplinks: Collection[str]) -> Payload:
    objects = [
        {
            "name": item.name,
            "kind": item.kind,
            "closed": item.contour.closed,
            "xy": rounded(item.contour.vertices(OUTLINE_SAGITTA_M), 3),
        }
        for item in scene.objects
    ]
    return {
        "name": scene.name,
        "view": rounded(plan_view(scene, "walk"), 2),
        "objects": objects,
        "clutter": [
            {"name": mesh.name, "rings": [rounded(ring, 3) for ring in mesh.plan_outlines_m]}
            for mesh in scene.clutter
        ],
        "txs": [
            {
                "name": name if len(txs) > 1 else "TX",
                "xy": rounded(scene.txs[node].position_m[:2], 3),
                "heading_deg": number(np.rad2deg(scene.txs[node].heading_rad), 2),
                "receives": name in uplinks,
            }
            for name, node in txs.items()
        ],
        "walk": rounded(scene.walk.line_m(), 2),
    }


def _stops(scene: Scene, poses: PoseScores) -> Payload:
    return {
        "stop": poses.stop.tolist(),
        "los": poses.has_los.tolist(),
        "xy": rounded(poses.true_position_m, 3),
        "heading_deg": rounded(np.rad2deg(scene.walk.headings_rad()[poses.stop]), 2),
        "position_error_m": significant(poses.position_error_m),
        "heading_error_deg": significant(np.rad2deg(poses.heading_error_rad)),
        "clock_error_ns": significant(1e9 * poses.clock_error_s),
        "position_bound_m": significant(poses.position_bound_m),
        "heading_bound_deg": significant(np.rad2deg(poses.heading_bound_rad)),
        "clock_bound_ns": significant(1e9 * poses.clock_bound_s),
        "influential": poses.most_influential_path.tolist(),
        "influence_m": significant(poses.path_influence_m),
    }


def _power(results: CampaignResults, stops: list[int]) -> Payload | None:
    """Beam power maps of the stops, beams in order of azimuth; None without any, or if stops have other beams."""
    beams = {(one.tx_azimuth_rad.tobytes(), one.rx_azimuth_rad.tobytes()) for one in results.power_maps}
    if len(beams) != 1:
        return None
    maps = {power_map.stop: power_map for power_map in results.power_maps}
    tx_rad, rx_rad, _ = strongest_by_azimuth(results.power_maps[0])
    levels = [quantised_power(strongest_by_azimuth(maps[stop])[2]) for stop in stops]
    shades = matplotlib.colormaps["viridis"](np.linspace(0, 1, POWER_COLORS))
    return {
        "tx_deg": rounded(np.rad2deg(tx_rad), 2),
        "rx_deg": rounded(np.rad2deg(rx_rad), 2),
        "n_pairs": results.power_maps[0].power_dbm.size,
        "step_db": POWER_STEP_DB,
        "top_dbm": [top for top, _ in levels],
        "below": [below for _, below in levels],
        "colors": [to_hex(shade) for shade in shades],
    }
