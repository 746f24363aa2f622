"""Paths seen from above: where beams show no elevation, known heights give plan lengths and true azimuths.

Every path is taken as level: it keeps its elevation all the way, as over upright surfaces. Paths by way of the
floor or the ceiling are not, and neither are paths too short for the height difference: these stay as observed.
The clock bias is part of every length. SLAM does not know it: it solves the stops and sees the paths from above in
turns. An error b of the bias changes a plan length L by b (l / L - 1) only, so a few turns are enough. They start
at the best of many distances of the first path: from a wrong one they can lead to a wrong mode.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from estimation.channel.record import AngleKind, ChannelEstimate
from estimation.laws.level import nearest_boresight, plan_paths
from estimation.slam.record import PoseEstimates, SolveStatus
from estimation.slam.transmitters import of_tx, replaced_paths
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray

if TYPE_CHECKING:
    from estimation.laws.raised import PathHeights

MAX_TURNS = 5
SETTLED_M = 1e-5  # change of the clock biases that ends the turns
DISTANCES_M = np.geomspace(1.5, 40.0, 12)  # in the plan, of a first path that is the line of sight
EQUAL_HEIGHTS_M = 1e-3

T = TypeVar("T")


@dataclass(frozen=True)
class KnownHeights:
    """Heights of the devices, and the panels that cone angles refer to.

    Attributes
    ----------
    difference_m : (stop,) height of the TX above the receiver, in the order of the channel estimates
    std_m : standard deviation of these differences
    tx_panel_rad, rx_panel_rad : (panel,) boresight azimuths in the device frames
    others : the same for the TX after the first
    """

    difference_m: FloatArray
    std_m: float
    tx_panel_rad: FloatArray
    rx_panel_rad: FloatArray
    others: tuple["KnownHeights", ...] = ()

    @property
    def by_tx(self) -> tuple["KnownHeights", ...]:
        """The heights of every TX."""
        return (replace(self, others=()), *self.others)

    def matter(self, estimates: Sequence[ChannelEstimate]) -> bool:
        """Whether any estimate looks different from above."""
        return any(any(map(_is_seen_otherwise, estimates, one.difference_m)) for one in self.by_tx)

    def of_paths(self, estimates: Sequence[ChannelEstimate]) -> "list[PathHeights]":
        """What the paths of every estimate need where a point between the devices has a height of its own."""
        from estimation.laws.raised import PathHeights  # noqa: PLC0415  (brings numba)

        ends = []
        for stop, estimate in enumerate(estimates):
            difference, boresight = np.zeros(len(estimate)), np.full((len(estimate), 2), np.nan)
            for tx, own in enumerate(self.by_tx):
                mine = estimate.tx == tx if self.others else np.ones(len(estimate), bool)
                difference[mine] = own.difference_m[stop]
                sides = (
                    (estimate.aod_angle_kind, estimate.aod_azimuth_rad, own.tx_panel_rad),
                    (estimate.aoa_angle_kind, estimate.aoa_azimuth_rad, own.rx_panel_rad),
                )
                for end, (kind, azimuth_rad, panel_rad) in enumerate(sides):
                    if kind == AngleKind.CONE:
                        boresight[mine, end] = nearest_boresight(azimuth_rad[mine], panel_rad)
            ends.append(PathHeights(difference, boresight))
        return ends

    def seen(self, estimate: ChannelEstimate, difference_m: float, clock_bias_s: float) -> ChannelEstimate:
        """One estimate as paths of the plane, the clock bias as before; azimuths that are no cone angles stay."""
        if not _is_seen_otherwise(estimate, difference_m):
            return estimate
        is_cone = np.array([k == AngleKind.CONE for k in (estimate.aod_angle_kind, estimate.aoa_angle_kind)])
        to_metres = np.array([SPEED_OF_LIGHT_M_S, 1.0, 1.0])
        covariance = estimate.plane_covariance * to_metres[:, None] * to_metres
        azimuth = np.column_stack([estimate.aod_azimuth_rad, estimate.aoa_azimuth_rad])
        panels = (self.tx_panel_rad, self.rx_panel_rad)
        boresight = np.column_stack([nearest_boresight(azimuth[:, end], panels[end]) for end in range(2)])
        std_rad = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, 1:])
        length_m = SPEED_OF_LIGHT_M_S * (estimate.delay_s - clock_bias_s)
        above = plan_paths(length_m, azimuth, boresight, is_cone, std_rad, np.array(difference_m))
        own, by_height = above.slope[..., :3], above.slope[..., 3]
        seen = own @ covariance @ own.swapaxes(1, 2) + self.std_m**2 * by_height[:, :, None] * by_height[:, None]
        is_level = above.is_possible
        plane = np.where(is_level[:, None, None], seen / to_metres[:, None] / to_metres, estimate.plane_covariance)
        value = np.where(is_level[:, None], above.value, np.column_stack([length_m, azimuth]))
        return replace(
            estimate,
            delay_s=clock_bias_s + value[:, 0] / SPEED_OF_LIGHT_M_S,
            aod_azimuth_rad=value[:, 1],
            aoa_azimuth_rad=value[:, 2],
            covariance=plane,
            aod_angle_kind=AngleKind.AZIMUTH,
            aoa_angle_kind=AngleKind.AZIMUTH,
        )


def _is_seen_otherwise(estimate: ChannelEstimate, difference_m: float) -> bool:
    """Whether an estimate has cone angles, no elevations, and devices at unequal heights."""
    is_cone = AngleKind.CONE in (estimate.aod_angle_kind, estimate.aoa_angle_kind)
    elevation = np.concatenate([estimate.aod_elevation_rad, estimate.aoa_elevation_rad])
    return bool(is_cone and abs(difference_m) >= EQUAL_HEIGHTS_M and not np.isfinite(elevation).any())


def seen_from_above(
    estimates: Sequence[ChannelEstimate], clock_bias_s: FloatArray, heights: KnownHeights | None
) -> Sequence[ChannelEstimate]:
    """The estimates as paths of the plane, at clock biases (stop,), with several TX (stop, tx); else unchanged.

    A clock bias that is not finite is interpolated. Estimates of azimuths stay: they are known to be horizontal,
    or have elevations.
    """
    if heights is None:
        return estimates
    if heights.others:
        parts = [
            seen_from_above(of_tx(estimates, tx), clock_bias_s[:, tx], own) for tx, own in enumerate(heights.by_tx)
        ]
        return replaced_paths(estimates, parts)
    clock_bias_s = clock_bias_s.reshape(len(estimates))
    rows = zip(estimates, heights.difference_m, interpolated(clock_bias_s, 0.0), strict=True)
    return [heights.seen(estimate, float(difference), float(own)) for estimate, difference, own in rows]


def solved_from_above(
    estimates: Sequence[ChannelEstimate],
    heights: KnownHeights,
    solve: Callable[[Sequence[ChannelEstimate]], tuple[PoseEstimates, T]],
    alone: Callable[[Sequence[ChannelEstimate], int], PoseEstimates],
) -> tuple[PoseEstimates, T]:
    """What `solve` finds for the paths seen from above, with the clock biases that it finds itself.

    `alone` solves every stop by itself from the paths of one TX, which gives the first clock biases.
    """
    bias_s = np.column_stack(
        [_starting_biases_s(of_tx(estimates, tx), own, alone, tx) for tx, own in enumerate(heights.by_tx)]
    )
    for _ in range(MAX_TURNS):
        poses, rest = solve(seen_from_above(estimates, bias_s, heights))
        before_s, found = bias_s, poses.tx_clock_bias_s
        bias_s = np.column_stack([interpolated(column, 0.0) for column in found.T])
        moved_m = SPEED_OF_LIGHT_M_S * np.abs(bias_s - before_s)
        if moved_m.max(initial=0.0) < SETTLED_M:
            break
    return poses, rest


def _starting_biases_s(
    estimates: Sequence[ChannelEstimate],
    heights: KnownHeights,
    alone: Callable[[Sequence[ChannelEstimate], int], PoseEstimates],
    tx: int,
) -> FloatArray:
    """Clock biases (stop,) of the stops alone, each from the distance of its first path that costs least."""
    first_s = np.array([estimate.delay_s.min(initial=np.inf) for estimate in estimates])
    bias_s, least = np.full(len(estimates), np.nan), np.full(len(estimates), np.inf)
    for distance_m in DISTANCES_M:
        trial_s = first_s - np.hypot(distance_m, heights.difference_m) / SPEED_OF_LIGHT_M_S
        poses = alone(seen_from_above(estimates, trial_s, heights), tx)
        is_better = (poses.status != SolveStatus.FAILED) & (poses.cost < least)
        bias_s, least = np.where(is_better, poses.clock_bias_s, bias_s), np.where(is_better, poses.cost, least)
    return interpolated(bias_s, 0.0)


def interpolated(value: FloatArray, default: float) -> FloatArray:
    """Values (stop,) with those not finite interpolated from the neighbours; `default` where there are none."""
    known = np.flatnonzero(np.isfinite(value))
    if not len(known):
        return np.full(len(value), default)
    return np.interp(np.arange(len(value)), known, value[known])
