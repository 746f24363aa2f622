"""The 3-D view of a campaign in one self-contained page: scene, devices, paths of a stop and contours."""

from collections.abc import Mapping, Sequence
from html import escape
from string import Template
from typing import Any

import numpy as np
import plotly.graph_objects as go
import plotly.io

from isac_arena.campaign.results import CampaignResults, MapResult
from isac_arena.report.figures.bands import Curve, contour_curve, shape_curve
from isac_arena.report.figures.path_lines import PathLine
from isac_arena.report.figures.plan import plan_view
from isac_arena.report.style import MAPPING, SLAM
from isac_arena.report.view.traces import (
    Trace,
    body_traces,
    contour_traces,
    device_traces,
    estimate_trace,
    frame_traces,
    ray_traces,
)
from scenes.pose import Pose
from scenes.record import FloatArray
from scenes.scene import Scene

CONTOUR_MARGIN_M = 0.4  # of the top of the contours above the receiver
EYE = {"x": -1.0, "y": -1.35, "z": 1.1}

# The page may request no address. Plotly needs 'unsafe-eval' because it compiles some drawing code from text.
PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data: blob:;
 style-src 'unsafe-inline'; script-src 'unsafe-inline' 'unsafe-eval'; worker-src blob:; connect-src data: blob:">
<title>$title</title>
<style>
html, body { margin: 0; height: 100%; color: #222; background: #fff; }
body { font: 15px/1.4 system-ui, "DejaVu Sans", sans-serif; }
body { display: flex; flex-direction: column; }
h1 { font-size: 1.15rem; margin: .6rem 1rem 0; }
main { flex: 1; min-height: 24rem; }
</style>
</head>
<body>
<h1>$title</h1>
<main>$view</main>
<script>window.addEventListener("load", () => { document.documentElement.dataset.ready = "yes"; });</script>
</body>
</html>
"""


def view_page(
    name: str,
    scene: Scene,
    results: CampaignResults,
    lines: Sequence[Sequence[PathLine]],
    stop: int,
    nodes: Mapping[str, Pose],
) -> str:
    """The 3-D view as one self-contained HTML page, with its slider at `stop`.

    `lines` are the true paths of every stop in order, of all TX. A measured campaign has none: then only estimated
    paths are drawn. `nodes` are the fixed nodes of all TX or links by name. Axes are in m; contours reach from the
    floor to a little above the receiver.

    Raises `ValueError` where the campaign has no such stop.
    """
    n_stops = len(scene.stops)
    if not 0 <= stop < n_stops:
        raise ValueError(f"stop = {stop}: the campaign has stops 0 to {n_stops - 1}")
    still = [*body_traces(scene), *device_traces(scene, nodes), *_contours(scene, results)]
    tx_m = np.array([pose.position_m for pose in nodes.values()])
    by_stop = [_stop_traces(scene.stops[one], results, lines[one], tx_m, one) for one in range(n_stops)]
    figure = go.Figure(data=[*still, *by_stop[stop]], layout=_layout(scene))
    moving = list(range(len(still), len(still) + len(by_stop[stop])))
    figure.update_layout(sliders=[_slider(by_stop, moving, stop)])
    view = plotly.io.to_html(
        figure,
        full_html=False,
        include_plotlyjs=True,
        div_id="view",
        config={"responsive": True, "displaylogo": False},
        default_width="100%",
        default_height="100%",
    )
    return Template(PAGE).substitute(title=escape(f"{name}: 3-D view"), view=view)


def _stop_traces(
    pose: Pose, results: CampaignResults, lines: Sequence[PathLine], tx_m: FloatArray, stop: int
) -> list[Trace]:
    """The traces that change with the stop: the frame of the receiver, its true and its estimated paths."""
    ways = estimated_ways(results.mapping, tx_m, pose.position_m, stop)
    return [*frame_traces(pose, "RX"), *ray_traces(lines), estimate_trace(ways)]


def estimated_ways(result: MapResult, txs_m: FloatArray, rx_m: FloatArray, stop: int) -> list[FloatArray]:
    """TX, incidence point and RX (point, xyz) of every path of a stop that was taken as a single bounce.

    `txs_m` (tx, xyz) are the TX that the incidence points count.
    A point without an estimated height is put on the path whose height changes evenly from the TX to the RX.
    """
    ips = result.ips
    ways = []
    for row in np.flatnonzero((ips.stop == stop) & ips.is_inlier):
        point, height, tx_m = ips.position_m[row], float(ips.height_m[row]), txs_m[ips.tx[row]]
        if np.isnan(height):
            there, back = np.linalg.norm(point - tx_m[:2]), np.linalg.norm(point - rx_m[:2])
            height = float(tx_m[2] + (rx_m[2] - tx_m[2]) * there / max(there + back, 1e-9))
        ways.append(np.stack([tx_m, [*point, height], rx_m]))
    return ways


def _contours(scene: Scene, results: CampaignResults) -> list[Trace]:
    floor_m = scene.floor.z_m if scene.floor else 0.0
    z_m = (floor_m, scene.walk.height_m + CONTOUR_MARGIN_M)
    traces: list[Trace] = []
    for label, result, color in (("mapping", results.mapping, MAPPING), ("SLAM", results.slam, SLAM)):
        ours = [contour_curve(result.contours, row) for row in range(len(result.contours))]
        paper = [shape_curve(result.shapes, row) for row in range(len(result.shapes.center_m))]
        made: tuple[tuple[str, list[Curve]], ...] = (("our contours", ours), ("published method", paper))
        for source, curves in made:
            if curves:
                shown = label == "mapping" and curves is (ours or paper)
                visible = True if shown else "legendonly"
                found = contour_traces(curves, f"{source}, {label}", color, z_m)
                traces += [{**trace, "visible": visible} for trace in found]
    return traces


def _layout(scene: Scene) -> dict[str, Any]:
    x_min, y_min, x_max, y_max = plan_view(scene, "all")
    tops = [item.z_max_m for item in scene.objects]
    z_low = scene.floor.z_m if scene.floor else 0.0
    z_high = scene.ceiling.z_m if scene.ceiling else max([*tops, scene.tx.position_m[2] + 1.0])
    return {
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "legend": {"x": 1.0, "xanchor": "left", "y": 0.94, "font": {"size": 12}},  # beside the hall
        "uirevision": "view",
        "scene": {
            "aspectmode": "data",
            "xaxis": {"title": {"text": "x in m"}, "range": [x_min, x_max]},
            "yaxis": {"title": {"text": "y in m"}, "range": [y_min, y_max]},
            "zaxis": {"title": {"text": "z in m"}, "range": [z_low - 0.01, z_high]},
            "camera": {"eye": EYE, "center": {"x": 0, "y": 0, "z": -0.15}},
        },
    }


def _slider(by_stop: Sequence[Sequence[Trace]], moving: list[int], stop: int) -> dict[str, Any]:
    """A slider over the stops; each step replaces the lines of the previous stop."""
    return {
        "active": stop,
        "currentvalue": {"prefix": "stop "},
        "pad": {"l": 20, "r": 20, "b": 14, "t": 6},
        "steps": [
            {
                "label": str(number),
                "method": "restyle",
                "args": [{name: [trace[name] for trace in traces] for name in "xyz"}, moving],
            }
            for number, traces in enumerate(by_stop)
        ],
    }
