"""The maps of a run: mapping from the receiver states that are given, and SLAM without them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from estimation.channel.record import ChannelEstimate
from estimation.slam.checks import check_estimates
from estimation.slam.record import IncidencePoints, PoseEstimates
from isac_arena.campaign.chain.inputs import unsolved_poses
from isac_arena.campaign.chain.maps import campaign_tracks, without_map
from isac_arena.campaign.chain.walks import from_nodes, located_walks
from isac_arena.campaign.results import MapName, MapResult
from isac_arena.user_functions.errors import EstimatorError
from scenes.record import empty_record

if TYPE_CHECKING:
    from isac_arena.campaign.driver import CampaignRun


def one_map(
    run: CampaignRun, name: MapName, channel: Sequence[ChannelEstimate], receiver: PoseEstimates
) -> MapResult:
    """A map, kept by the run or made; SLAM also has the published one and the tracks of what moves."""
    kept = run.results.map_result(name)
    if kept is None or kept.problem:
        channel = from_nodes(run, channel)
        check_estimates(channel, run.scene.standing_tx)
        kept = _map(run, channel, receiver if name == "mapping" else None, receiver)
        if name == "slam":
            run.on_step("published SLAM")
            published = located_walks(run, run.oracle.channel or channel, receiver, published=True)[0]
            kept = _with_tracks(run, replace(kept, published=published), channel)
        run.results.write_map(name, kept)
    return kept


def _map(
    run: CampaignRun, channel: Sequence[ChannelEstimate], states: PoseEstimates | None, receiver: PoseEstimates
) -> MapResult:
    """One map; where a user's function fails, what there is without it."""
    stops = [estimate.stop for estimate in channel]
    poses = unsolved_poses(stops, len(run.links)) if states is None else states
    ips = empty_record(IncidencePoints)
    name = "SLAM" if states is None else "mapping"
    try:
        run.on_step(name)
        mapping = run.learned_mapping(channel, states)
        if states is None:
            poses, ips = located_walks(run, channel, receiver)
        else:
            poses, ips = run.locate(channel, states, mapping)
        run.on_step(f"contours of {name}")
        return run.shape(channel, poses, ips, mapping)
    except EstimatorError as error:
        run.tell(error)
        return without_map(run.config, channel, run.tx, poses, ips, str(error))


def _with_tracks(run: CampaignRun, found: MapResult, channel: Sequence[ChannelEstimate]) -> MapResult:
    """The map with the tracks of what moves; where a user's function fails, without."""
    try:
        return replace(found, tracks=campaign_tracks(run.config, run.scene, run.tx, channel, found.poses))
    except EstimatorError as error:
        run.tell(error)
        return replace(found, problem="\n".join(filter(None, (found.problem, str(error)))))
