"""Scores of the receiver poses and clock that SLAM found."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from estimation.laws.plane import range_covariance
from estimation.slam.bounds import (
    StateBound,
    StopPaths,
    shared_pose_information,
    state_bound,
    state_covariance,
    stop_information,
)
from estimation.slam.record import PoseEstimates, SolveStatus
from isac_arena.campaign.results import MapResult
from isac_arena.scoring.metrics.consistency import consistency_metrics
from isac_arena.scoring.metrics.metric import Metric
from isac_arena.scoring.metrics.statistics import maximum, mean, quantile, ratio, rms, squared_mahalanobis
from isac_arena.scoring.metrics.trajectories import absolute_errors, relative_errors
from isac_arena.scoring.record import PathKind, PoseScores
from isac_arena.scoring.true_stop import TrueStop
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray, concatenate, empty_record
from scenes.scene import Scene
from sim.truth import Truth


def score_both_poses(
    slam: MapResult, tx: Mapping[int, int] | None = None, **truth: Any
) -> tuple[PoseScores, PoseScores]:
    """Tables of the poses of SLAM and of those by the published algorithm; arguments as `score_poses`.

    `tx` is the index of the TX at every stop that clocks are against, by default the first.
    """
    published = empty_record(PoseScores)
    if slam.published is not None:
        published = score_poses(estimate=_against(slam.published, tx or {}), **truth)
    return score_poses(estimate=_against(slam.poses, tx or {}), **truth), published


def _against(poses: PoseEstimates, tx: Mapping[int, int]) -> PoseEstimates:
    """The states with the clock bias against one TX of every stop, by default the first."""
    if poses.n_tx == 1:
        return poses
    against = np.array([tx.get(int(stop), 0) for stop in poses.stop], int)
    parts = [poses.of_tx(each).take("stop", against == each) for each in np.unique(against).tolist()]
    return concatenate(parts, "stop")


def score_poses(
    stop: IntArray,
    true_pose: list[Pose],
    true_clock_bias_s: FloatArray,
    has_los: BoolArray,
    estimate: PoseEstimates,
    bound: StateBound,
) -> PoseScores:
    """Table of pose errors and bounds of the given stops, in their order.

    Raises `ValueError` where the estimate has no pose for one of them.
    """
    row = {int(index): position for position, index in enumerate(estimate.stop)}
    missing = [int(index) for index in stop if int(index) not in row]
    if missing:
        raise ValueError(f"PoseEstimates.stop: stop {missing[0]} is missing, every scored stop needs a pose")
    estimate = estimate.take("stop", np.array([row[int(index)] for index in stop], int))
    position_m = np.array([pose.position_m[:2] for pose in true_pose]).reshape(-1, 2)
    heading_rad = np.array([pose.heading_rad for pose in true_pose])
    solved = estimate.status != SolveStatus.FAILED
    clock_error_s = estimate.clock_bias_s - true_clock_bias_s
    height_error_m = estimate.height_m - np.array([pose.position_m[2] for pose in true_pose])
    error = np.column_stack(
        [estimate.position_m - position_m, wrap_angle(estimate.heading_rad - heading_rad), clock_error_s]
    )
    return PoseScores(
        stop=stop,
        has_los=has_los,
        status=estimate.status,
        true_position_m=position_m,
        true_heading_rad=heading_rad,
        true_clock_bias_s=true_clock_bias_s,
        position_m=np.where(solved[:, None], estimate.position_m, np.nan),
        position_error_m=_where(solved, np.linalg.norm(estimate.position_m - position_m, axis=1)),
        heading_error_rad=_where(solved, error[:, 2]),
        clock_error_s=_where(solved, clock_error_s),
        nees=_where(solved, squared_mahalanobis(error, estimate.covariance)),
        position_nees=_where(solved, squared_mahalanobis(error[:, :2], estimate.covariance[:, :2, :2])),
        height_error_m=_where(solved, height_error_m),
        height_nees=_where(solved, (height_error_m / estimate.height_std_m) ** 2),
        position_std_m=_where(solved, _stated_std_m(estimate)),
        is_ambiguous=estimate.is_ambiguous,
        position_bound_m=bound.position_m,
        heading_bound_rad=bound.heading_rad,
        clock_bound_s=bound.clock_m / SPEED_OF_LIGHT_M_S,
        most_influential_path=np.where(solved, estimate.most_influential_path, -1),
        path_influence_m=_where(solved, estimate.path_influence_m),
    )


def _stated_std_m(estimate: PoseEstimates) -> FloatArray:
    """Deviation (stop,) of the position over all modes; of the chosen mode where only that is known."""
    variance = estimate.covariance[:, 0, 0] + estimate.covariance[:, 1, 1]
    return np.where(
        np.isfinite(estimate.position_std_m), estimate.position_std_m, np.sqrt(np.maximum(variance, 0))
    )


def pose_bounds(scene: Scene, stops: Sequence[Sequence[TrueStop]]) -> StateBound:
    """Bounds (stop,) of the receiver states from the significant paths of each stop alone, those of all its TX.

    The paths are the line of sight and single bounces off upright objects, with the Cramer-Rao bounds of their
    delays and azimuths as covariances; incidence points are unknowns. The clock bias against every TX is free.
    Errors of the set-up that the campaign states (`slam.consider`) are part of it: a turned TX turns the whole
    solution, and no path shows it. A bound is infinite where the paths do not determine the state, and NaN
    without a view of the link.
    """
    found = [_pose_bound(scene, stop) for stop in stops]
    columns = ([getattr(one, field.name) for one in found] for field in fields(StateBound))
    return StateBound(*(np.array(column, float) for column in columns))


def unknown_bound(n_stops: int) -> StateBound:
    """Bounds (stop,) that are all NaN."""
    return StateBound(*np.full((3, n_stops), np.nan))


def _pose_bound(scene: Scene, links: Sequence[TrueStop]) -> StateBound:
    if any(link.view is None for link in links):
        return StateBound(*np.full(3, np.nan))
    links = [from_node(link) for link in links]
    covariance = state_covariance(shared_pose_information([pose_information(scene, link) for link in links]))
    first = links[0]
    if first.view is not None:
        from_tx = first.truth.rx_pose.position_m - first.tx_pose.position_m
        covariance[:4, :4] += first.view.set_up.covariance(from_tx[:2])
    return state_bound(covariance)


def from_node(stop: TrueStop) -> TrueStop:
    """What a bound of the state at a stop takes, with departures at the fixed node, whichever end sends."""
    truth = stop.truth.from_node
    if truth is stop.truth:
        return stop
    turned = stop.covariance[:, [0, 2, 1]][:, :, [0, 2, 1]]
    return replace(stop, truth=truth, tx_pose=stop.truth.rx_pose, covariance=turned)


def pose_information(scene: Scene, stop: TrueStop) -> FloatArray:
    """Information (4, 4) on the receiver state from the significant paths of one TX."""
    covariance, is_los, bounce = plane_paths(scene, stop)
    paths = StopPaths(
        point_m=stop.origin.vertex_m[stop.significant[bounce]],
        covariance=covariance[bounce],
        wall=np.full(bounce.sum(), -1),
        los_covariance=covariance[is_los][0] if is_los.any() else None,
    )
    return stop_information(stop.tx_pose, true_state(stop.truth), paths)


def plane_paths(scene: Scene, stop: TrueStop) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Covariances (significant, 3, 3) in (m, rad, rad)^2, and which are lines of sight and bounces off objects."""
    covariance = range_covariance(stop.covariance)
    known = np.isfinite(covariance).all(axis=(1, 2))
    is_los = known & (stop.origin.kind[stop.significant] == PathKind.LOS)
    return covariance, is_los, known & np.isin(stop.origin.object[stop.significant], scene.object_names)


