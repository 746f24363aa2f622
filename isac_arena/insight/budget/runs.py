"""The runs behind `arena budget`: one directory per variant, each made once, and the final errors of all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from estimation.channel.calibration.self_calibration import calibration_rows, self_calibrate
from estimation.channel.estimate import ChannelEstimator
from estimation.channel.power_map import beam_power_map
from estimation.channel.record import ChannelEstimate
from isac_arena.campaign.chain import channel_estimator, significance
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.directory import CampaignStore, StopEstimate
from isac_arena.campaign.files import read_attribute, read_record, write_record
from isac_arena.campaign.integrity import code_digest, digest
from isac_arena.campaign.load import campaign_scene, load_campaign
from isac_arena.campaign.lock import one_run
from isac_arena.campaign.recording import recorded_run
from isac_arena.insight.budget.chain import Chain, make_chain
from isac_arena.insight.budget.outcome import FinalErrors, LitObject, lit_objects
from isac_arena.insight.budget.physics import observed, present, without_hardware, without_paths
from isac_arena.insight.budget.record import OUTCOMES, Budget, Variants, take_apart
from isac_arena.insight.budget.stages import STAGE_GROUPS, Groups, Part, coalitions, label
from isac_arena.scoring.stages.channel import TrueStop, true_stop
from scenes.config import referenced_contents
from scenes.scene import Scene
from sim.signal.link import Link, best_beam_power_dbm, make_link
from sim.simulate import clock_biases_s, simulate_truth
from sim.truth import Truth

NOTHING: frozenset[Part] = frozenset()


@dataclass(frozen=True)
class BudgetJob:
    """A budget to be run: `paths` is the campaign directory of the traced paths."""

    out: Path
    paths: CampaignStore
    scene: Scene
    stops: tuple[int, ...]
    repeats: int


@dataclass(frozen=True)
class Variant:
    """One repeat of the campaign with some physics off."""

    store: CampaignStore
    scene: Scene
    off: frozenset[Part]
    truths: tuple[Truth, ...]
    objects: tuple[LitObject, ...]
    groups: Groups  # of the physics

    @cached_property
    def link(self) -> Link:
        """The link of the variant."""
        return make_link(self.store.config)

    @cached_property
    def chain(self) -> Chain:
        """The estimation chain behind the channel estimates, which have to be there."""
        channel: list[ChannelEstimate] = []
        for truth in self.truths:
            estimate = self.store.channel(truth.stop)
            if estimate is None:
                raise ValueError(f"{self.store.directory}: the channel estimate of stop {truth.stop} is gone")
            channel.append(estimate.channel)
        stops = true_stops(self.store.config, self.scene, self.truths)
        return make_chain(self.store.config, self.scene, stops, channel, list(self.objects))

    def final_errors(self, replaced: frozenset[Part]) -> FinalErrors:
        """Final errors with truth in the place of some stages: as stored, or made and stored."""
        path = self.store.directory / "errors" / f"{label(replaced, STAGE_GROUPS)}.nc"
        fingerprint = digest(
            self.store.map_fingerprint,
            code_digest("isac_arena/insight/budget", "isac_arena/scoring"),
            label(self.off, self.groups),
            repr([truth.stop for truth in self.truths]),
        )
        if path.is_file() and read_attribute(path, "fingerprint") == fingerprint:
            return read_record(path, FinalErrors)
        errors = self.chain.final_errors(replaced)
        write_record(path, errors, {"title": self.store.config.name, "fingerprint": fingerprint})
        return errors


@contextmanager
def budget_job(
    campaign: str, out: Path, seed: int | None, repeats: int, stops: str | None, estimator: str | None
) -> Iterator[BudgetJob]:
    """A budget with everything checked before anything is written, its directory held for one run."""
    config, scene_file = load_campaign(campaign, seed)
    channel_estimator(config, estimator)
    scene = campaign_scene(config, scene_file)
    chosen = chosen_stops(stops, len(scene.stops))
    text = scene_file.read_text(encoding="utf-8")
    paths = CampaignStore(out / "paths", config, text, estimator, scene_files=referenced_contents(scene_file))
    with one_run(out), recorded_run(out):
        paths.open_for_writing()
        yield BudgetJob(out, paths, scene, chosen, repeats)


def chosen_stops(text: str | None, n_stops: int) -> tuple[int, ...]:
    """Stops from text: '0,4,9' or 'first:last:step' with the last left out, as in Python; all without text.

    Raises `ValueError` where it is neither, or names a stop that there is not.
    """
    if text is None:
        return tuple(range(n_stops))
    try:
        if ":" in text:
            chosen = list(range(n_stops)[slice(*(int(part) if part else None for part in text.split(":")))])
        else:
            chosen = sorted({int(part) for part in text.split(",")})
    except (ValueError, TypeError):
        raise ValueError(f"--stops = '{text}': write it as 0,4,9 or first:last:step") from None
    if not chosen or chosen[0] < 0 or chosen[-1] >= n_stops:
        raise ValueError(f"--stops = '{text}': must name some of the stops 0 to {n_stops - 1}")
    return tuple(chosen)


def run_budget(job: BudgetJob, console: Console) -> Budget:
    """Run all variants that are missing, and take the errors apart."""
    with _progress(console) as progress:
        traced = tuple(progress.track(_traced(job), len(job.stops), description="trace"))
        physics: Groups = (present(job.paths.config, traced),)
        rest = [off for off in coalitions(physics) if off]
        objects = tuple(_objects(job, traced))
        by_stage: dict[frozenset[Part], list[FinalErrors]] = {key: [] for key in coalitions(STAGE_GROUPS)}
        by_physics: dict[frozenset[Part], list[FinalErrors]] = {key: [] for key in coalitions(physics)}
        task = progress.add_task("estimate", total=job.repeats * (1 + len(rest)) * len(job.stops))
        last = progress.add_task("map", total=job.repeats * (len(by_stage) + len(rest)))
        for repeat in range(job.repeats):
            for off in (NOTHING, *rest):
                variant = _variant(job, repeat, off, traced, objects, physics)
                for _ in _estimated(variant):
                    progress.advance(task)
                for replaced in by_stage if not off else (NOTHING,):
                    errors = variant.final_errors(replaced)
                    progress.advance(last)
                    if not off:
                        by_stage[replaced].append(errors)
                    if not replaced:
                        by_physics[off].append(errors)
    return _budget(job, objects, {"stages": (by_stage, STAGE_GROUPS), "physics": (by_physics, physics)})


def true_stops(config: CampaignConfig, scene: Scene, truths: tuple[Truth, ...]) -> list[TrueStop]:
    """The stops prepared for scoring."""
    link = make_link(config)
    limits = significance(config, link)
    return [
        true_stop(
            truth, scene.tx, best_beam_power_dbm(truth.paths, link, scene.tx, truth.rx_pose), limits, None
        )
        for truth in truths
    ]


def _traced(job: BudgetJob) -> Iterator[Truth]:
    """The truth of the chosen stops, as stored or traced now."""
    fresh = simulate_truth(
        job.paths.config, job.scene, (stop for stop in job.stops if not job.paths.has_truth(stop))
    )
    for stop in job.stops:
        truth = job.paths.truth(stop)
        if truth is None:
            truth = next(fresh)
            job.paths.write_truth(truth)
        yield truth


def _objects(job: BudgetJob, traced: tuple[Truth, ...]) -> list[LitObject]:
    stops = true_stops(job.paths.config, job.scene, traced)
    return lit_objects(job.scene, stops, job.paths.config.shapes.min_samples)


def _variant(
    job: BudgetJob,
    repeat: int,
    off: frozenset[Part],
    traced: tuple[Truth, ...],
    objects: tuple[LitObject, ...],
    groups: Groups,
) -> Variant:
    base = job.paths.config
    config = without_hardware(base.model_copy(update={"seed": base.seed + repeat}), off)
    name = label(off, groups)
    directory = job.out / f"repeat_{repeat:02d}" / ("all" if not off else f"without_{name}")
    store = replace(job.paths, directory=directory, config=config)
    store.open_for_writing()
    biases_s = clock_biases_s(config, len(job.scene.stops))
    truths = (replace(truth, clock_bias_s=float(biases_s[truth.stop])) for truth in traced)
    return Variant(
        store, job.scene, off, tuple(without_paths(truth, off) for truth in truths), objects, groups
    )


def _estimated(variant: Variant) -> Iterator[int]:
    """Make the channel estimates that are missing, stop by stop."""
    store, config = variant.store, variant.store.config
    estimator = None
    for truth in variant.truths:
        if not store.has_channel(truth.stop):
            estimator = estimator or _estimator(variant)
            sweep = observed(config, variant.link, variant.scene, truth, variant.off)
            store.write_channel(StopEstimate(estimator(sweep), beam_power_map(sweep)))
        yield truth.stop


def _estimator(variant: Variant) -> ChannelEstimator:
    """The channel estimator of a variant, calibrated on its own sweeps where the settings ask for it."""
    store, settings = variant.store, variant.store.config.channel.self_calibration
    if settings is None or store.estimator is not None:
        return channel_estimator(store.config, store.estimator)
    calibration = store.calibration()
    if calibration is None:
        chosen = [variant.truths[row] for row in calibration_rows(len(variant.truths), settings)]
        sweeps = (observed(store.config, variant.link, variant.scene, truth, variant.off) for truth in chosen)
        calibration = self_calibrate(sweeps, settings)
        store.write_calibration(calibration)
    return channel_estimator(store.config, None, calibration)


def _budget(
    job: BudgetJob, objects: tuple[LitObject, ...], kinds: dict[str, tuple[Variants, Groups]]
) -> Budget:
    found = {}
    for kind, (variants, groups) in kinds.items():
        rng = np.random.default_rng(job.paths.config.seed)
        for outcome, attribution in take_apart(variants, groups, rng).items():
            found[outcome, kind] = attribution
    ordered = {
        (name, kind): found[name, kind] for name in OUTCOMES for kind in kinds if (name, kind) in found
    }
    names = tuple(item.name for item in objects)
    return Budget(job.paths.config.name, job.stops, names, job.repeats, ordered)


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
