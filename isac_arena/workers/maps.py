"""The maps of a campaign side by side: mapping on a worker, SLAM here, each into the files of a directory."""

from collections.abc import Sequence

from estimation.channel.record import ChannelEstimate
from isac_arena.campaign.chain.inputs import known_receiver
from isac_arena.campaign.directory import CampaignStore
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.stored import channel_estimates, known_stops
from isac_arena.user_functions.errors import EstimatorError
from isac_arena.workers.stops import StopMakers, StopWork, campaign_run, stop_run
from scenes.memory import limited_memory, memory_limit_bytes


def make_maps(
    store: CampaignStore, run: CampaignRun, makers: StopMakers, channel: Sequence[ChannelEstimate]
) -> list[EstimatorError]:
    """Make both maps, mapping on a worker where `makers` have some. Returns the failures that `run` did not hear.

    Where the worker finds too little memory or dies, this process makes it.
    """
    receiver = known_receiver(known_stops(store, channel))
    work = stop_run(store, keeps_sweeps=False, estimates=True).work
    mapping = makers.begun(_mapping_there, (work, f"{memory_limit_bytes() / 2:.0f}B"))
    if mapping is not None:
        run.map("slam", channel, receiver)
        found = mapping()
        if not isinstance(found, BaseException):
            return found
    run.maps(channel, receiver)
    return []


def _mapping_there(call: tuple[StopWork, str]) -> list[EstimatorError]:
    """Make the map of mapping in a worker, with its share of the memory; failures of a user's functions."""
    work, share = call
    failures: list[EstimatorError] = []
    with limited_memory(share):
        store = work.store
        run = campaign_run(store, failures.append)
        channel = [estimate.channel for estimate in channel_estimates(store, len(run.chosen_stops))]
        run.map("mapping", channel, known_receiver(known_stops(store, channel)))
    return failures
