"""A campaign as the public measurement file would have it: estimates, surveyed receivers, true labels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from estimation.channel.record import ChannelEstimate
from isac_arena.campaign.measured import MeasuredStop, MeasuredTruth
from isac_arena.scoring.record import PathKind, PathScores, PathStatus
from scenes.pose import SPEED_OF_LIGHT_M_S
from sim.truth import Truth


def labelled_stops(
    channel: Sequence[ChannelEstimate], truths: Iterable[Truth | MeasuredTruth], paths: PathScores
) -> list[MeasuredStop]:
    """The stops of a measurement file: estimated paths with the true clock bias taken off their ranges.

    A path is labelled by the true one that it was assigned to; those of no detected path have no label.
    """
    stops = []
    for estimate, truth in zip(channel, truths, strict=True):
        rows = paths.take("estimate", paths.stop == estimate.stop)
        rows = rows.take("estimate", np.argsort(rows.path))
        detected = rows.status == PathStatus.DETECTED
        is_single = detected & (rows.kind == PathKind.SINGLE_BOUNCE)
        range_m = SPEED_OF_LIGHT_M_S * (estimate.delay_s - truth.clock_bias_s)
        stops.append(
            MeasuredStop(
                rx=np.array([*truth.rx_pose.position_m[:2], truth.rx_pose.heading_rad]),
                measured=np.column_stack([range_m, estimate.aod_azimuth_rad, estimate.aoa_azimuth_rad]),
                power_dbm=estimate.power_dbm,
                is_los=detected & (rows.kind == PathKind.LOS),
                is_single_bounce=is_single,
                landmark_m=np.where(is_single[:, None], rows.vertex_m, np.nan),
            )
        )
    return stops
