"""Offsets of delays and angles of a measured campaign, from lines of sight and from other stops."""

from dataclasses import replace

import numpy as np

from estimation.slam.walk.sessions import segment_offsets
from isac_arena.campaign.measured import PUBLISHED_NOISE, MeasuredCampaign
from isac_arena.insight.twin.record import WIDE_GATE, HeadingSource, Offsets, TwinPaths
from scenes.pose import SPEED_OF_LIGHT_M_S, wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray

MIN_SESSION_PATHS = 5  # fewer explained paths do not correct an offset


def measured_parameters(campaign: MeasuredCampaign, stop: int) -> FloatArray:
    """Delay in s without the known clock bias, departure and arrival in rad (path, 3) of a stop, device frames."""
    estimate = campaign.channel[stop]
    delay_s = estimate.delay_s - campaign.truths[stop].clock_bias_s
    return np.column_stack([delay_s, estimate.aod_azimuth_rad, estimate.aoa_azimuth_rad])


def straight_residuals(campaign: MeasuredCampaign, stop: int) -> FloatArray:
    """Measured parameters (path, 3) of a stop minus those of the straight line between the surveyed devices."""
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
    """Delay in s, departure and arrival in rad (path, 3) of a stop, minus its offsets."""
    parameters = measured_parameters(campaign, stop)
    path = offsets.heading_path[stop]
    parameters -= [offsets.delay_s[stop], offsets.aod_rad[stop], offsets.aoa_rad[stop]]
    if path >= 0:
        parameters[path, 2] += offsets.aoa_rad[stop] - offsets.other_aoa_rad[stop]
    return parameters


def find_sessions(sight: FloatArray) -> IntArray:
    """Session (stop,) of every stop: sessions begin where the departures of the lines of sight (stop, 3) jump."""
    seen = np.flatnonzero(np.isfinite(sight[:, 1]))
    std = np.full(len(seen), np.deg2rad(PUBLISHED_NOISE.angle_std_deg))
    first, _ = segment_offsets(sight[seen, 1], std)
    return np.asarray(np.searchsorted(seen[first[1:]], np.arange(len(sight)), side="right"), int)


def leave_one_out(n_stops: int) -> BoolArray:
    """Mask (stop, stop) of the stops that each stop is calibrated on: all others."""
    return ~np.eye(n_stops, dtype=bool)


def other_half(n_stops: int) -> BoolArray:
    """Mask (stop, stop) of the stops that each stop is calibrated on: even stops for odd ones and vice versa."""
    odd = np.arange(n_stops) % 2
    return np.asarray(odd[:, None] != odd[None])


def sight_offsets(campaign: MeasuredCampaign, others: BoolArray) -> Offsets:
    """Offsets of every stop from lines of sight alone.

    `others` (stop, stop) are the stops that each stop is calibrated on, never the stop itself. The offset of the
    delay is the median over their lines of sight, that of the departure the same within the session of the stop.
    The offset of the arrival, which is the heading of the RX, comes from the stop's own line of sight. A stop
    without one takes a path with the delay and departure of the straight line, which passes through a wall, or
    else the median over the other stops. Reflected paths are not used.

    Raises `ValueError` where a stop has no line of sight among the stops that it is calibrated on.
    """
    sight = sight_residuals(campaign)
    seen = np.isfinite(sight[:, 0])
    n_stops = len(sight)
    without = np.flatnonzero(~(others & seen).any(axis=1))
    if len(without):
        raise ValueError(
            f"stop {without[0]}: {int(seen.sum())} labelled lines of sight in {n_stops} stops are too few for its"
            " offsets; two or more are needed at stops of even number, and two or more at stops of odd number"
        )
    session = find_sessions(sight)
    offset = np.zeros((n_stops, 3))
    source, path = np.full((2, n_stops), -1)
    other_aoa = np.zeros(n_stops)
    for stop in range(n_stops):
        known = others[stop] & seen
        in_session = known & (session == session[stop])
        offset[stop] = np.median(sight[known], axis=0)
        if in_session.any():
            offset[stop, 1] = np.median(sight[in_session, 1])
        other_aoa[stop] = offset[stop, 2]
        source[stop], path[stop] = _heading_path(campaign, stop, offset[stop])
        if path[stop] >= 0:
            offset[stop, 2] = straight_residuals(campaign, stop)[path[stop], 2]
    return Offsets(offset[:, 0], offset[:, 1], offset[:, 2], source, path, other_aoa, session)


def corrected_offsets(offsets: Offsets, paths: TwinPaths, used: BoolArray, others: BoolArray) -> Offsets:
    """Offsets corrected by the median residual of explained paths of other stops (`others` (stop, stop)).

    `used` (path,) selects the paths. The delay is corrected by all other stops, the angles by those of the same
    session. Fewer than `MIN_SESSION_PATHS` paths correct nothing.
    """
    columns = (paths.delay_residual_s, paths.aod_residual_rad, paths.aoa_residual_rad)
    residual = np.column_stack(columns)
    used = used & paths.is_explained
    shift = np.zeros((len(offsets.session), 3))
    for stop in range(len(shift)):
        known = used & others[stop][paths.stop]
        in_session = known & (offsets.session[paths.stop] == offsets.session[stop])
        if known.sum() >= MIN_SESSION_PATHS:
            shift[stop, 0] = np.median(residual[known, 0])
        if in_session.sum() >= MIN_SESSION_PATHS:
            shift[stop, 1:] = np.median(residual[in_session, 1:], axis=0)
    return replace(
        offsets,
        delay_s=offsets.delay_s + shift[:, 0],
        aod_rad=offsets.aod_rad + shift[:, 1],
        aoa_rad=offsets.aoa_rad + shift[:, 2],
        other_aoa_rad=offsets.other_aoa_rad + shift[:, 2],
    )


def _heading_path(campaign: MeasuredCampaign, stop: int, offset: FloatArray) -> tuple[HeadingSource, int]:
    """The path that gives the heading of a stop, -1 for none; `offset` (3,) is estimated from other stops."""
    is_los = campaign.truths[stop].is_los
    if is_los.any():
        return HeadingSource.LINE_OF_SIGHT, int(np.argmax(is_los))
    miss = np.abs(straight_residuals(campaign, stop)[:, :2] - offset[:2]) / WIDE_GATE[:2]
    best = int(np.argmin(miss.max(axis=1)))
    if miss[best].max() <= 1:
        return HeadingSource.STRAIGHT, best
    return HeadingSource.OTHER_STOPS, -1
