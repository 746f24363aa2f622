"""The runs of the links of a campaign: one for every TX, or for every link that the campaign states."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from isac_arena.campaign.chain.inputs import links_of
from isac_arena.campaign.results import Oracle
from sim.config import LinkKind
from sim.simulate import is_heard

if TYPE_CHECKING:
    from isac_arena.campaign.driver import CampaignRun


def runs_of_links(run: CampaignRun) -> tuple[CampaignRun, ...]:
    """A run for every link of a run, or for those in its `only`; of a campaign with one TX the run itself."""
    found = links_of(run.config, run.scene)
    if found[0].config is run.config:
        return (run,)
    return tuple(
        replace(
            run,
            config=link.config,
            scene=link.scene,
            results=run.results.of_tx(link.name) if len(found) > 1 else run.results,
            stops=[stop for stop in run.chosen_stops if stop in link.stops],
            paths=[truth for truth in run.paths if truth.tx == number],
            oracle=Oracle(),
            whole=run,
            only=None,
        )
        for number, link in enumerate(found)
        if run.only is None or number in run.only
    )


def disturbing(run: CampaignRun) -> tuple[CampaignRun, ...]:
    """The runs of the other links whose TX are heard in the sweeps of the run of a link: of those to the walk."""
    if run.whole is None or run.config.role.kind != LinkKind.DOWNLINK:
        return ()
    others = [one for one in run.whole.links if one is not run and one.config.role.kind == LinkKind.DOWNLINK]
    return tuple(one for one in others if is_heard(run.config, run.link, one.config, one.link))
