"""The snapshot problem in space: paths with elevations, and their residuals at a receiver state.

Every single bounce gives two equations (`estimation.laws.space.BounceEquations`), whitened by their covariance;
the line of sight gives five. States are [x, y, z, heading, bias] in m, m, m, rad, m.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.inference.least_squares import student_t_log_peak
from estimation.laws.plane import FEASIBLE_STDS
from estimation.laws.space import bounce_equations, los_jacobian_rx, predict_los, residual
from estimation.slam.config import Mixture, PathNoise
from estimation.slam.snapshot.problem import direct_path
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import BoolArray, FloatArray

_UNKNOWN_STD_RAD = np.deg2rad(40.0)  # of an elevation that was not estimated


@dataclass(frozen=True)
class SpatialProblem:
    """Paths of one stop in the units of `estimation.laws.space`."""

    tx: Pose
    measured: FloatArray  # (path, 5)
    covariance: FloatArray  # (path, 5, 5)
    power_dbm: FloatArray  # (path,)

    def __len__(self) -> int:
        return len(self.measured)

    @property
    def direct(self) -> int:
        """Index of the candidate for the line of sight: the strongest path that may be the earliest."""
        return direct_path(self.measured[:, 0], self.covariance[:, 0, 0], self.power_dbm)


class BounceFit(NamedTuple):
    """All paths as single bounces at a batch of states."""

    value_m: FloatArray  # (state, path, 2)
    whitening: FloatArray  # (state, path, 2, 2)
    white: FloatArray  # (state, path, 2) whitened values
    jacobian: FloatArray  # (state, path, 2, 5) of the whitened values at fixed whitening
    log_scale: FloatArray  # (state, path) log of the product of both standard deviations in m
    is_feasible: BoolArray  # (state, path): the IP is between the devices' rays

    @property
    def square(self) -> FloatArray:
        """Chi-square (state, path), 2 degrees of freedom."""
        return np.asarray(np.sum(self.white**2, axis=-1))


def has_elevations(estimate: ChannelEstimate) -> bool:
    """Whether any path of a stop has an elevation."""
    known = np.isfinite(estimate.aod_elevation_rad) | np.isfinite(estimate.aoa_elevation_rad)
    return bool(known.any())


def is_spatial(estimates: Sequence[ChannelEstimate], *, use_elevation: bool) -> bool:
    """Whether a campaign is solved in space: some path has an elevation, and `use_elevation` is true."""
    return use_elevation and any(has_elevations(estimate) for estimate in estimates)


def spatial_problem(estimate: ChannelEstimate, tx: Pose, noise: PathNoise) -> SpatialProblem:
    """Collect the paths of one stop; an elevation that was not estimated is 0 with a standard deviation of 40 deg.

    Raises `ValueError` where an elevation is beyond +-pi / 2 (degrees for radians); the message names stop,
    field and value.
    """
    elevations = np.column_stack([estimate.aod_elevation_rad, estimate.aoa_elevation_rad])
    for name, value in zip(("aod_elevation_rad", "aoa_elevation_rad"), elevations.T, strict=True):
        beyond = np.flatnonzero(np.abs(value) > np.pi / 2)
        if len(beyond):
            raise ValueError(
                f"stop {estimate.stop}: {name}[{beyond[0]}] = {value[beyond[0]]:g}: must be within +-pi / 2 rad"
            )
    measured = np.column_stack(
        [
            SPEED_OF_LIGHT_M_S * estimate.delay_s,
            estimate.aod_azimuth_rad,
            estimate.aoa_azimuth_rad,
            np.nan_to_num(elevations, nan=0.0),
        ]
    )
    covariance = spatial_covariance(estimate, noise, np.isfinite(elevations))
    return SpatialProblem(tx, measured, covariance, estimate.power_dbm + estimate.beam_loss_db)


def spatial_covariance(estimate: ChannelEstimate, noise: PathNoise, is_known: BoolArray) -> FloatArray:
    """R (path, 5, 5) in (m, rad, ...)^2; `is_known` (path, 2) marks the estimated elevations.

    Elevations have the floor of all angles, and the fixed standard deviation of angles where the estimate has no
    covariance of elevations.
    """
    covariance = np.zeros((len(estimate), 5, 5))
    covariance[:, :3, :3] = noise.covariance(estimate)
    given = noise.source == "estimate" and estimate.covariance.shape[-1] == covariance.shape[-1]
    angle = np.deg2rad(noise.angle_std_deg)
    for end in range(2):
        at, known = 3 + end, is_known[:, end]
        covariance[:, at, at] = np.where(known, angle**2, _UNKNOWN_STD_RAD**2)
        if given:
            scale = np.array([SPEED_OF_LIGHT_M_S, 1.0, 1.0, 1.0, 1.0])[: at + 1]
            row = np.nan_to_num(estimate.covariance[known, at, : at + 1]) * scale
            row[:, -1] += np.deg2rad(noise.floor_angle_std_deg) ** 2
            if end and len(row):
                row[:, 3] *= is_known[known, 0]
            covariance[known, at, : at + 1] = covariance[known, : at + 1, at] = row
    return covariance


def bounce_fit(problem: SpatialProblem, state: FloatArray) -> BounceFit:
    """Every path (path,) as a single bounce at every state (state, 5)."""
    at = bounce_equations(problem.tx, state[:, None], problem.measured)
    spread = at.by_measurement @ problem.covariance @ np.swapaxes(at.by_measurement, -1, -2)
    first = np.sqrt(np.maximum(spread[..., 0, 0], 1e-18))
    mixed = spread[..., 0, 1] / first
    second = np.sqrt(np.maximum(spread[..., 1, 1] - mixed**2, 1e-18))
    whiten = np.zeros_like(spread)
    whiten[..., 0, 0], whiten[..., 1, 1] = 1 / first, 1 / second
    whiten[..., 1, 0] = -mixed / first / second
    variance = problem.covariance[:, 1, 1] + problem.covariance[:, 2, 2]
    half = np.minimum(at.opening / 2, 1.0)
    slack = FEASIBLE_STDS * np.sqrt(variance * (1 - half**2)) / (2 * half)
    feasible = (at.length_m > 0) & (np.abs(at.fraction - 0.5) <= 0.5 + slack)
    return BounceFit(
        at.value_m,
        whiten,
        (whiten @ at.value_m[..., None])[..., 0],
        whiten @ at.by_state,
        np.asarray(np.log(first * second)),
        np.asarray(feasible),
    )


def bounce_log_ratio(fit: BounceFit, mixture: Mixture) -> FloatArray:
    """Log of the (single bounce : clutter) odds (state, path); -inf where a bounce is infeasible.

    Both whitened values are Student-t; for clutter each equation is uniform over `clutter_width_m`.
    """
    freedom = mixture.degrees_of_freedom
    peak = student_t_log_peak(freedom, 1)
    student = np.sum(peak - (freedom + 1) / 2 * np.log1p(fit.white**2 / freedom), axis=-1) - fit.log_scale
    share = mixture.clutter_share + mixture.double_share
    ratio = student + np.log((1 - share) / share) + 2 * np.log(mixture.clutter_width_m)
    return np.where(fit.is_feasible, ratio, -np.inf)


def los_fit(problem: SpatialProblem, state: FloatArray, index: int) -> tuple[FloatArray, FloatArray]:
    """Whitened residuals (state, 5) of the line of sight and their derivatives (state, 5, 5)."""
    whiten = np.linalg.inv(np.linalg.cholesky(problem.covariance[index]))
    difference = residual(problem.measured[index], predict_los(problem.tx, state))
    return difference @ whiten.T, -whiten @ los_jacobian_rx(problem.tx, state)