def true_state(truth: Truth) -> FloatArray:
    """True [x, y, heading, clock bias] (4,) in m, m, rad, m."""
    pose = truth.rx_pose
    return np.array([*pose.position_m[:2], pose.heading_rad, truth.clock_bias_s * SPEED_OF_LIGHT_M_S])


def pose_metrics(poses: PoseScores) -> list[Metric]:
    """Scores of the trajectory, then of all stops and of those with and without a significant true LOS.

    Stops whose states are given, as those of fixed nodes, are not among them.
    """
    poses = poses.take("stop", poses.status != SolveStatus.GIVEN)
    metrics = [
        *_trajectory_metrics(poses),
        *consistency_metrics("slam", poses.nees, 4),
        *consistency_metrics("slam.position", poses.position_nees, 2),
        *consistency_metrics("slam.height", poses.height_nees, 1),
        *_bound_metrics(poses),
    ]
    groups = {"slam": np.ones(len(poses.stop), bool), "slam.los": poses.has_los, "slam.nlos": ~poses.has_los}
    for prefix, members in groups.items():
        group = poses.take("stop", members)
        position_m = group.position_error_m
        solved = group.status != SolveStatus.FAILED
        metrics += [
            Metric(f"{prefix}.stops", len(group.stop), "1", "info"),
            Metric(f"{prefix}.solved_share", mean(solved), "1", "higher"),
            Metric(f"{prefix}.position.rmse_m", rms(position_m), "m", "lower"),
            Metric(f"{prefix}.position.median_m", quantile(position_m, 0.5), "m", "lower"),
            Metric(f"{prefix}.position.max_m", maximum(position_m), "m", "lower"),
            Metric(f"{prefix}.position.stated_m", rms(group.position_std_m), "m", "info"),
            Metric(f"{prefix}.height.rmse_m", rms(group.height_error_m), "m", "lower"),
            Metric(f"{prefix}.heading.rmse_deg", rms(np.rad2deg(group.heading_error_rad)), "deg", "lower"),
            Metric(f"{prefix}.clock.rmse_ns", rms(1e9 * group.clock_error_s), "ns", "lower"),
        ]
    return metrics


