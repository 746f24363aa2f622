"""What a campaign directory holds of every stop: truths, measured poses, channel estimates and maps.

All raise `ValueError` in one line where a file is missing, damaged or out of date.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from estimation.channel.hall.record import HallEstimates, no_hall
from estimation.channel.record import ChannelEstimate
from estimation.slam.transmitters import joined_paths
from isac_arena.campaign.campaign import link_stores
from isac_arena.campaign.chain.halls import keeps_hall
from isac_arena.campaign.directory import FAILED, CampaignStore
from isac_arena.campaign.files import complete_file, read_attribute, remove_file
from isac_arena.campaign.manifest import remedy
from isac_arena.campaign.measured import MeasuredTruth, with_clock
from isac_arena.campaign.results import CampaignResults, MapName, MapResult, StopEstimate
from isac_arena.campaign.shards import Stored, blocks, replaced_by, shard_name, write_shard
from isac_arena.user_functions.room import not_found
from sim.links import tx_links
from sim.signal.hardware.apply_impairments import with_surveyed_pose
from sim.truth import Truth

T = TypeVar("T")
OF_FUNCTIONS = ("estimate", "score")  # commands whose results depend on functions of the user


def pack_stops(store: CampaignStore) -> None:
    """Put the truths and channel estimates of a long campaign into shards, where a block of stops is complete."""
    for each, own_stops in link_stores(store):
        kinds = {"truth": [each.truth_fingerprint], "channel": [each.channel_fingerprint]}
        kinds["channel"].append(f"{each.channel_fingerprint}{FAILED}")
        for block in blocks(len(store.scene.stops)):
            stops = [stop for stop in block if stop in own_stops]
            for kind, fingerprints in kinds.items():
                names = [each.stop_file(kind, stop) for stop in stops]
                if any((each.root / name).is_file() for name in names):
                    found = {Path(name).name: _found(each, name, fingerprints) for name in names}
                    _write_shard(each.root / kind / shard_name(block[0], each.tx), found)


def _found(store: CampaignStore, name: str, fingerprints: Sequence[str]) -> Stored | None:
    return next((found for one in fingerprints if (found := store.current(name, one)) is not None), None)


def _write_shard(path: Path, files: Mapping[str, Stored | None]) -> None:
    """Write a shard and remove the files whose place it takes; nothing where a file is missing."""
    there = [(name, one) for name, one in files.items() if one is not None]
    if len(there) < len(files):
        return
    with complete_file(path) as partial:
        write_shard(partial, there)
    for file in replaced_by(path):
        remove_file(file)


def stored_truths(store: CampaignStore, n_stops: int, chosen: Sequence[int] | None = None) -> Iterator[Truth]:
    """The stored truth of every stop or of some, of several links one after the other.

    `ValueError` where one is missing.
    """
    stores = link_stores(store)
    for stop in range(n_stops) if chosen is None else chosen:
        for number, (each, stops) in enumerate(stores):
            if stop not in stops:
                continue
            what = f"the truth of stop {stop} ({each.stop_file('truth', stop)})"
            yield replace(present(store, each.truth(stop), what, "generate"), tx=number)


def measured_truths(store: CampaignStore, n_stops: int) -> Iterator[MeasuredTruth]:
    """What is known about every measured stop; `ValueError` where one is missing."""
    for stop in range(n_stops):
        yield present(store, store.measured_truth(stop), f"stop {stop} of the measurement", "import-paths")


def known_stops(
    store: CampaignStore, channel: Sequence[ChannelEstimate]
) -> Iterator[Truth] | Iterator[MeasuredTruth]:
    """Input of mapping at every stop: the measured pose, or the true one with the errors of its survey.

    A clock bias that was not measured is that of the line of sight among the paths of the stop.
    """
    if store.measured is not None:
        tx, truths = store.scene.standing_tx, measured_truths(store, len(channel))
        return (with_clock(*stop, tx) for stop in zip(truths, channel, strict=True))
    configs = [link.config for link in tx_links(store.config, store.scene)]
    return (with_surveyed_pose(configs[truth.tx], truth) for truth in stored_truths(store, len(channel)))


def channel_estimates(store: CampaignStore, n_stops: int) -> Iterator[StopEstimate]:
    """The reported paths of every stop's stored channel estimate in its hall; `ValueError` where one is missing.

    With several TX the paths of all, and the power map of the first.
    """
    stores = link_stores(store)
    halls = [_hall(each) for each, _ in stores]
    for stop in range(n_stops):
        parts: dict[int, StopEstimate] = {}
        for number, (each, stops) in enumerate(stores):
            if stop not in stops:
                continue
            what = f"the channel estimate of stop {stop} ({each.stop_file('channel', stop)})"
            parts[number] = present(store, each.channel(stop), what, "estimate")
        joined = joined_paths({k: halls[k].applied(part.channel.reported) for k, part in parts.items()})
        yield replace(next(iter(parts.values())), channel=joined)


def _hall(store: CampaignStore) -> HallEstimates:
    """The hall of a link; measured paths have none, and neither have those of other methods."""
    if store.measured is not None or not keeps_hall(store.config):
        return no_hall(np.zeros(0, int))
    return present(store, store.hall(), f"the hall (channel/hall{store.tx}.nc)", "estimate")


def stored_results(store: CampaignStore, n_stops: int) -> CampaignResults:
    """All estimates of a campaign directory; `ValueError` where some are missing."""
    estimates = list(channel_estimates(store, n_stops))
    maps: dict[MapName, MapResult] = {
        name: present(store, store.map_result(name), f"the {name} result (map/{name}.nc)", "estimate")
        for name in ("mapping", "slam")
    }
    power_maps = tuple(each.power_map for each in estimates) if store.measured is None else ()
    return CampaignResults(tuple(each.channel for each in estimates), power_maps, **maps)


def present(store: CampaignStore, value: T | None, what: str, verb: str) -> T:
    """The value that was read; `ValueError` where there is none: what it is, and the command that makes it."""
    if value is None:
        for path in [*sorted(store.directory.glob("*/*.nc")), store.directory / "provenance.nc"]:
            if path.is_file() and read_attribute(path, "fingerprint") is None:
                name = path.relative_to(store.directory).as_posix()
                raise ValueError(f"{path}: damaged, or no file of a campaign; {remedy(name)}")
        if verb in OF_FUNCTIONS and (cause := not_found(store.config.functions)):
            raise ValueError(f"{store.directory}: {cause}")
        raise ValueError(f"{store.directory}: {what} is missing or out of date; run 'arena {verb}' first")
    return value
