"""`arena validate scoring`: `arena bound` gives the bounds of the scores, at stops of every library campaign."""

from collections.abc import Sequence

import numpy as np

from estimation.channel.record import EstimateStatus, empty_estimate
from isac_arena.api import score
from isac_arena.campaign.campaign import Campaign, load_campaign
from isac_arena.campaign.load import library_campaigns
from isac_arena.insight.bounds.signal import SignalBounds
from isac_arena.validation.measurement import Measurement, at_most
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray


def check_bounds_of_campaigns(seed: int, quick: bool) -> list[Measurement]:
    """Bounds over the plan are made without diffuse paths, which are never significant; scores know all paths.

    Eight stops of every campaign of the library that `arena bound` takes, those with a walk; a quick run takes one
    stop of every fourth campaign.
    """
    rng, rows = np.random.default_rng(seed), []
    loaded = {name: load_campaign(name) for name in library_campaigns()}
    taken = [
        name for name, one in loaded.items() if any(run.config.role.kind.has_walk for run in one.chain().links)
    ]
    for name in taken[:: 4 if quick else 1]:
        campaign = loaded[name]
        at_walks = SignalBounds(campaign).stops
        stops = sorted(rng.choice(at_walks, min(1 if quick else 8, len(at_walks)), replace=False).tolist())
        worst = float(bound_difference(campaign, stops).max())
        reason = "the same definition, at the same stops: largest difference over the bound of the scores"
        rows.append(at_most(f"scoring.bound.{name}", worst, 0.01, reason))
    return rows


def bound_difference(campaign: Campaign, stops: Sequence[int]) -> FloatArray:
    """Relative difference (quantity, stop) of the bounds of `arena bound` from those of the scores.

    Quantities are position, heading and clock; bounds that are both infinite are equal.
    """
    truths = campaign.trace(stops)
    nothing = [empty_estimate(truth.stop, "none", EstimateStatus.NO_PATHS, "") for truth in truths]
    poses = score(campaign, truths, nothing).tables.poses
    scored = np.stack([poses.position_bound_m, poses.heading_bound_rad, SPEED_OF_LIGHT_M_S * poses.clock_bound_s])
    over_plan = SignalBounds(campaign)
    found = [over_plan.at_stop(stop) for stop in stops]
    drawn = np.array([[one.position_m[0], one.heading_rad[0], one.clock_m[0]] for one in found]).T
    with np.errstate(invalid="ignore"):
        return np.where(drawn == scored, 0.0, np.abs(drawn - scored) / scored)
