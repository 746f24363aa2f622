"""`arena validate slam`: the measured Campus Arena stops, where their file exists (`measured_data.py`)."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from estimation.shape.config import ShapeConfig
from estimation.shape.gp.estimate import estimate_shapes
from estimation.slam.config import MappingConfig, SnapshotConfig, TrajectoryConfig
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.record import PoseEstimates, SolveStatus
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
from isac_arena.validation import measured_data
from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.validation.scenarios.estimates import made_poses, true_states
from scenes.pose import wrap_angle
from scenes.record import BoolArray, FloatArray

MAPPING = MappingConfig(noise=PUBLISHED_NOISE)
OURS = SnapshotConfig(method="statistical", noise=PUBLISHED_NOISE, max_position_std_m=PUBLISHED_MAX_POSITION_STD_M)
# position in m, heading in deg, clock in ns
LOS, NLOS, ALL = (0.3115, 2.1511, 1.1390), (0.5475, 2.6034, 2.5046), (0.3973, 2.2962, 1.6703)
PUBLISHED = {"los": LOS, "nlos": NLOS, "all": ALL}
SESSION_OFFSETS_DEG = (-3.8, -1.25)
N_FOLDS = 3
HELD_OUT = 1.3  # most RMSE of a third of the stops over that of the other two


def check_measured_reference(seed: int, quick: bool) -> list[Measurement]:
    """The reference mode against the figures of the published algorithm on the same stops."""
    key, quantities = "measured.reference", (("position", "m"), ("heading", "deg"), ("clock", "ns"))
    rows = [
        at_most(f"{key}.{group}.{name}_deviation_{unit}", np.nan, 1e-3, "published to 4 decimals", unit)
        for group in PUBLISHED
        for name, unit in quantities
    ]
    return measured_data.with_values(rows, _reference_deviations)


def check_measured_snapshot(seed: int, quick: bool) -> list[Measurement]:
    """Our snapshot mode: errors, flags, line-of-sight decisions and inliers."""
    key, gross = "measured.snapshot", "errors above 0.9 m must carry the two-mode flag"
    return measured_data.with_values(
        [
            at_most(f"{key}.position.rmse_m", np.nan, 0.345, "the reference has 0.3973", "m"),
            at_most(f"{key}.unflagged_gross_stops", np.nan, 0, gross),
            at_most(f"{key}.unflagged_far_stops", np.nan, 0, "beyond 3 stated deviations, without a flag"),
            at_least(f"{key}.los_decisions_right", np.nan, measured_data.N_STOPS, "so does the reference"),
            at_least(f"{key}.inlier_f1", np.nan, 0.97, "against the labels of the file"),
            _held_out_row(key),
        ],
        _snapshot_scores,
    )


def check_measured_trajectory(seed: int, quick: bool) -> list[Measurement]:
    """Our trajectory mode, stop spacing unknown, and the sessions it finds."""
    rmse, offsets = "the survey itself is good to 0.12-0.13 m", "-3.8 deg before the change, -1.25 deg after"
    return measured_data.with_values(
        [
            at_most("measured.trajectory.position.rmse_m", np.nan, 0.16, rmse, "m"),
            at_most("measured.trajectory.position.max_m", np.nan, 0.4, "no stop in a wrong mode", "m"),
            at_most("measured.session.boundary_error_stops", np.nan, 0, "one change, after the 13th stop"),
            at_most("measured.session.offset_error_deg", np.nan, 0.5, offsets, "deg"),
            _held_out_row("measured.trajectory"),
        ],
        _trajectory_scores,
    )


def check_measured_maps(seed: int, quick: bool) -> list[Measurement]:
    """Clustered incidence points against the vector floor plan."""
    key = "ip_to_plan.median_m"
    return measured_data.with_values(
        [
            at_most(f"measured.mapping.{key}", np.nan, 0.080, "with the surveyed receiver", "m"),
            at_most(f"measured.slam.{key}", np.nan, 0.088, "with the receiver of the snapshot mode", "m"),
        ],
        _plan_distances,
        measured_data.PLAN,
    )


def _held_out_row(key: str) -> Measurement:
    reason = "largest of three folds, every third stop; nothing hangs on some of the stops"
    return at_most(f"{key}.held_out_rmse_ratio", np.nan, HELD_OUT, reason)


def held_out_ratio(error_m: FloatArray) -> float:
    """Largest RMS error of every third stop over that of the other stops, of errors (stop,) in their order.

    All constants come from simulations, so the stops held out need no other fit than the rest.
    """
    fold = np.arange(len(error_m)) % N_FOLDS
    square = np.square(error_m)
    return max(float(np.sqrt(square[fold == k].mean() / square[fold != k].mean())) for k in range(N_FOLDS))


def state_errors(campaign: MeasuredCampaign, poses: PoseEstimates) -> FloatArray:
    """Errors (stop, 3) of position in m, heading in deg and clock in ns; infinite for unsolved stops."""
    rx = true_states(campaign.truths)
    heading_deg = np.rad2deg(wrap_angle(poses.heading_rad - rx[:, 2]))
    distance_m, clock_ns = np.hypot(*(poses.position_m - rx[:, :2]).T), 1e9 * (poses.clock_bias_s - rx[:, 3])
    return np.asarray(np.nan_to_num(np.column_stack([distance_m, heading_deg, clock_ns]), nan=np.inf))


def plan_distance_m(segments_m: FloatArray, points_m: FloatArray) -> FloatArray:
    """Distance (point,) of points (point, xy) to the nearest of segments (segment, 4) x0, y0, x1, y1."""
    start, along = segments_m[:, :2], segments_m[:, 2:] - segments_m[:, :2]
    length2 = np.maximum(np.sum(along**2, axis=1), 1e-18)
    offset = points_m[:, None] - start
    share = np.clip(np.einsum("nsi,si->ns", offset, along) / length2, 0.0, 1.0)
    return np.asarray(np.linalg.norm(offset - share[..., None] * along, axis=-1).min(axis=1))


def _reference_deviations() -> Iterator[float]:
    campaign = measured_data.measured_campaign(INITIAL_BIAS_M)
    poses, _ = run_slam(campaign.channel, campaign.tx, SnapshotConfig(method="reference"), MAPPING)
    error = state_errors(campaign, poses)
    has_los = _has_los(campaign)
    groups = {"los": has_los, "nlos": ~has_los, "all": np.ones(len(has_los), bool)}
    for group, published in PUBLISHED.items():
        yield from np.abs(np.sqrt(np.mean(error[groups[group]] ** 2, axis=0)) - published)


def _snapshot_scores() -> list[Any]:
    campaign = measured_data.measured_campaign(INITIAL_BIAS_M)
    solutions = [solve_snapshot(estimate, campaign.tx, OURS) for estimate in campaign.channel]
    poses = collect_poses(solutions)
    error = state_errors(campaign, poses)[:, 0]
    flagged = np.array([solution.is_ambiguous for solution in solutions])
    decided = np.array([solution.status == SolveStatus.LOS for solution in solutions])
    label = np.concatenate([truth.is_los | truth.is_single_bounce for truth in campaign.truths])
    inlier = np.concatenate([solution.is_inlier for solution in solutions])
    f1 = 2 * np.sum(label & inlier) / (label.sum() + inlier.sum())
    right = np.sum(decided == _has_los(campaign))
    gross, far = error > 0.9, error > 3 * poses.position_std_m
    unflagged = np.sum(gross & ~flagged), np.sum(far & ~flagged)
    return [np.sqrt(np.mean(error**2)), *unflagged, right, f1, held_out_ratio(error)]


def _trajectory_scores() -> list[Any]:
    campaign = measured_data.measured_campaign(INITIAL_BIAS_M)
    poses, _, details = run_trajectory(campaign.channel, campaign.tx, OURS, TrajectoryConfig(), MAPPING)
    error = state_errors(campaign, poses)[:, 0]
    changes = np.flatnonzero(np.diff(details.session)) + 1
    boundary, offset = np.inf, np.inf
    if len(changes):
        boundary = np.abs(changes - measured_data.SESSION_STOP).sum()
        found = PUBLISHED_TX_OFFSET_DEG + np.rad2deg(details.tx_offset_rad[details.session[[0, -1]]])
        offset = np.abs(found - SESSION_OFFSETS_DEG).max()
    return [np.sqrt(np.mean(error**2)), error.max(), boundary, offset, held_out_ratio(error)]


def _plan_distances() -> list[float]:
    campaign = measured_data.measured_campaign(INITIAL_BIAS_M)
    segments_m = np.loadtxt(measured_data.data_folder() / measured_data.PLAN, delimiter=",", skiprows=1)
    known = made_poses(true_states(campaign.truths))
    _, slam = run_slam(campaign.channel, campaign.tx, OURS, MAPPING)
    medians = []
    for points in (map_stops(campaign.channel, known, campaign.tx, MAPPING), slam):
        label = estimate_shapes(points, ShapeConfig()).label
        medians.append(float(np.median(plan_distance_m(segments_m, points.position_m[label >= 0]))))
    return medians


def _has_los(campaign: MeasuredCampaign) -> BoolArray:
    return np.array([truth.is_los.any() for truth in campaign.truths])
