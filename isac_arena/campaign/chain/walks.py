"""SLAM of a campaign: of what walks. Stops at fixed nodes have known states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.known_nodes import joined_points, joined_states, of_links
from estimation.slam.record import IncidencePoints, PoseEstimates
from estimation.slam.stops import published_poses
from estimation.slam.transmitters import seen_from_nodes
from isac_arena.campaign.results import MemoryResults
from scenes.record import empty_record
from sim.config import LinkKind

if TYPE_CHECKING:
    from isac_arena.campaign.driver import CampaignRun


def from_nodes(run: CampaignRun, channel: Sequence[ChannelEstimate]) -> Sequence[ChannelEstimate]:
    """The estimates as maps take them: departures at fixed nodes, whichever end of a link sends."""
    return seen_from_nodes(channel, np.array([link.config.role.kind == LinkKind.UPLINK for link in run.links]))


def located_walks(
    run: CampaignRun, channel: Sequence[ChannelEstimate], receiver: PoseEstimates, *, published: bool = False
) -> tuple[PoseEstimates, IncidencePoints]:
    """States and incidence points by SLAM, ours or (without points) as published.

    Stops at fixed nodes keep their states of `receiver` and have the points of mapping.
    """
    is_node = np.array([run.links_at(stop)[0].config.role.receiver is not None for stop in run.chosen_stops], bool)
    if not is_node.any():
        return _located(run, channel, published=published)
    own = np.flatnonzero([link.config.role.receiver is None for link in run.links])
    stops, known = np.array(run.chosen_stops), receiver.take("stop", is_node)
    known = replace(known, height_std_m=np.full(len(known.stop), np.nan))
    at_nodes = [one for one, there in zip(channel, is_node, strict=True) if there]
    nodes = replace(run, stops=stops[is_node].tolist(), results=MemoryResults())
    points = nodes.locate(at_nodes, known, nodes.learned_mapping(at_nodes, known))[1]
    if is_node.all():
        return known, points
    walks = replace(run, stops=stops[~is_node].tolist(), only=own.tolist(), results=MemoryResults())
    seen = of_links([one for one, there in zip(channel, is_node, strict=True) if not there], own)
    poses, found = _located(walks, seen, published=published)
    return joined_states(poses, own, known), joined_points(found, own, points)


def _located(
    run: CampaignRun, channel: Sequence[ChannelEstimate], *, published: bool
) -> tuple[PoseEstimates, IncidencePoints]:
    if published:
        return published_poses(channel, run.tx, run.config.slam), empty_record(IncidencePoints)
    return run.locate(channel)
