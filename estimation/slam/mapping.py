"""Mapping: the incidence point (IP) of every non-LOS path for known RX states, equations (2) to (4)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from estimation.channel.record import ChannelEstimate
from estimation.geometry import (
    bounce_jacobian_point,
    bounce_jacobian_rx,
    measurements,
    predict_bounce,
    residual,
    start_point,
)
from estimation.slam.config import MappingConfig
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, FloatArray


def map_stops(
    estimates: Sequence[ChannelEstimate],
    poses: PoseEstimates,
    tx_pose: Pose,
    config: MappingConfig,
    *,
    is_los: Sequence[BoolArray] | None = None,
    is_inlier: Sequence[BoolArray] | None = None,
    state_covariance: Sequence[FloatArray] | None = None,
) -> IncidencePoints:
    """IPs of all non-LOS paths at the RX states given; stops with status FAILED are left out.

    Parameters
    ----------
    estimates
        Channel estimates, one per row of `poses`.
    is_los
        Per stop (path,): the line of sight; the channel estimate's own decision by default.
    is_inlier
        Per stop (path,): paths taken as single bounces by SLAM; `is_inlier` of the result needs both this and
        the gate of `config`.
    state_covariance
        Per stop (4, 4) of [x, y, heading, bias] in (m, m, rad, s): adds the uncertainty of the RX state to the
        IP's covariance, as in the joint estimate. The states are taken as exact by default.

    Raises
    ------
    ValueError
        Where `poses` does not hold the stops of `estimates` in their order.
    """
    if [estimate.stop for estimate in estimates] != poses.stop.tolist():
        raise ValueError(f"poses.stop = {poses.stop.tolist()}: must equal the stops of the channel estimates")
    row = np.repeat(np.arange(len(estimates)), [len(estimate) for estimate in estimates])
    los = _joined([e.is_los for e in estimates] if is_los is None else is_los, bool, ())
    inlier = _joined(is_inlier, bool, ()) if is_inlier is not None else np.ones(len(row), bool)
    use = ~los & (poses.status[row] != SolveStatus.FAILED)
    row = row[use]
    measured = _joined(
        [measurements(e.delay_s, e.aod_azimuth_rad, e.aoa_azimuth_rad) for e in estimates], float, (3,)
    )[use]
    path_covariance = _joined([config.noise.covariance(e) for e in estimates], float, (3, 3))[use]
    bias_m = SPEED_OF_LIGHT_M_S * poses.clock_bias_s
    state = np.column_stack([poses.position_m, poses.heading_rad, bias_m])[row]

    point, cost = locate(tx_pose, state, measured, path_covariance, config)
    conditional, sensitivity = point_covariance(tx_pose, state, point, path_covariance)
    covariance = conditional
    if state_covariance is not None:
        to_metres = np.array([1.0, 1.0, 1.0, SPEED_OF_LIGHT_M_S])
        joint = np.reshape(state_covariance, (-1, 4, 4)) * np.outer(to_metres, to_metres)
        covariance = conditional + sensitivity @ joint[row] @ np.swapaxes(sensitivity, 1, 2)
    passed = _passes_gate(tx_pose, state, point, conditional, cost, config)
    return IncidencePoints(
        stop=poses.stop[row],
        path=_joined([np.arange(len(e)) for e in estimates], int, ())[use],
        position_m=point,
        covariance_m2=covariance,
        cost=cost,
        is_inlier=inlier[use] & passed,
    )


def locate(
    tx_pose: Pose,
    state: FloatArray,
    measured: FloatArray,
    covariance: FloatArray,
    config: MappingConfig,
) -> tuple[FloatArray, FloatArray]:
    """Minimise J of equation (4) for all paths at once, by damped Gauss-Newton from the midpoint start.

    Parameters
    ----------
    state
        (path, 4) RX state of each path, in m, m, rad, m.
    measured, covariance
        (path, 3) and (path, 3, 3) in m and rad.

    Returns
    -------
    point_m, cost
        (path, 2) and (path,): the IPs and J at the minimum.
    """
    weight = np.asarray(np.linalg.inv(covariance), float)
    point = start_point(tx_pose, state, measured)
    damping = np.full(len(point), 1e-9)
    difference = residual(measured, predict_bounce(tx_pose, state, point))
    cost = _quadratic(difference, weight)
    for _ in range(config.max_iterations):
        jacobian = bounce_jacobian_point(tx_pose, state, point)
        gradient = np.einsum("nai,nab,nb->ni", jacobian, weight, difference)
        information = np.swapaxes(jacobian, 1, 2) @ weight @ jacobian
        trace = np.einsum("nii->n", information)
        information = information + (damping * trace)[:, None, None] * np.eye(2)
        trial = point + np.linalg.solve(information, gradient[..., None])[..., 0]
        trial_difference = residual(measured, predict_bounce(tx_pose, state, trial))
        trial_cost = _quadratic(trial_difference, weight)
        better = trial_cost < cost
        gain = np.where(better, cost - trial_cost, 0.0)
        settled = np.where(better, gain <= config.relative_tolerance * cost, damping > 1.0)
        point = np.where(better[:, None], trial, point)
        difference = np.where(better[:, None], trial_difference, difference)
        cost = np.where(better, trial_cost, cost)
        damping = np.where(better, np.maximum(damping / 10, 1e-9), damping * 10)
        if settled.all():
            break
    return point, cost


def point_covariance(
    tx_pose: Pose, state: FloatArray, point_m: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Covariance (path, 2, 2) of the IPs with the RX state exact, and their sensitivity (path, 2, 4) to it.

    The covariance is inv(J' inv(R) J); directions the path says nothing about get a huge, finite variance.
    """
    weight = np.linalg.inv(covariance)
    jacobian = bounce_jacobian_point(tx_pose, state, point_m)
    weighted = np.swapaxes(jacobian, 1, 2) @ weight
    information = weighted @ jacobian
    floor = 1e-12 * np.einsum("nii->n", information)
    conditional = np.linalg.inv(information + floor[:, None, None] * np.eye(2))
    return conditional, -conditional @ weighted @ bounce_jacobian_rx(tx_pose, state, point_m)


def _passes_gate(
    tx_pose: Pose,
    state: FloatArray,
    point: FloatArray,
    covariance: FloatArray,
    cost: FloatArray,
    config: MappingConfig,
) -> BoolArray:
    """Chi-square gate and physical feasibility, as `MappingConfig` states them."""
    leg_tx = np.hypot(*(point - tx_pose.position_m[:2]).T)
    leg_rx = np.hypot(*(point - state[:, :2]).T)
    largest = np.linalg.eigvalsh(covariance)[:, -1]
    return np.asarray(
        (cost <= chi2.ppf(config.gate_probability, 1))
        & (np.minimum(leg_tx, leg_rx) >= config.min_leg_m)
        & (largest <= config.max_position_std_m**2)
    )


def _quadratic(difference: FloatArray, weight: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("na,nab,nb->n", difference, weight, difference))


def _joined(parts: Sequence[NDArray[Any]], dtype: type, shape: tuple[int, ...]) -> NDArray[Any]:
    """Concatenate per-stop arrays along the path axis; an empty sequence gives no paths."""
    return np.concatenate([np.empty((0, *shape), dtype), *parts]).astype(dtype)
