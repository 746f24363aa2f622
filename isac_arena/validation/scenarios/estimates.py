"""Estimates made from known parameters: paths of a stop, receiver states, and known errors added to both."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.record import PoseEstimates, SolveStatus
from isac_arena.campaign.measured import MeasuredTruth
from scenes.record import BoolArray, FloatArray
from sim.truth import Truth

PARAMETERS = ("delay_s", "aod_azimuth_rad", "aoa_azimuth_rad", "aod_elevation_rad", "aoa_elevation_rad")


def made_estimate(
    stop: int, parameters: FloatArray, power_dbm: Any, covariance: Any, is_los: BoolArray, snr_db: float = 30.0
) -> ChannelEstimate:
    """Paths (path, m) in s and rad that share one covariance (m, m); m is 3, or 5 with both elevations."""
    n = len(parameters)
    values: dict[str, Any] = dict(zip(PARAMETERS, parameters.T, strict=False))
    values |= {"covariance": np.tile(covariance, (n, 1, 1)), "snr_db": np.full(n, snr_db)}
    return ChannelEstimate(stop=stop, power_dbm=power_dbm, beam_loss_db=np.zeros(n), is_los=is_los, **values)


def shift_estimate(estimate: ChannelEstimate, error: Any) -> ChannelEstimate:
    """The estimate with errors (path, 3) or (3,) added to delay in s, AoD and AoA azimuth in rad."""
    moved = estimate.plane_parameters + error
    return replace(estimate, **dict(zip(PARAMETERS[:3], moved.T, strict=True)))


def true_states(truths: Iterable[Truth | MeasuredTruth]) -> FloatArray:
    """True receiver states (stop, 4): x, y, heading and clock bias in m, m, rad, s."""
    return np.array([(*t.rx_pose.position_m[:2], t.rx_pose.heading_rad, t.clock_bias_s) for t in truths])


def made_poses(state: FloatArray, status: SolveStatus = SolveStatus.GIVEN, n_inliers: int = 0) -> PoseEstimates:
    """Pose estimates at states (stop, 4) in m, m, rad, s."""
    n = len(state)
    columns = (state[:, :2], state[:, 2], state[:, 3], np.full(n, status), np.full(n, n_inliers), np.zeros(n))
    return PoseEstimates(np.arange(n), *columns)


def moved_poses(poses: PoseEstimates, error: FloatArray) -> PoseEstimates:
    """The poses with errors (stop, 4) or (4,) added, in m, m, rad, s."""
    return replace(
        poses,
        position_m=poses.position_m + error[..., :2],
        heading_rad=poses.heading_rad + error[..., 2],
        clock_bias_s=poses.clock_bias_s + error[..., 3],
    )
