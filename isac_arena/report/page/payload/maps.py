"""The data of a map for the report page: poses, incidence points, and contours with their objects."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from estimation.slam.record import SolveStatus
from isac_arena.campaign.results import MapResult
from isac_arena.report.figures.bands import Curve, contour_curve, shape_curve
from isac_arena.report.page.payload.numbers import number, rounded
from isac_arena.scoring.causes import LEVEL, LEVEL_WORDS, PHANTOM, cause_words, ghost_words
from isac_arena.scoring.record import ContourScores, IpScores, MapScores, OutlineScores
from scenes.record import BoolArray, IntArray

SHAPE_STEP = 3  # every third sample of the paper's contours is drawn
SHOWN_SCORES = ("iou", "hausdorff_m", "seen_rmse_m", "full_rmse_m", "coverage95", "extent_iou")


def map_payload(result: MapResult, scores: MapScores, stops: Sequence[int]) -> dict[str, Any]:
    """One map, with the poses and points of these stops.

    `ours` and `paper` of a point are its rows in `contours` and in `shapes`, -1 for none.
    """
    poses = result.poses.take("stop", np.isin(result.poses.stop, stops))
    ours, paper = ghost_words(scores.contours), ghost_words(scores.clusters)
    return {
        "poses": {
            "xy": rounded(poses.position_m, 3),
            "heading_deg": rounded(np.rad2deg(poses.heading_rad), 2),
            "status": [SolveStatus(status).name for status in poses.status],
        },
        "ips": _points(result, scores.ips, np.isin(result.ips.stop, stops)),
        "contours": [_contour(result, scores.contours, row, called) for row, called in enumerate(ours)],
        "shapes": [_shape(result, scores.clusters, row, called) for row, called in enumerate(paper)],
    }


def _points(result: MapResult, scores: IpScores, is_drawn: BoolArray) -> dict[str, Any]:
    ips, scores = result.ips.take("ip", is_drawn), scores.take("ip", is_drawn)
    variance, axes = np.linalg.eigh(ips.covariance_m2)
    return {
        "stop": ips.stop.tolist(),
        "path": ips.path.tolist(),
        "xy": rounded(ips.position_m, 3),
        "std_m": rounded(np.sqrt(np.maximum(variance[:, ::-1], 0)), 4),  # along the long axis, across it
        "axis_deg": rounded(np.rad2deg(np.arctan2(axes[:, 1, 1], axes[:, 0, 1])), 1),
        "inlier": ips.is_inlier.tolist(),
        "ours": result.contours.object[is_drawn].tolist(),
        "paper": result.shapes.label[is_drawn].tolist(),
        "object": scores.object.tolist(),
        "cause": cause_words(scores.cause, scores.surface_distance_m),
        "surface_m": rounded(scores.surface_distance_m, 4),
        "error_m": rounded(scores.position_error_m, 4),
        "nees": rounded(scores.nees, 2),
    }


def _contour(result: MapResult, scores: ContourScores, row: int, called: str) -> dict[str, Any]:
    contours = result.contours
    return {
        "kind": str(contours.kind[row]),
        "status": str(contours.status[row]),
        "cluster": int(contours.cluster[row]),
        "extent_m": number(contours.extent_m[row], 3),
        "extent_std_m": number(contours.extent_std_m[row], 3),
        "classes": contours.class_name.tolist(),
        "probability": rounded(contours.class_probability[row], 3),
        **_origin(scores, row, contours.object, called),
        **_curve(contour_curve(contours, row)),
    }


def _shape(result: MapResult, scores: OutlineScores, row: int, called: str) -> dict[str, Any]:
    shapes = result.shapes
    return {
        "kind": "star-convex",
        "mean_m": number(shapes.mean_m[row], 3),
        "signal_std_m": number(shapes.signal_std_m[row], 3),
        "length_scale": number(shapes.length_scale[row], 3),
        "noise_std_m": number(shapes.noise_std_m[row], 4),
        **_origin(scores, row, shapes.label, called),
        **_curve(shape_curve(shapes, row, SHAPE_STEP)),
    }


def _origin(scores: OutlineScores, row: int, label: IntArray, called: str) -> dict[str, Any]:
    """The object of a contour, what it is `called` where the plan has none, and its scores."""
    name = str(scores.object[row])
    level, other = name in LEVEL, f"{PHANTOM}, paths off {name}" if scores.is_false[row] else ""
    return {
        "object": name,
        "ghost": bool(scores.is_false[row]) or level,
        "called": LEVEL_WORDS if level else called if scores.is_ghost[row] else other,
        "found": bool(scores.is_found[row]),
        "purity": number(scores.purity[row], 3),
        "n_ips": int((label == row).sum()),
        "scores": {name: number(getattr(scores, name)[row], 4) for name in SHOWN_SCORES},
    }


def _curve(curve: Curve) -> dict[str, Any]:
    return {
        "closed": curve.is_closed,
        "xy": rounded(curve.points_m, 3),
        "outer": rounded(curve.outer_m, 3),
        "inner": rounded(curve.inner_m, 3),
    }
