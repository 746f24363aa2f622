"""Mapping in space: the incidence point (IP) of every non-LOS path, with its height, for known RX states."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from estimation.channel.record import ChannelEstimate
from estimation.geometry_spatial import (
    bounce_jacobian_point,
    bounce_jacobian_rx,
    predict_bounce,
    residual,
    start_point,
)
from estimation.slam.config import MappingConfig
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.slam.spatial_problem import spatial_problem
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, FloatArray

_TO_METRES = np.array([1.0, 1.0, 1.0, 1.0, SPEED_OF_LIGHT_M_S])


def map_stops_spatial(
    estimates: Sequence[ChannelEstimate],
    poses: PoseEstimates,
    tx_pose: Pose,
    config: MappingConfig,
    *,
    is_los: Sequence[BoolArray] | None = None,
    is_inlier: Sequence[BoolArray] | None = None,
    state_covariance: Sequence[FloatArray] | None = None,
) -> IncidencePoints:
    """IPs with heights of all non-LOS paths at RX states of known height; FAILED stops are left out.

    As `estimation.slam.mapping.map_stops`, each path with its elevations: five measurements of three unknowns, so
    that J at the minimum has 2 degrees of freedom. `state_covariance` (5, 5) per stop is of [x, y, z, heading,
    bias] in (m, m, m, rad, s).

    Raises
    ------
    ValueError
        Where `poses` does not hold the stops of `estimates` in their order, or a solved stop has no height.
    """
    if [estimate.stop for estimate in estimates] != poses.stop.tolist():
        raise ValueError(f"poses.stop = {poses.stop.tolist()}: must equal the stops of the channel estimates")
    solved = poses.status != SolveStatus.FAILED
    if not np.isfinite(poses.height_m[solved]).all():
        raise ValueError("poses.height_m = nan: mapping in space needs the height of every solved stop")
    problems = [spatial_problem(estimate, tx_pose, config.noise) for estimate in estimates]
    row = np.repeat(np.arange(len(estimates)), [len(estimate) for estimate in estimates])
    los = _flags([e.is_los for e in estimates] if is_los is None else is_los)
    inlier = np.ones(len(row), bool) if is_inlier is None else _flags(is_inlier)
    use = ~los & solved[row]
    row = row[use]
    measured = np.concatenate([np.empty((0, 5)), *(p.measured for p in problems)])[use]
    path_covariance = np.concatenate([np.empty((0, 5, 5)), *(p.covariance for p in problems)])[use]
    bias_m = SPEED_OF_LIGHT_M_S * poses.clock_bias_s
    state = np.column_stack([poses.position_m, poses.height_m, poses.heading_rad, bias_m])[row]
    point, cost = locate_spatial(tx_pose, state, measured, path_covariance, config)
    conditional, sensitivity = spatial_point_covariance(tx_pose, state, point, path_covariance)
    covariance = conditional
    if state_covariance is not None:
        joint = np.reshape(state_covariance, (-1, 5, 5)) * np.outer(_TO_METRES, _TO_METRES)
        covariance = conditional + sensitivity @ joint[row] @ np.swapaxes(sensitivity, 1, 2)
    passed = _passes_gate(tx_pose, state, point, conditional, cost, config)
    return IncidencePoints(
        stop=poses.stop[row],
        path=np.concatenate([np.empty(0, int), *(np.arange(len(e)) for e in estimates)])[use],
        position_m=point[:, :2],
        covariance_m2=covariance[:, :2, :2],
        cost=cost,
        is_inlier=inlier[use] & passed,
        height_m=point[:, 2],
        height_covariance_m2=covariance[:, 2],
    )


def locate_spatial(
    tx_pose: Pose, state: FloatArray, measured: FloatArray, covariance: FloatArray, config: MappingConfig
) -> tuple[FloatArray, FloatArray]:
    """IPs (path, 3) of smallest chi-square for paths (path, 5) at RX states (path, 5), and the minima (path,).

    Damped Gauss-Newton steps from the midpoint of both rays, all paths at once.
    """
    weight = np.asarray(np.linalg.inv(covariance), float)
    point, damping = start_point(tx_pose, state, measured), np.full(len(state), 1e-9)
    difference = residual(measured, predict_bounce(tx_pose, state, point))
    cost = np.einsum("na,nab,nb->n", difference, weight, difference)
    for _ in range(config.max_iterations):
        jacobian = bounce_jacobian_point(tx_pose, state, point)
        gradient = np.einsum("nai,nab,nb->ni", jacobian, weight, difference)
        information = np.swapaxes(jacobian, 1, 2) @ weight @ jacobian
        trace = np.einsum("nii->n", information)
        damped = information + (damping * trace)[:, None, None] * np.eye(3)
        trial = point + np.linalg.solve(damped, gradient[..., None])[..., 0]
        ahead = residual(measured, predict_bounce(tx_pose, state, trial))
        trial_cost = np.einsum("na,nab,nb->n", ahead, weight, ahead)
        better = trial_cost < cost
        gain = np.where(better, cost - trial_cost, 0.0)
        settled = np.where(better, gain <= config.relative_tolerance * cost, damping > 1.0)
        point, difference = (
            np.where(better[:, None], trial, point),
            np.where(better[:, None], ahead, difference),
        )
        cost = np.where(better, trial_cost, cost)
        damping = np.where(better, np.maximum(damping / 10, 1e-9), damping * 10)
        if settled.all():
            break
    return point, cost


def spatial_point_covariance(
    tx_pose: Pose, state: FloatArray, point_m: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Covariance (path, 3, 3) of IPs with the RX state exact, and their sensitivity (path, 3, 5) to it."""
    weight = np.linalg.inv(covariance)
    jacobian = bounce_jacobian_point(tx_pose, state, point_m)
    weighted = np.swapaxes(jacobian, 1, 2) @ weight
    information = weighted @ jacobian
    floor = 1e-12 * np.einsum("nii->n", information)
    conditional = np.linalg.inv(information + floor[:, None, None] * np.eye(3))
    return conditional, -conditional @ weighted @ bounce_jacobian_rx(tx_pose, state, point_m)


def _passes_gate(
    tx_pose: Pose,
    state: FloatArray,
    point: FloatArray,
    covariance: FloatArray,
    cost: FloatArray,
    config: MappingConfig,
) -> BoolArray:
    """Chi-square gate and physical feasibility; the plan position has to be certain, the height need not."""
    legs = [np.linalg.norm(point - end, axis=1) for end in (tx_pose.position_m, state[:, :3])]
    largest = np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1]
    return np.asarray(
        (cost <= chi2.ppf(config.gate_probability, 2))
        & (np.minimum(*legs) >= config.min_leg_m)
        & (largest <= config.max_position_std_m**2)
    )


def _flags(parts: Sequence[BoolArray]) -> BoolArray:
    return np.concatenate([np.empty(0, bool), *parts])
