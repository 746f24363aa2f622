"""Offsets of clock and headings of a measured campaign, from lines of sight and from other stops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.slam.walk.sessions import segment_offsets
from isac_arena.campaign.measured import PUBLISHED_NOISE, MeasuredCampaign
from isac_arena.insight.twin.matching import WIDE_GATE
from isac_arena.insight.twin.record import HeadingSource, Offsets, TwinPaths
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

MIN_SESSION_PATHS = 5  # explained paths that an offset is corrected by


def measured_parameters(campaign: MeasuredCampaign, stop: int) -> FloatArray:
    """Delay in s without the known clock bias, departure and arrival in rad (path, 3) of a stop, device frames."""
    estimate = campaign.channel[stop]
    delay_s = estimate.delay_s - campaign.truths[stop].clock_bias_s
    return np.column_stack([delay_s, estimate.aod_azimuth_rad, estimate.aoa_azimuth_rad])


def straight_residuals(campaign: MeasuredCampaign, stop: int) -> FloatArray:
    """Measured paths (path, 3) of a stop less the straight line between the surveyed devices."""
    pose = campaign.truths[stop].rx_pose
    along = pose.position_m - campaign.tx.position_m
    azimuth = np.arctan2(along[1], along[0])
    straight = [
        float(np.linalg.norm(along)) / SPEED_OF_LIGHT_M_S,
        azimuth - campaign.tx.heading_rad,
        azimuth + np.pi - pose.heading_rad,
    ]
    residual: FloatArray = measured_parameters(campaign, stop) - np.array(straight)
    residual[:, 1:] = wrap_angle(residual[:, 1:])
    return residual


def sight_residuals(campaign: MeasuredCampaign) -> FloatArray:
    """Residuals (stop, 3) of the labelled line of sight of every stop, NaN where there is none."""
    found = np.full((len(campaign.truths), 3), np.nan)
    for stop, truth in enumerate(campaign.truths):
        if truth.is_los.any():
            found[stop] = straight_residuals(campaign, stop)[truth.is_los][0]
    return found


def without_offsets(campaign: MeasuredCampaign, stop: int, offsets: Offsets) -> FloatArray:
    """Delay in s, departure and arrival in rad (path, 3) of a stop with its offsets taken off."""
    parameters = measured_parameters(campaign, stop)
    path = offsets.heading_path[stop]
    parameters -= [offsets.delay_s[stop], offsets.aod_rad[stop], offsets.aoa_rad[stop]]
    if path >= 0:
        parameters[path, 2] += offsets.aoa_rad[stop] - offsets.told_aoa_rad[stop]
    return parameters


def find_sessions(sight: FloatArray) -> IntArray:
    """Session (stop,) of every stop: stretches between jumps of the departures of the lines of sight (stop, 3)."""
    seen = np.flatnonzero(np.isfinite(sight[:, 1]))
    std = np.full(len(seen), np.deg2rad(PUBLISHED_NOISE.angle_std_deg))
    first, _ = segment_offsets(sight[seen, 1], std)
    return np.asarray(np.searchsorted(seen[first[1:]], np.arange(len(sight)), side="right"), int)


def leave_one_out(n_stops: int) -> BoolArray:
    """Which stops (stop, stop) tell about each: all others."""
    return ~np.eye(n_stops, dtype=bool)


def other_half(n_stops: int) -> BoolArray:
    """Which stops (stop, stop) tell about each: of every second stop those that lie between."""
    odd = np.arange(n_stops) % 2
    return np.asarray(odd[:, None] != odd[None])


def sight_offsets(campaign: MeasuredCampaign, tells: BoolArray) -> Offsets:
    """Offsets of every stop from lines of sight alone.

    Delay: median over the lines of sight of the stops that tell about it (`tells` (stop, stop), never the stop
    itself). Departure: the same within its session. Arrival, the heading of the RX: that of the stop's own line of
    sight; where it has none that of a path with the delay and departure of the straight line, which goes through
    a wall; else the median over the stops that tell. No reflected path is looked at.

    Raises
    ------
    ValueError
        Where a stop has no line of sight among those that tell about it.
    """
    sight = sight_residuals(campaign)
    seen = np.isfinite(sight[:, 0])
    n_stops = len(sight)
    lonely = np.flatnonzero(~(tells & seen).any(axis=1))
    if len(lonely):
        raise ValueError(
            f"stop {lonely[0]}: {int(seen.sum())} labelled lines of sight in {n_stops} stops are too few for its"
            " offsets; two or more are needed at stops of even number, and two or more at stops of odd number"
        )
    session = find_sessions(sight)
    offset = np.zeros((n_stops, 3))
    source, path = np.full((2, n_stops), -1)
    told_aoa = np.zeros(n_stops)
    for stop in range(n_stops):
        known = tells[stop] & seen
        alike = known & (session == session[stop])
        offset[stop] = np.median(sight[known], axis=0)
        if alike.any():
            offset[stop, 1] = np.median(sight[alike, 1])
        told_aoa[stop] = offset[stop, 2]
        source[stop], path[stop] = _heading_path(campaign, stop, offset[stop])
        if path[stop] >= 0:
            offset[stop, 2] = straight_residuals(campaign, stop)[path[stop], 2]
    return Offsets(offset[:, 0], offset[:, 1], offset[:, 2], source, path, told_aoa, session)


def corrected_offsets(offsets: Offsets, paths: TwinPaths, used: BoolArray, tells: BoolArray) -> Offsets:
    """Offsets corrected by the median residual of explained paths of the stops that tell about a stop.

    `used` (path,) are the paths to look at. The delay takes all stops, the angles those of the same session; too
    few paths correct nothing.
    """
    columns = (paths.delay_residual_s, paths.aod_residual_rad, paths.aoa_residual_rad)
    residual = np.column_stack(columns)
    used = used & paths.is_explained
    shift = np.zeros((len(offsets.session), 3))
    for stop in range(len(shift)):
        known = used & tells[stop][paths.stop]
        alike = known & (offsets.session[paths.stop] == offsets.session[stop])
        if known.sum() >= MIN_SESSION_PATHS:
            shift[stop, 0] = np.median(residual[known, 0])
        if alike.sum() >= MIN_SESSION_PATHS:
            shift[stop, 1:] = np.median(residual[alike, 1:], axis=0)
    return replace(
        offsets,
        delay_s=offsets.delay_s + shift[:, 0],
        aod_rad=offsets.aod_rad + shift[:, 1],
        aoa_rad=offsets.aoa_rad + shift[:, 2],
        told_aoa_rad=offsets.told_aoa_rad + shift[:, 2],
    )


def _heading_path(campaign: MeasuredCampaign, stop: int, offset: FloatArray) -> tuple[HeadingSource, int]:
    """The path that tells the heading of a stop, -1 for none; `offset` (3,) is what the other stops tell."""
    is_los = campaign.truths[stop].is_los
    if is_los.any():
        return HeadingSource.LINE_OF_SIGHT, int(np.argmax(is_los))
    miss = np.abs(straight_residuals(campaign, stop)[:, :2] - offset[:2]) / WIDE_GATE[:2]
    best = int(np.argmin(miss.max(axis=1)))
    if miss[best].max() <= 1:
        return HeadingSource.STRAIGHT, best
    return HeadingSource.OTHER_STOPS, -1
