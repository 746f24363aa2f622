"""`arena validate slam`: the measured Campus Arena stops, where their file exists (`measured_data.py`)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from estimation.shape.config import ShapeConfig
from estimation.shape.gp.estimate import estimate_shapes
from estimation.slam.config import MappingConfig, SnapshotConfig, TrajectoryConfig
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.slam.snapshot.solution import collect_poses
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
from isac_arena.validation.measured_data import (
    N_STOPS,
    PLAN,
    SESSION_STOP,
    data_folder,
    measured_campaign,
    with_values,
)
from isac_arena.validation.measurement import Measurement, at_least, at_most
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from scenes.record import BoolArray, FloatArray

MAPPING = MappingConfig(noise=PUBLISHED_NOISE)
OURS = SnapshotConfig(
    method="statistical", noise=PUBLISHED_NOISE, max_position_std_m=PUBLISHED_MAX_POSITION_STD_M
)
PUBLISHED = {
    "los": (0.3115, 2.1511, 1.1390),
    "nlos": (0.5475, 2.6034, 2.5046),
    "all": (0.3973, 2.2962, 1.6703),
}  # position in m, heading in deg, clock in ns
SESSION_OFFSETS_DEG = (-3.8, -1.25)


def check_measured_reference(seed: int, quick: bool) -> list[Measurement]:
    """The reference mode against the figures of the published algorithm on the same stops."""
    return with_values(
        [
            at_most(
                f"measured.reference.{group}.{quantity}_deviation_{unit}", np.nan, 1e-3,
                "published to 4 decimals", unit,
            )
            for group in PUBLISHED
            for quantity, unit in (("position", "m"), ("heading", "deg"), ("clock", "ns"))
        ],
        _reference_deviations,
    )  # fmt: skip


def check_measured_snapshot(seed: int, quick: bool) -> list[Measurement]:
    """Our snapshot mode: errors, flags, line-of-sight decisions and inliers."""
    key, gross = "measured.snapshot", "errors above 0.9 m must carry the two-mode flag"
    return with_values(
        [
            at_most(f"{key}.position.rmse_m", np.nan, 0.345, "the reference has 0.3973", "m"),
            at_most(f"{key}.unflagged_gross_stops", np.nan, 0, gross),
            at_least(f"{key}.los_decisions_right", np.nan, N_STOPS, "the reference decides all stops right"),
            at_least(f"{key}.inlier_f1", np.nan, 0.97, "against the labels of the file"),
        ],
        _snapshot_scores,
    )


def check_measured_trajectory(seed: int, quick: bool) -> list[Measurement]:
    """Our trajectory mode, stop spacing unknown, and the sessions it finds."""
    rmse, offsets = "the survey itself is good to 0.12-0.13 m", "-3.8 deg before the change, -1.25 deg after"
    return with_values(
        [
            at_most("measured.trajectory.position.rmse_m", np.nan, 0.16, rmse, "m"),
            at_most("measured.trajectory.position.max_m", np.nan, 0.4, "no stop in a wrong mode", "m"),
            at_most("measured.session.boundary_error_stops", np.nan, 0, "one change, after the 13th stop"),
            at_most("measured.session.offset_error_deg", np.nan, 0.5, offsets, "deg"),
        ],
        _trajectory_scores,
    )


def check_measured_maps(seed: int, quick: bool) -> list[Measurement]:
    """Clustered incidence points against the vector floor plan."""
    key = "ip_to_plan.median_m"
    return with_values(
        [
            at_most(f"measured.mapping.{key}", np.nan, 0.080, "with the surveyed receiver", "m"),
            at_most(f"measured.slam.{key}", np.nan, 0.088, "with the receiver of the snapshot mode", "m"),
        ],
        _plan_distances,
        PLAN,
    )


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


def _campaign() -> MeasuredCampaign:
    return measured_campaign(INITIAL_BIAS_M)


def _reference_deviations() -> Iterator[float]:
    campaign = _campaign()
    poses, _ = run_slam(campaign.channel, campaign.tx, SnapshotConfig(method="reference"), MAPPING)
    error = state_errors(campaign, poses)
    has_los = _has_los(campaign)
    groups = {"los": has_los, "nlos": ~has_los, "all": np.ones(len(has_los), bool)}
    for group, published in PUBLISHED.items():
        yield from np.abs(np.sqrt(np.mean(error[groups[group]] ** 2, axis=0)) - published)


def _snapshot_scores() -> list[float]:
    campaign = _campaign()
    solutions = [solve_snapshot(estimate, campaign.tx, OURS) for estimate in campaign.channel]
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


def _trajectory_scores() -> list[float]:
    campaign = _campaign()
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


def _plan_distances() -> list[float]:
    campaign = _campaign()
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
