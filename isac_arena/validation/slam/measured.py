"""`arena validate slam`: the measured Campus Arena stops, where their file is at hand.

The data is the authors' and no part of this project: ARENA_DATA names the folder that holds it; by default it is
shared/data beside the repository. Without it every row is NaN, which meets no bar.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np

from estimation.shape.config import ShapeConfig
from estimation.shape.gp.estimate import estimate_shapes
from estimation.slam.config import MappingConfig, SnapshotConfig, TrajectoryConfig
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.slam.snapshot.solution import SnapshotSolution, collect_poses
from estimation.slam.snapshot.solve import solve_snapshot
from estimation.slam.stops import run_slam
from estimation.slam.walk.trajectory import run_trajectory
from isac_arena.campaign.measured import (
    INITIAL_BIAS_M,
    PUBLISHED_MAX_POSITION_STD_M,
    PUBLISHED_NOISE,
    PUBLISHED_TX_OFFSET_DEG,
    MeasuredCampaign,
)
from isac_arena.exchange.mat import read_measurement
from isac_arena.validation.measurement import Measurement
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from scenes.record import BoolArray, FloatArray

N_STOPS = 30
FILE, PLAN = "campus_arena_30.mat", "campus_arena_floorplan.csv"
MAPPING = MappingConfig(noise=PUBLISHED_NOISE)
OURS = SnapshotConfig(
    method="statistical", noise=PUBLISHED_NOISE, max_position_std_m=PUBLISHED_MAX_POSITION_STD_M
)
PUBLISHED = {
    "los": (0.3115, 2.1511, 1.1390),
    "nlos": (0.5475, 2.6034, 2.5046),
    "all": (0.3973, 2.2962, 1.6703),
}
SESSION_STOP = 13
SESSION_OFFSETS_DEG = (-3.8, -1.25)

Row = tuple[str, str, Literal["lower", "higher"], float, str]  # key, unit, direction, bar, reason
Check = Callable[[MeasuredCampaign], list[float]]


def data_folder() -> Path:
    """Folder of the measured data: ARENA_DATA, or shared/data beside the repository."""
    beside = Path(__file__).resolve().parents[4] / "shared" / "data"
    return Path(os.environ.get("ARENA_DATA", beside))


def check_measured_reference(seed: int, quick: bool) -> list[Measurement]:
    """The reference mode against the figures of the published algorithm on the same stops."""
    names = [
        f"measured.reference.{group}.{quantity}_deviation_{unit}"
        for group in PUBLISHED
        for quantity, unit in (("position", "m"), ("heading", "deg"), ("clock", "ns"))
    ]
    rows: list[Row] = [
        (name, name.rsplit("_", 1)[1], "lower", 1e-3, "published to 4 decimals") for name in names
    ]
    return _rows(rows, _reference_deviations)


def check_measured_snapshot(seed: int, quick: bool) -> list[Measurement]:
    """Our snapshot mode: errors, flags, line-of-sight decisions and inliers."""
    rows: list[Row] = [
        ("measured.snapshot.position.rmse_m", "m", "lower", 0.345, "the reference has 0.3973"),
        (
            "measured.snapshot.unflagged_gross_stops",
            "1",
            "lower",
            0,
            "off by > 0.9 m without the two-mode flag",
        ),
        ("measured.snapshot.los_decisions_right", "1", "higher", N_STOPS, "the reference gets all right"),
        ("measured.snapshot.inlier_f1", "1", "higher", 0.97, "labels of the file"),
    ]
    return _rows(rows, _snapshot_scores)


def check_measured_trajectory(seed: int, quick: bool) -> list[Measurement]:
    """Our trajectory mode, stop spacing unknown, and the sessions it finds."""
    rows: list[Row] = [
        ("measured.trajectory.position.rmse_m", "m", "lower", 0.16, "floor 0.12-0.13 m: the survey"),
        ("measured.trajectory.position.max_m", "m", "lower", 0.4, "no stop in a wrong mode"),
        ("measured.session.boundary_error_stops", "1", "lower", 0, "one change, after the 13th stop"),
        ("measured.session.offset_error_deg", "deg", "lower", 0.5, "-3.8 deg before, -1.25 deg after"),
    ]
    return _rows(rows, _trajectory_scores)


def check_measured_maps(seed: int, quick: bool) -> list[Measurement]:
    """Clustered incidence points against the vector floor plan."""
    rows: list[Row] = [
        ("measured.mapping.ip_to_plan.median_m", "m", "lower", 0.080, "with the surveyed receiver"),
        ("measured.slam.ip_to_plan.median_m", "m", "lower", 0.088, "snapshot mode"),
    ]
    return _rows(rows, _plan_distances, PLAN)


def state_errors(campaign: MeasuredCampaign, poses: PoseEstimates) -> FloatArray:
    """Errors (stop, 3) of position in m, heading in deg and clock in ns; infinite for unsolved stops."""
    rx = np.array([[*truth.rx_pose.position_m[:2], truth.rx_pose.heading_rad] for truth in campaign.truths])
    bias_s = np.array([truth.clock_bias_s for truth in campaign.truths])
    error = np.column_stack(
        [
            np.hypot(*(poses.position_m - rx[:, :2]).T),
            np.rad2deg(wrap_angle(poses.heading_rad - rx[:, 2])),
            1e9 * (poses.clock_bias_s - bias_s),
        ]
    )
    return np.asarray(np.nan_to_num(error, nan=np.inf))


def plan_distance_m(segments_m: FloatArray, points_m: FloatArray) -> FloatArray:
    """Distance (point,) of points (point, xy) to the nearest of segments (segment, 4) x0, y0, x1, y1."""
    start, along = segments_m[:, :2], segments_m[:, 2:] - segments_m[:, :2]
    length2 = np.maximum(np.sum(along**2, axis=1), 1e-18)
    offset = points_m[:, None] - start
    share = np.clip(np.einsum("nsi,si->ns", offset, along) / length2, 0.0, 1.0)
    return np.asarray(np.linalg.norm(offset - share[..., None] * along, axis=-1).min(axis=1))


def _rows(rows: Sequence[Row], check: Check, *needed: str) -> list[Measurement]:
    missing = [name for name in (FILE, *needed) if not (data_folder() / name).is_file()]
    if missing:
        reason = f"not measured: {missing[0]} is not in {data_folder()}"
        return [Measurement(key, np.nan, unit, way, bar, reason) for key, unit, way, bar, _ in rows]
    values = check(_campaign())
    return [
        Measurement(key, value, unit, way, bar, reason)
        for (key, unit, way, bar, reason), value in zip(rows, values, strict=True)
    ]


@cache
def _campaign() -> MeasuredCampaign:
    return read_measurement(data_folder() / FILE, clock_bias_m=np.full(N_STOPS, INITIAL_BIAS_M))


@cache
def _solutions() -> tuple[SnapshotSolution, ...]:
    campaign = _campaign()
    return tuple(solve_snapshot(estimate, campaign.tx, OURS) for estimate in campaign.channel)


def _reference_deviations(campaign: MeasuredCampaign) -> list[float]:
    poses, _ = run_slam(campaign.channel, campaign.tx, SnapshotConfig(method="reference"), MAPPING)
    error = state_errors(campaign, poses)
    has_los = _has_los(campaign)
    groups = {"los": has_los, "nlos": ~has_los, "all": np.ones(len(has_los), bool)}
    return [
        float(abs(np.sqrt(np.mean(error[groups[group], column] ** 2)) - PUBLISHED[group][column]))
        for group in PUBLISHED
        for column in range(3)
    ]


def _snapshot_scores(campaign: MeasuredCampaign) -> list[float]:
    solutions = _solutions()
    error = state_errors(campaign, collect_poses(solutions))[:, 0]
    flagged = np.array([solution.is_ambiguous for solution in solutions])
    decided = np.array([solution.status == SolveStatus.LOS for solution in solutions])
    label = np.concatenate([truth.is_los | truth.is_single_bounce for truth in campaign.truths])
    inlier = np.concatenate([solution.is_inlier for solution in solutions])
    f1 = 2 * np.sum(label & inlier) / (label.sum() + inlier.sum())
    return [
        float(np.sqrt(np.mean(error**2))),
        float(np.sum((error > 0.9) & ~flagged)),
        float(np.sum(decided == _has_los(campaign))),
        float(f1),
    ]


def _trajectory_scores(campaign: MeasuredCampaign) -> list[float]:
    poses, _, details = run_trajectory(campaign.channel, campaign.tx, OURS, TrajectoryConfig(), MAPPING)
    error = state_errors(campaign, poses)[:, 0]
    changes = np.flatnonzero(np.diff(details.session)) + 1
    if len(changes) == 0:
        boundary, offset = np.inf, np.inf
    else:
        boundary = np.abs(changes - SESSION_STOP).sum()
        found = PUBLISHED_TX_OFFSET_DEG + np.rad2deg(details.tx_offset_rad[details.session[[0, -1]]])
        offset = np.abs(found - SESSION_OFFSETS_DEG).max()
    return [float(np.sqrt(np.mean(error**2))), float(error.max()), float(boundary), float(offset)]


def _plan_distances(campaign: MeasuredCampaign) -> list[float]:
    segments = np.loadtxt(data_folder() / PLAN, delimiter=",", skiprows=1)
    n = len(campaign.truths)
    known = PoseEstimates(
        stop=np.arange(n),
        position_m=np.array([truth.rx_pose.position_m[:2] for truth in campaign.truths]),
        heading_rad=np.array([truth.rx_pose.heading_rad for truth in campaign.truths]),
        clock_bias_s=np.full(n, INITIAL_BIAS_M / SPEED_OF_LIGHT_M_S),
        status=np.full(n, SolveStatus.GIVEN),
        n_inliers=np.zeros(n, int),
        cost=np.zeros(n),
    )
    _, slam = run_slam(campaign.channel, campaign.tx, OURS, MAPPING)
    maps = (map_stops(campaign.channel, known, campaign.tx, MAPPING), slam)
    return [_clustered_median(segments, points) for points in maps]


def _clustered_median(segments_m: FloatArray, points: IncidencePoints) -> float:
    label = estimate_shapes(points, ShapeConfig()).label
    return float(np.median(plan_distance_m(segments_m, points.position_m[label >= 0])))


def _has_los(campaign: MeasuredCampaign) -> BoolArray:
    return np.array([truth.is_los.any() for truth in campaign.truths])
