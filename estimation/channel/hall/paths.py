"""The paths of one stop in metres and radians, and the plan path that each would have as each version."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.channel.hall.geometry import ELEVATION_SIGNS
from estimation.channel.record import AngleKind, ChannelEstimate
from estimation.laws.level import nearest_boresight, plan_paths
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import BoolArray, FloatArray, IntArray
from sim.signal.arrays.codebook import Codebook

ELEVATION_OUTLIER_DENSITY = 0.05 / np.pi  # per rad: one elevation in twenty is wrong
NO_ELEVATION_STD_RAD = 10.0  # of an elevation that was not estimated


@dataclass(frozen=True)
class RangedPaths:
    """What a channel estimate says of the geometry of its paths.

    Attributes
    ----------
    range_m : (path,) delays times the speed of light, clock bias included
    azimuth_rad, elevation_rad : (path, end) at TX and receiver, device frames; an unknown elevation is 0
    boresight_rad : (path, end) of the panel in front
    is_cone : (end,) whether azimuths are cone angles about the boresight
    covariance : (path, 5, 5) of range in m, both azimuths, both elevations; unknown elevations have wide ones
    cross : (path, path, 5, 5) covariance between paths that are not resolved from each other, else 0
    """

    range_m: FloatArray
    azimuth_rad: FloatArray
    elevation_rad: FloatArray
    boresight_rad: FloatArray
    is_cone: BoolArray
    covariance: FloatArray
    cross: FloatArray

    def __len__(self) -> int:
        return len(self.range_m)

    @property
    def variance(self) -> FloatArray:
        """Variances (path, 5)."""
        return np.asarray(np.einsum("paa->pa", self.covariance))

    @property
    def sees_elevation(self) -> BoolArray:
        """Ends (path, end) at which the elevation was estimated."""
        return np.asarray(self.variance[:, 3:] < NO_ELEVATION_STD_RAD**2 / 2)

    def take(self, index: IntArray | BoolArray) -> RangedPaths:
        """Some of the paths."""
        return RangedPaths(
            range_m=self.range_m[index],
            azimuth_rad=self.azimuth_rad[index],
            elevation_rad=self.elevation_rad[index],
            boresight_rad=self.boresight_rad[index],
            is_cone=self.is_cone,
            covariance=self.covariance[index],
            cross=self.cross[index][:, index],
        )


def stop_paths(estimate: ChannelEstimate, tx: Codebook, rx: Codebook) -> RangedPaths:
    """The paths of an estimate that was made with these codebooks."""
    n = len(estimate)
    azimuth = np.stack([estimate.aod_azimuth_rad, estimate.aoa_azimuth_rad], axis=1)
    elevation = np.stack([estimate.aod_elevation_rad, estimate.aoa_elevation_rad], axis=1)
    unit = np.array([SPEED_OF_LIGHT_M_S, 1.0, 1.0, 1.0, 1.0])
    covariance = np.broadcast_to(NO_ELEVATION_STD_RAD**2 * np.eye(5), (n, 5, 5)).copy()
    size = estimate.covariance.shape[1]
    given = estimate.covariance * unit[:size, None] * unit[:size]
    unknown = np.isnan(given)
    covariance[:, :size, :size] = np.where(unknown, covariance[:, :size, :size] * np.eye(size), given)
    return RangedPaths(
        range_m=SPEED_OF_LIGHT_M_S * estimate.delay_s,
        azimuth_rad=azimuth,
        elevation_rad=np.nan_to_num(elevation),
        boresight_rad=np.stack(
            [
                nearest_boresight(azimuth[:, 0], tx.panel_azimuth_rad),
                nearest_boresight(azimuth[:, 1], rx.panel_azimuth_rad),
            ],
            axis=1,
        ),
        is_cone=np.array([kind == AngleKind.CONE for kind in (estimate.aod_angle_kind, estimate.aoa_angle_kind)]),
        covariance=covariance,
        cross=_cross(estimate, unit),
    )


def _cross(estimate: ChannelEstimate, unit: FloatArray) -> FloatArray:
    n, cross = len(estimate), np.zeros((len(estimate), len(estimate), 5, 5))
    if estimate.correlated is not None:
        known = estimate.correlated.dense(n)
        size = known.shape[2]
        cross[:, :, :size, :size] = known * unit[:size, None] * unit[:size]
    return cross


@dataclass(frozen=True)
class PlanPoints:
    """The plan path of every path as every version, with first-order covariances.

    Attributes
    ----------
    value : (path, version, 3) plan length in m, azimuths of departure and arrival in rad
    slope : (path, version, 3, 4) over the range in m, both observed azimuths, and the height difference in m
    covariance : (path, version, 3, 3) from the errors of the path alone: clock and heights are given
    is_possible : (path, version) whether the path is long enough, and its cone narrow enough
    """

    value: FloatArray
    slope: FloatArray
    covariance: FloatArray
    is_possible: BoolArray


def plan_points(paths: RangedPaths, clock_m: float, differences_m: FloatArray) -> PlanPoints:
    """Plan paths from a clock bias in m and the height differences (version,)."""
    seen = plan_paths(
        (paths.range_m - clock_m)[:, None],
        paths.azimuth_rad[:, None],
        paths.boresight_rad[:, None],
        paths.is_cone,
        np.sqrt(paths.variance[:, None, 1:3]),
        differences_m,
    )
    slope = np.where(seen.is_possible[..., None, None], seen.slope, np.eye(3, 4))
    own = slope[..., :3]
    covariance = np.einsum("pvai,pij,pvbj->pvab", own, paths.covariance[:, :3, :3], own)
    return PlanPoints(seen.value, slope, covariance, seen.is_possible)


def expected_elevation(plan_m: FloatArray, differences_m: FloatArray, end: int) -> FloatArray:
    """Elevation (path, version) in rad at the TX (end 0) or receiver (end 1) over plan lengths (path, version)."""
    return np.asarray(np.arctan2(ELEVATION_SIGNS[:, end] * differences_m, plan_m))


def elevation_log_likelihood(paths: RangedPaths, plan_m: FloatArray, differences_m: FloatArray) -> FloatArray:
    """Log-likelihood (path, version) of the elevations observed, as a version of plan length (path, version).

    Ends without elevation add 0. Outliers are uniform.
    """
    total = np.zeros(plan_m.shape)
    for end in range(2):
        variance = paths.variance[:, None, 3 + end]
        error = paths.elevation_rad[:, None, end] - expected_elevation(plan_m, differences_m, end)
        normal = -0.5 * error**2 / variance - 0.5 * np.log(2 * np.pi * variance)
        seen = np.logaddexp(normal, np.log(ELEVATION_OUTLIER_DENSITY))
        total += np.where(paths.sees_elevation[:, None, end], seen, 0.0)
    return total
