"""Tracks of movers in campaigns of the library, against a Kalman filter with nearest neighbours."""

from collections.abc import Sequence
from dataclasses import replace

from estimation.channel.record import ChannelEstimate
from isac_arena.campaign.campaign import load_campaign
from isac_arena.campaign.chain.maps import campaign_tracks
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.results import CampaignResults
from isac_arena.validation.measurement import Measurement, at_most
from sim.truth import Truth

QUICK_STOPS = 3  # of the room


def check_tracks(seed: int, quick: bool) -> list[Measurement]:
    """The whole chain: the room with two movers; in full also the hall with eight and a receiver that walks."""
    rows = _rows("moving_target", seed, range(QUICK_STOPS) if quick else None)
    return rows if quick else rows + _rows("campus_arena_busy", seed, None)


def _rows(name: str, seed: int, stops: Sequence[int] | None) -> list[Measurement]:
    campaign = load_campaign(name, seed=seed)
    ours = CampaignRun(campaign.config, campaign.scene, stops=stops)
    truths = list(ours.truths())
    channel = list(ours.channel(truths))
    results = CampaignResults(tuple(channel), (), **ours.maps(channel, ours.surveyed_receiver(truths)))
    nearest = campaign.config.tracks.model_copy(update={"method": "nearest"})
    plain = replace(ours, config=campaign.config.model_copy(update={"tracks": nearest}))
    own, others = (_metrics(run, truths, channel, results) for run in (ours, plain))
    key, reason = f"motion.tracks.{name}", "Kalman filter with nearest neighbours on the same echoes"
    gospa = [own[f"tracks.{one}.mean_m"] / others[f"tracks.{one}.mean_m"] for one in ("gospa", "gospa_all")]
    speed, switches = own["tracks.velocity.over_bound"], own["tracks.most_switches"]
    return [
        at_most(f"{key}.gospa_over_baseline", gospa[0], 0.5, f"{reason}, movers in view"),
        at_most(f"{key}.gospa_all_over_baseline", gospa[1], 0.5, f"{reason}, also movers that no stop sees"),
        at_most(f"{key}.velocity_over_bound", speed, 1.5, "the echoes and the motion model allow 1"),
        at_most(f"{key}.switches_per_mover", switches, 1.0, "of the worst mover"),
    ]


def _metrics(
    run: CampaignRun, truths: Sequence[Truth], channel: Sequence[ChannelEstimate], results: CampaignResults
) -> dict[str, float]:
    """The scores of a run with the tracks of its settings."""
    tracks = campaign_tracks(run.config, run.scene, run.tx, channel, results.slam.poses)
    scores = run.score(truths, replace(results, slam=replace(results.slam, tracks=tracks)))
    return {metric.key: metric.value for metric in scores.metrics}
