"""The hall of a link: versions of its paths by floor and ceiling, tied where they can be told."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from estimation.channel.calibration.record import spread_rows
from estimation.channel.hall.record import HallEstimates, no_hall
from estimation.channel.record import ChannelEstimate
from estimation.slam.transmitters import joined_paths
from isac_arena.campaign.config import CampaignConfig
from sim.config import LinkKind

if TYPE_CHECKING:
    from estimation.channel.hall.model import GivenHeights
    from isac_arena.campaign.driver import CampaignRun


def in_halls(run: CampaignRun, reported: Sequence[Sequence[ChannelEstimate]]) -> Iterator[ChannelEstimate]:
    """The paths of every stop, joined over the links, with versions tied; from those reported (link, stop)."""
    parts: dict[int, dict[int, ChannelEstimate]] = {}
    for row, (link, estimates) in enumerate(zip(run.links, reported, strict=True)):
        hall = kept_hall(link, estimates)
        for estimate in estimates:
            parts.setdefault(estimate.stop, {})[row] = hall.applied(estimate)
    return (joined_paths(parts[stop]) for stop in run.chosen_stops if stop in parts)


def make_halls(run: CampaignRun, *, again: bool) -> None:
    """Keep the hall of every link, from the kept estimates of all its stops; `again` where there is one already.

    One that is kept stays right where stops are made again: their estimates have the same bits.
    """
    for link in filter(lambda one: keeps_hall(one.config), run.links):
        if again or link.results.hall() is None:
            kept = [link.results.estimate(stop) for stop in link.chosen_stops]
            reported = [estimate.reported for estimate in kept if estimate is not None]
            link.results.write_hall(found_hall(link, reported))


def kept_hall(run: CampaignRun, reported: Sequence[ChannelEstimate]) -> HallEstimates:
    """The hall of a link and its paths, kept by its run or made from the reported paths of all its stops."""
    stops = np.array([estimate.stop for estimate in reported], int)
    if not keeps_hall(run.config):
        return no_hall(stops)
    kept: HallEstimates | None = run.results.hall()
    if kept is None or not np.array_equal(kept.stops, stops):
        kept = found_hall(run, reported)
        run.results.write_hall(kept)
    return kept


def found_hall(run: CampaignRun, reported: Sequence[ChannelEstimate]) -> HallEstimates:
    """The hall of a link and its paths from the reported paths of all its stops."""
    if len(reported) and has_hall(run):
        return hall_of(run, reported)
    return no_hall(np.array([estimate.stop for estimate in reported], int))


def keeps_hall(config: CampaignConfig) -> bool:
    """Whether a campaign keeps what it found of halls: with a maximum-likelihood method of ours."""
    channel = config.channel
    return channel.hall.use and channel.method != "power" and config.functions.of("channel") is None


def has_hall(run: CampaignRun) -> bool:
    """Whether the paths of a link are read as those of a hall: of a fixed TX to the walk."""
    is_standing = run.scene.tx_name not in run.scene.tx_motions
    return keeps_hall(run.config) and is_standing and run.config.role.kind == LinkKind.DOWNLINK


def hall_of(run: CampaignRun, reported: Sequence[ChannelEstimate]) -> HallEstimates:
    """The hall that the reported paths of a link show, and its paths."""
    from estimation.channel.hall.campaign import hall_estimates  # noqa: PLC0415  (slow to import)
    from estimation.channel.hall.model import HallLink  # noqa: PLC0415

    config, link = run.config, run.link
    cell_s = 1 / float(np.ptp(link.frequency_offset_hz))
    rows = spread_rows(len(reported), config.channel.hall.stops)
    codebooks = link.tx_codebook, link.rx_codebook
    return hall_estimates(reported, HallLink(*codebooks, config.channel.los, cell_s), _given(run), rows)


def _given(run: CampaignRun) -> GivenHeights:
    """The surveyed heights of the devices above the floor, which is at height 0."""
    from estimation.channel.hall.model import GivenHeights  # noqa: PLC0415

    tx_m = float(run.scene.standing_tx.position_m[2])
    if not run.config.heights.use:
        return GivenHeights(tx_m=tx_m)
    return GivenHeights(tx_m, run.scene.walk.height_m, run.config.heights.std_m)
