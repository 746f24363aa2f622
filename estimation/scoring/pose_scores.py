"""Scores of the receiver poses and clock that SLAM found."""

from __future__ import annotations

import numpy as np

from estimation.scoring.metric import Metric
from estimation.scoring.record import PoseScores
from estimation.scoring.statistics import maximum, mean, quantile, rms
from estimation.scoring.trajectory_metrics import absolute_errors, relative_errors
from estimation.slam.record import PoseEstimates, SolveStatus
from scenes.pose import Pose, wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray


def score_poses(
    stop: IntArray,
    true_pose: list[Pose],
    true_clock_bias_s: FloatArray,
    has_los: BoolArray,
    estimate: PoseEstimates,
) -> PoseScores:
    """Table of pose errors over the stops given, in their order.

    Raises `ValueError` where the estimate has not one pose for each of them.
    """
    row = {int(index): position for position, index in enumerate(estimate.stop)}
    missing = [int(index) for index in stop if int(index) not in row]
    if missing:
        raise ValueError(f"PoseEstimates.stop: stop {missing[0]} is missing, every scored stop needs a pose")
    estimate = estimate.take("stop", np.array([row[int(index)] for index in stop], int))
    position_m = np.array([pose.position_m[:2] for pose in true_pose]).reshape(-1, 2)
    heading_rad = np.array([pose.heading_rad for pose in true_pose])
    solved = estimate.status != SolveStatus.FAILED
    return PoseScores(
        stop=stop,
        has_los=has_los,
        status=estimate.status,
        true_position_m=position_m,
        true_heading_rad=heading_rad,
        true_clock_bias_s=true_clock_bias_s,
        position_m=np.where(solved[:, None], estimate.position_m, np.nan),
        position_error_m=_where(solved, np.linalg.norm(estimate.position_m - position_m, axis=1)),
        heading_error_rad=_where(solved, wrap_angle(estimate.heading_rad - heading_rad)),
        clock_error_s=_where(solved, estimate.clock_bias_s - true_clock_bias_s),
    )


def pose_metrics(poses: PoseScores) -> list[Metric]:
    """Scores of the trajectory, then of all stops and of those with and without a significant true LOS."""
    metrics = _trajectory_metrics(poses)
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
            Metric(f"{prefix}.heading.rmse_deg", rms(np.rad2deg(group.heading_error_rad)), "deg", "lower"),
            Metric(f"{prefix}.clock.rmse_ns", rms(1e9 * group.clock_error_s), "ns", "lower"),
        ]
    return metrics


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


def _where(solved: BoolArray, error: FloatArray) -> FloatArray:
    return np.where(solved, error, np.nan)
