"""The data of the true and estimated paths of a stop for the report page."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from estimation.channel.record import ChannelEstimate
from isac_arena.report.figures.path_lines import path_kind
from isac_arena.report.figures.power import reported_angles
from isac_arena.report.page.payload.numbers import rounded
from isac_arena.scoring.causes import cause_words
from isac_arena.scoring.record import PathStatus, ScoreTables
from scenes.pose import wrap_angle
from scenes.record import FloatArray
from sim.propagation.paths import path_labels
from sim.truth import Truth


def estimated_paths(estimate: ChannelEstimate, tables: ScoreTables) -> dict[str, Any]:
    """The estimated paths of a stop with their standard deviations, status and errors."""
    scores = tables.paths.take("estimate", tables.paths.stop == estimate.stop)
    delay_std_s, aod_std_rad, aoa_std_rad = np.sqrt(np.diagonal(estimate.plane_covariance, axis1=1, axis2=2)).T
    return {
        "method": estimate.method,
        "reason": estimate.reason,
        "delay_ns": rounded(1e9 * estimate.delay_s, 3),
        "aod_deg": _degrees(estimate.aod_azimuth_rad),
        "aoa_deg": _degrees(estimate.aoa_azimuth_rad),
        "power_dbm": rounded(estimate.power_dbm, 1),
        "delay_std_ns": rounded(1e9 * delay_std_s, 4),
        "aod_std_deg": rounded(np.rad2deg(aod_std_rad), 4),
        "aoa_std_deg": rounded(np.rad2deg(aoa_std_rad), 4),
        "los": estimate.is_los.tolist(),
        "tx": estimate.tx.tolist(),
        "status": [PathStatus(status).name.lower() for status in scores.status],
        "cause": cause_words(scores.cause),
        "true_path": scores.true_path.tolist(),
        "object": scores.object.tolist(),
        "delay_error_ns": rounded(1e9 * scores.delay_error_s, 3),
        "aod_error_deg": rounded(np.rad2deg(scores.aod_error_rad), 3),
        "aoa_error_deg": rounded(np.rad2deg(scores.aoa_error_rad), 3),
        "power_error_db": rounded(scores.power_error_db, 1),
        "nees": rounded(scores.nees, 2),
    }


def true_paths(truths: Iterable[Truth], estimate: ChannelEstimate, tables: ScoreTables) -> dict[str, Any]:
    """The significant true paths of a stop and all TX in the frames of the devices, with their corners in plan."""
    parts = [_true_paths(truth, estimate, tables) for truth in truths]
    return {name: [value for part in parts for value in part[name]] for name in parts[0]}


def _true_paths(truth: Truth, estimate: ChannelEstimate, tables: ScoreTables) -> dict[str, Any]:
    every, found = tables.significant, tables.paths
    rows = every.take("true_path", (every.stop == truth.stop) & (every.tx == truth.tx))
    of_truth = (found.stop == truth.stop) & (found.tx == truth.tx)
    angles_rad = reported_angles(rows, found.take("estimate", of_truth), estimate)
    paths = truth.paths.take("path", rows.path)
    vertex_m = truth.from_node.paths.vertex_m[rows.path]
    corners = [vertex_m[row, :n, :2] for row, n in enumerate(paths.n_interactions)]
    return {
        "path": rows.path.tolist(),
        "tx": rows.tx.tolist(),
        "label": path_labels(paths).tolist(),
        "kind": [path_kind(kinds[:n]) for kinds, n in zip(paths.bounce_kind, paths.n_interactions, strict=True)],
        "object": rows.object.tolist(),
        "delay_ns": rounded(1e9 * rows.delay_s, 3),
        "aod_deg": _degrees(angles_rad[:, 0]),
        "aoa_deg": _degrees(angles_rad[:, 1]),
        "power_dbm": rounded(rows.power_dbm, 1),
        "detected": rows.is_detected.tolist(),
        "cause": cause_words(rows.cause),
        "delay_bound_ns": rounded(1e9 * rows.delay_bound_s, 4),
        "aod_bound_deg": rounded(np.rad2deg(rows.aod_bound_rad), 4),
        "aoa_bound_deg": rounded(np.rad2deg(rows.aoa_bound_rad), 4),
        "corners": [rounded(corner, 3) for corner in corners],
    }


def _degrees(azimuth_rad: FloatArray) -> list[float | None]:
    return rounded(np.rad2deg(wrap_angle(azimuth_rad)), 3)