def published_metrics(poses: PoseScores) -> list[Metric]:
    """Scores of the published algorithm on the same channel estimates; NaN where it was not run."""
    poses = poses.take("stop", poses.status != SolveStatus.GIVEN)
    solved = poses.status != SolveStatus.FAILED
    return [
        Metric("published.solved_share", mean(solved), "1", "higher"),
        Metric("published.position.rmse_m", rms(poses.position_error_m), "m", "lower"),
        Metric("published.position.median_m", quantile(poses.position_error_m, 0.5), "m", "lower"),
        Metric("published.heading.rmse_deg", rms(np.rad2deg(poses.heading_error_rad)), "deg", "lower"),
        Metric("published.clock.rmse_ns", rms(1e9 * poses.clock_error_s), "ns", "lower"),
    ]


def _trajectory_metrics(poses: PoseScores) -> list[Metric]:
    """APE after the best rigid motion and RPE from stop to stop, in the order of the stops."""
    truth_m, truth_rad = poses.true_position_m, poses.true_heading_rad
    heading_rad = truth_rad + poses.heading_error_rad
    ape_m, ape_rad = absolute_errors(poses.position_m, heading_rad, truth_m, truth_rad, align=True)
    rpe_m, rpe_rad = relative_errors(poses.position_m, heading_rad, truth_m, truth_rad)
    return [
        Metric("slam.ape_aligned.rmse_m", rms(ape_m), "m", "lower"),
        Metric("slam.ape_aligned.heading_rmse_deg", rms(np.rad2deg(ape_rad)), "deg", "lower"),
        Metric("slam.rpe.rmse_m", rms(rpe_m), "m", "lower"),
        Metric("slam.rpe.heading_rmse_deg", rms(np.rad2deg(rpe_rad)), "deg", "lower"),
    ]


def _bound_metrics(poses: PoseScores) -> list[Metric]:
    """RMS and median bounds; RMS errors over RMS bounds at the solved stops; the median ratio."""
    metrics = []
    for name, error, bound, unit, scale in (
        ("position", poses.position_error_m, poses.position_bound_m, "m", 1.0),
        ("heading", poses.heading_error_rad, poses.heading_bound_rad, "deg", np.rad2deg(1.0)),
        ("clock", poses.clock_error_s, poses.clock_bound_s, "ns", 1e9),
    ):
        metrics.append(Metric(f"slam.{name}.bound_{unit}", scale * rms(bound), unit, "info"))
        median = scale * quantile(bound[np.isfinite(bound)], 0.5)
        metrics.append(Metric(f"slam.{name}.bound_median_{unit}", median, unit, "info"))
        known = np.isfinite(error) & np.isfinite(bound) & (bound > 0)
        share = np.abs(error[known]) / bound[known]
        overall = ratio(rms(error[known]), rms(bound[known])) if known.any() else np.nan
        metrics.append(Metric(f"slam.{name}.over_bound", overall, "1", "lower"))
        metrics.append(Metric(f"slam.{name}.over_bound.median", quantile(share, 0.5), "1", "lower"))
    return metrics


def _where(solved: BoolArray, error: FloatArray) -> FloatArray:
    return np.where(solved, error, np.nan)
