"""Parts of the 3-D view as plotly traces: bodies, devices, paths, contours."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from isac_arena.report.figures.bands import Curve, line_m
from isac_arena.report.figures.path_lines import COLORS, PathLine
from isac_arena.report.figures.plan import KIND_WORDS
from scenes.meshes.mesh import PLANE_COLOR, object_meshes
from scenes.objects.scene_object import KIND_COLORS
from scenes.pose import Pose, direction
from scenes.record import FloatArray
from scenes.scene import Scene

MESH_SAGITTA_M = 0.005
OPACITY = {"wall": 0.16, "polygon": 0.16, "floor": 0.5, "ceiling": 0.25}  # others are nearly solid
SOLID_OPACITY = 0.55
FRAME_M = 0.8  # length of the axes of a device
FRAME_COLORS = {"x": "#D55E00", "y": "#009E73", "z": "#0072B2"}
WIDTHS = {  # of rays in pixels; no dashes, because their length changes with the view
    "line of sight": 7.0, "one reflection": 4.5, "two reflections": 3.0,
    "three reflections": 2.0, "diffracted": 2.5, "through walls": 3.5,
    "over a target": 4.0,
}  # fmt: skip

SEVERAL_BOUNCES = ("two reflections", "three reflections")  # hidden at first: they would hide the hall

Trace = dict[str, Any]


def body_traces(scene: Scene) -> list[Trace]:
    """One mesh per kind of object, then floor and ceiling; the ceiling is hidden at first."""
    kinds = scene.kinds
    parts = sorted(
        ((kinds.get(part.object_name, part.object_name), part) for part in object_meshes(scene, MESH_SAGITTA_M)),
        key=lambda entry: entry[0],
    )
    traces = []
    for kind, members in groupby(parts, key=lambda entry: entry[0]):
        meshes = [(part.object_name, part.mesh.vertices, part.mesh.faces) for _, part in members]
        mesh = _mesh([vertices for _, vertices, _ in meshes], [faces for _, _, faces in meshes])
        names = np.repeat([name for name, _, _ in meshes], [len(vertices) for _, vertices, _ in meshes])
        traces.append(
            {
                **mesh,
                "name": KIND_WORDS.get(kind, kind),
                "text": names.tolist(),
                "hovertemplate": "%{text}<extra></extra>",
                "color": KIND_COLORS.get(kind, PLANE_COLOR),
                "opacity": OPACITY.get(kind, SOLID_OPACITY),
                "flatshading": True,
                "showlegend": True,
                "visible": "legendonly" if kind == "ceiling" else True,
            }
        )
    return traces


def device_traces(scene: Scene, nodes: Mapping[str, Pose]) -> list[Trace]:
    """The TX by name with their frames, and all stops of the walk; `nodes` are those of all TX or links."""
    txs = {name: pose for name, pose in scene.txs.items() if any(pose is node for node in nodes.values())}
    tx_m, stops = (np.array([pose.position_m for pose in poses]) for poses in (txs.values(), scene.stops))
    return [
        _points(tx_m, "TX", list(txs), {"symbol": "diamond", "size": 6, "color": "#000000"}),
        *(frame for name, pose in txs.items() for frame in frame_traces(pose, name)),
        _points(
            stops, "RX stops", [f"stop {stop}" for stop in range(len(stops))],
            {"symbol": "circle", "size": 3, "color": "#1e8449"},
        ),
    ]  # fmt: skip


def frame_traces(pose: Pose, device: str) -> list[Trace]:
    """The axes of a device, x along its heading."""
    heading = pose.heading_rad
    ends = zip(FRAME_COLORS, frame_axes(heading), strict=True)
    return [
        {
            **_line(np.stack([pose.position_m, pose.position_m + FRAME_M * axis])),
            "name": f"{device} {name}",
            "line": {"color": FRAME_COLORS[name], "width": 6},
            "mode": "lines+text",
            "text": ["", name],
            "hoverinfo": "skip",
            "showlegend": False,
        }
        for name, axis in ends
    ]


def frame_axes(heading_rad: float) -> FloatArray:
    """Unit vectors (axis, xyz) of a level device in the world frame."""
    forward, left = direction(heading_rad), direction(heading_rad + np.pi / 2)
    return np.stack([forward, left, np.cross(forward, left)])


def ray_traces(lines: Iterable[PathLine]) -> list[Trace]:
    """One trace per kind in `COLORS`, in that order; a trace is empty where the stop has no path of its kind.

    Kinds differ in colour and width, and the legend switches each kind on and off.
    """
    known = list(lines)
    return [
        {
            **_line(join_lines([line.points_m for line in known if line.kind == kind])),
            "name": kind,
            "line": {"color": color, "width": WIDTHS[kind]},
            "mode": "lines",
            "hovertemplate": f"{kind}<extra></extra>",
            "showlegend": True,
            "visible": "legendonly" if kind in SEVERAL_BOUNCES else True,
        }
        for kind, color in COLORS.items()
    ]


def estimate_trace(ways_m: Sequence[FloatArray]) -> Trace:
    """Lines (point, xyz) of estimated paths through their incidence points."""
    return {
        **_line(join_lines(ways_m)),
        "name": "estimated, mapping",
        "line": {"color": "#8A8A8A", "width": 2},
        "mode": "lines+markers",
        "marker": {"size": 2, "color": "#000000"},
        "hovertemplate": "estimated<extra></extra>",
        "showlegend": True,
    }


def contour_traces(curves: Sequence[Curve], name: str, color: str, z_m: tuple[float, float]) -> list[Trace]:
    """Contours as upright sheets between two heights, and the edges of their bands at the upper one."""
    rings = [line_m(curve.points_m, is_closed=curve.is_closed) for curve in curves]
    edges = [
        line_m(edge, is_closed=curve.is_closed) for curve in curves for edge in (curve.outer_m, curve.inner_m)
    ]
    sheets = [_sheet(ring, z_m) for ring in rings]
    mesh = _mesh([vertices for vertices, _ in sheets], [faces for _, faces in sheets])
    at_top = [np.column_stack([edge, np.full(len(edge), z_m[1])]) for edge in edges]
    return [
        {
            **mesh,
            "name": name,
            "legendgroup": name,
            "color": color,
            "opacity": 0.75,
            "hovertemplate": f"{name}<extra></extra>",
            "showlegend": True,
        },
        {
            **_line(join_lines(at_top)),
            "name": f"{name}, 95 % band",
            "legendgroup": name,
            "line": {"color": color, "width": 3, "dash": "dot"},
            "mode": "lines",
            "hoverinfo": "skip",
            "showlegend": True,
        },
    ]


def join_lines(ways_m: Sequence[FloatArray]) -> FloatArray:
    """Lines (point, xyz) one after the other as one array, with a row of NaN after each."""
    gap = np.full((1, 3), np.nan)
    return np.concatenate([np.zeros((0, 3)), *(part for way in ways_m for part in (way, gap))])


def coordinates(points_m: FloatArray) -> dict[str, list[float | None]]:
    """x, y and z of points (point, xyz) to the millimetre, None where a line is interrupted."""
    rows = np.round(points_m, 3)
    return {
        name: [None if np.isnan(value) else float(value) for value in rows[:, axis]]
        for axis, name in enumerate("xyz")
    }


def _line(points_m: FloatArray) -> Trace:
    return {"type": "scatter3d", **coordinates(points_m)}


def _points(points_m: FloatArray, name: str, text: list[str], marker: dict[str, Any]) -> Trace:
    return {
        **_line(points_m),
        "mode": "markers",
        "name": name,
        "text": text,
        "marker": marker,
        "hovertemplate": "%{text}<extra></extra>",
        "showlegend": True,
    }


def _mesh(vertices_m: Sequence[FloatArray], faces: Sequence[Any]) -> Trace:
    """Bodies as one mesh trace."""
    starts = np.cumsum([0, *map(len, vertices_m)])
    corners = np.concatenate(
        [np.zeros((0, 3), int), *(np.asarray(part) + start for part, start in zip(faces, starts, strict=False))]
    )
    triples = {name: corners[:, axis].tolist() for axis, name in enumerate("ijk")}
    return {"type": "mesh3d", **coordinates(np.concatenate([np.zeros((0, 3)), *vertices_m])), **triples}


def _sheet(ring_m: FloatArray, z_m: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Vertices (vertex, xyz) and triangles (face, corner) of an upright sheet over a line (point, xy)."""
    n = len(ring_m)
    low, high = (np.column_stack([ring_m, np.full(n, z)]) for z in z_m)
    k = np.arange(n - 1)
    faces = np.concatenate([np.stack([k, k + 1, n + k], 1), np.stack([k + 1, n + k + 1, n + k], 1)])
    return np.concatenate([low, high]), faces
