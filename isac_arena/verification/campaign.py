"""A share of the stops of a campaign directory computed again, and its maps and scores."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from estimation.channel.beam_power_map import beam_power_map
from isac_arena.campaign import stages
from isac_arena.campaign.campaign import link_stores
from isac_arena.campaign.chain.halls import found_hall, keeps_hall
from isac_arena.campaign.chain.inputs import known_receiver
from isac_arena.campaign.directory import CampaignStore, open_campaign
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.results import MapName, MemoryResults, StopEstimate
from isac_arena.campaign.shards import Stored, places
from isac_arena.campaign.stored import channel_estimates, known_stops, stored_results
from isac_arena.scoring.metrics.metric import to_json
from isac_arena.user_functions.errors import EstimatorError
from isac_arena.verification.compare import Finding, compare_metrics, compare_records
from scenes.record import parts_of
from scenes.scene import Scene
from sim.truth import Truth


class StoredCampaign(CampaignStore):
    """A campaign directory whose files count as current whatever version of the code made them."""

    def current(self, name: str, fingerprint: str) -> Stored | None:
        """The file of that name, of any version."""
        del fingerprint
        return next((stored for stored in places(self.directory / name) if stored.is_file()), None)


class RecomputedResults(MemoryResults):
    """Results computed again. They are compared stop by stop, so no truth is kept."""

    def write_truth(self, truth: Truth) -> None:
        """Keep nothing."""


def recomputed_campaign(directory: Path, share: float, seed: int) -> list[Finding]:
    """Findings of a share of the stops, of halls, both maps and the scores; none for a share of 0.

    Every stage starts from what the stage before it stored. A measured campaign has no stops to simulate.

    Raises `ValueError`, one line, where files are missing.
    """
    if share == 0:
        return []
    held = open_campaign(directory)
    store = StoredCampaign(**{field.name: getattr(held, field.name) for field in fields(held)})
    scene = store.scene
    stops = draw_share(len(scene.stops), share, seed) if store.measured is None else []
    return [
        *_guarded("stops", _stops(store, scene, stops)),
        *_guarded("hall", _halls(store, scene)),
        *_guarded("map", _maps(store, scene)),
        *_guarded("scores.json", _scores(store, scene)),
    ]


def draw_share(count: int, share: float, seed: int) -> list[int]:
    """A share of `count` indices, at least one, in order."""
    n = min(count, int(np.ceil(share * count)))
    return sorted(np.random.default_rng(seed).choice(count, n, replace=False).tolist())


def _guarded(name: str, findings: Iterator[Finding]) -> Iterator[Finding]:
    """The findings; an error in reading or computing becomes a finding."""
    try:
        yield from findings
    except (ValueError, FileNotFoundError) as error:
        yield Finding(name, 0.0, reason=" ".join(str(error).split()))


def _stops(store: CampaignStore, scene: Scene, stops: Sequence[int]) -> Iterator[Finding]:
    results = RecomputedResults(calibrated=store.calibration())
    run = CampaignRun(store.config, scene, results, stops, on_failure=_go_on)
    stores = link_stores(store)
    for traced in run.truths():
        stop, (own, _) = traced.stop, stores[traced.tx if len(stores) > 1 else 0]
        truth = own.truth(stop)
        if truth is None:
            raise ValueError(f"{store.directory}: the truth of stop {stop} is missing")
        yield compare_records(own.stop_file("truth", stop), truth, traced)
        sweep = run.sweep(truth)
        stored_sweep, stored = own.sweep(stop), own.channel(stop)
        if stored_sweep is not None:
            yield compare_records(own.stop_file("sweep", stop), stored_sweep, sweep)
        if stored is not None:
            again = StopEstimate(run.estimate(truth, sweep), beam_power_map(sweep))
            yield compare_records(own.stop_file("channel", stop), stored, again)


def _halls(store: CampaignStore, scene: Scene) -> Iterator[Finding]:
    if store.measured is not None or not keeps_hall(store.config):
        return
    run = CampaignRun(store.config, scene)
    for (own, stops), link in zip(link_stores(store), run.links, strict=True):
        stored, estimates = own.hall(), [own.estimate(stop) for stop in stops]
        if stored is not None:
            again = found_hall(link, [one.reported for one in estimates if one is not None])
            yield compare_records(f"channel/hall{own.tx}.nc", stored.paths, again.paths)


def _maps(store: CampaignStore, scene: Scene) -> Iterator[Finding]:
    n_stops = len(scene.stops)
    names: tuple[MapName, ...] = ("mapping", "slam")
    stored = {name: store.map_result(name) for name in names}
    if not any(stored.values()):
        return
    channel = [estimate.channel for estimate in channel_estimates(store, n_stops)]
    known = known_receiver(known_stops(store, channel))
    again = CampaignRun(store.config, scene, on_failure=_go_on).maps(channel, known)
    for name, result in stored.items():
        if result is not None:
            for part in parts_of(result):
                pair = (getattr(each, part) for each in (result, again[name]))
                yield compare_records(f"map/{name}.nc, {part}", *pair)


def _go_on(error: EstimatorError) -> None:
    """A function that failed fails again: the results without it are compared."""


def _scores(store: CampaignStore, scene: Scene) -> Iterator[Finding]:
    file = store.directory / "scores.json"
    if file.is_file():
        scores = stages.scores_of(store, scene, stored_results(store, len(scene.stops)))
        try:
            stored = json.loads(file.read_text(encoding="utf-8"))
            yield compare_metrics("scores.json", stored, to_json(scores.metrics))
        except (KeyError, TypeError) as error:
            raise ValueError(f"{file}: damaged ({error!r})") from error
