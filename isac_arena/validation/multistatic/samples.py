"""`arena validate multistatic`: the samples of one TX, of orthogonal TX, and of TX that collide."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from isac_arena.campaign.campaign import load_campaign
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.results import MemoryResults
from isac_arena.scoring.record import PathStatus
from isac_arena.validation.measurement import Measurement, at_least, at_most
from scenes.record import ComplexArray
from sim.truth import Truth

BOTH = ("south_west", "north_east")
SMALL: Mapping[str, Any] = {
    "tx_array": {"beams_per_panel": 16},
    "rx_array": {"beams_per_panel": 12},
    "propagation": {"diffuse_samples": 0, "max_bounces": 1},
    "channel": {"method": "coherent", "maximum_likelihood": {"max_paths": 30}},
}
SAME = {name: {"re_offset": 0, "turn": 0} for name in BOTH}


def check_samples(seed: int, quick: bool) -> list[Measurement]:
    """One TX in a list is that TX; orthogonal TX do not meet; TX that collide are heard in the same samples."""
    stops = range(0, 2 if quick else 10)
    single = _run(seed, stops, "south_west")
    listed, orthogonal, colliding = (
        _run(seed, stops, ["south_west"]),
        _run(seed, stops),
        _run(seed, stops, own=SAME),
    )
    listed_apart, apart, alike, own = 0, 0, 0.0, 0.0
    for stop in stops:
        one, other, both = _samples(single, stop), _samples(listed, stop), _samples(orthogonal, stop)
        listed_apart += int((one[0] != other[0]).sum())
        apart += int((one[0] != both[0]).sum())
        first, second = _samples(colliding, stop)
        alike = max(alike, float(np.abs(first - second).max() / np.abs(first).max()))
        own = max(own, float(np.abs(first - one[0]).max() / np.abs(one[0]).max()))
    key, bits = "multistatic.samples", "samples that differ from those of one TX"
    return [
        at_most(f"{key}.one_tx", listed_apart, 0, bits),
        at_most(f"{key}.orthogonal", apart, 0, f"{bits}: the other has another comb offset"),
        at_most(f"{key}.same_air", alike, 1e-5, "sweeps of two TX on the same resource elements"),
        at_least(f"{key}.other_tx", own, 1e-3, "what the other TX adds, over the strongest sample"),
    ]


def check_collision(seed: int, quick: bool) -> list[Measurement]:
    """Two TX on the same resources: detected and false paths with the other TX whitened, and ignored."""
    stops = range(0, 30, 15 if quick else 3)
    found = {}
    truths: Sequence[Truth] = ()
    for how in ("whiten", "ignore"):
        run = replace(_run(seed, stops, own=SAME, interference=how), paths=truths)
        truths = list(run.truths())
        scores = run.channel_scores()
        status = scores.tables.paths.status
        n_significant = len(scores.tables.significant.stop)
        found[how] = (status == PathStatus.DETECTED).sum() / n_significant, int((status == PathStatus.FALSE).sum())
    (detected, false), (detected_by, false_by) = found["whiten"], found["ignore"]
    n_links, key = 2 * len(stops), "multistatic.collision"
    return [
        at_least(f"{key}.detected_share", detected, detected_by, "whitened; the bar is without whitening"),
        at_most(f"{key}.false_per_sweep", false / n_links, false_by / n_links, "the same", "paths"),
    ]


def _run(
    seed: int,
    stops: Sequence[int],
    tx: str | list[str] | None = None,
    own: Mapping[str, Any] | None = None,
    interference: str = "whiten",
) -> CampaignRun:
    """A run of the pillar hall with small arrays, by default with both TX."""
    channel = {**SMALL["channel"], "interference": interference}
    changes = {
        **SMALL,
        "channel": channel,
        "tx": list(BOTH) if tx is None else tx,
        "transmitters": dict(own or {}),
    }
    campaign = load_campaign("pillar_hall_two", seed=seed, **changes)
    return replace(campaign.chain(stops), results=MemoryResults())


def _samples(run: CampaignRun, stop: int) -> list[ComplexArray]:
    """Samples of a stop for every TX."""
    return [link.sweep(link.truth(stop)).samples for link in run.links]
