"""The runs of `arena budget`: one directory per variant, each made once, and the final errors of all."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from rich.console import Console

from isac_arena.campaign.campaign import campaign_store, load_campaign
from isac_arena.campaign.chain.inputs import significance
from isac_arena.campaign.directory import CampaignStore
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.integrity import code_digest, digest
from isac_arena.campaign.lock import one_run
from isac_arena.campaign.manifest import check_unchanged
from isac_arena.campaign.recording import recorded_run
from isac_arena.campaign.side import side_folder
from isac_arena.insight.budget.chain import Chain, make_chain
from isac_arena.insight.budget.outcome import FinalErrors, LitObject, lit_objects
from isac_arena.insight.budget.physics import observe_without, present_physics, without_hardware, without_paths
from isac_arena.insight.budget.record import OUTCOMES, Budget, Variants, attributions
from isac_arena.insight.budget.stages import STAGE_GROUPS, Groups, Part, coalitions, label
from isac_arena.progress import progress_bar
from isac_arena.scoring.true_stop import TrueStop, true_stop
from isac_arena.user_functions.config import with_functions
from isac_arena.user_functions.room import check_functions
from scenes.scene import Scene
from sim.transmitters import refuse_several_tx
from sim.truth import Truth

NOTHING: frozenset[Part] = frozenset()


@dataclass(frozen=True)
class BudgetJob:
    """A budget to be run: `paths` is the campaign directory of the traced paths.

    Over a finished budget all files are written to the folder `side`, see `side_folder`.
    """

    out: Path
    side: Path | None
    paths: CampaignStore
    scene: Scene
    stops: tuple[int, ...]
    repeats: int


@dataclass(frozen=True)
class Variant:
    """One repeat of the campaign with some physics off, kept in a directory of its own."""

    store: CampaignStore
    run: CampaignRun
    off: frozenset[Part]
    objects: tuple[LitObject, ...]
    groups: Groups  # of the physics

    @cached_property
    def chain(self) -> Chain:
        """The estimation chain behind the channel estimates."""
        run = self.run
        channel = list(run.channel(run.truths()))
        return make_chain(run, true_stops(run), channel, list(self.objects))

    def final_errors(self, replaced: frozenset[Part]) -> FinalErrors:
        """Final errors with truth in place of some stages: read, or made and stored."""
        name = f"errors/{label(replaced, STAGE_GROUPS)}.nc"
        fingerprint = digest(
            self.store.map_fingerprint,
            code_digest("isac_arena/insight/budget", "isac_arena/scoring"),
            label(self.off, self.groups),
            repr(list(self.run.chosen_stops)),
        )
        stored = self.store.read(name, FinalErrors, fingerprint)
        if stored is not None:
            return stored
        errors = self.chain.final_errors(replaced)
        self.store.write(name, errors, fingerprint)
        return errors


@contextmanager
def budget_job(
    campaign: str, out: Path, seed: int | None, repeats: int, stops: str | None, named: Mapping[str, str]
) -> Iterator[BudgetJob]:
    """A budget; all inputs are checked before anything is written, and its directory is locked for one run.

    Raises `ValueError` where the directory holds a campaign.
    """
    loaded = load_campaign(campaign, seed=seed)
    loaded = replace(loaded, config=with_functions(loaded.config, named))
    check_functions(loaded.config.functions)
    refuse_several_tx(loaded.config, loaded.scene, "arena budget")
    chosen = chosen_stops(stops, len(loaded.stops))
    if (out / "campaign.json").exists():
        raise ValueError(f"--out = {out}: holds a campaign; choose a folder of its own, such as {out / 'budget'}")
    paths = campaign_store(loaded, out / "paths")
    with one_run(out), recorded_run(out):
        check_unchanged(out, ("paths", *(f"repeat_{repeat:02d}" for repeat in range(repeats))))
        with side_folder(out, paths.score_fingerprint) as side:
            paths = replace(paths, side=side and side / "paths")
            paths.open_for_writing()
            yield BudgetJob(out, side, paths, loaded.scene, chosen, repeats)


def chosen_stops(text: str | None, n_stops: int) -> tuple[int, ...]:
    """Stops from text: '0,4,9' or 'first:last:step' without the last, as in Python; all stops without text.

    Raises `ValueError` where it is neither, or names a stop that does not exist.
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
    """Run all missing variants, and attribute the errors."""
    with progress_bar(console, transient=True) as progress:
        run = CampaignRun(job.paths.config, job.scene, job.paths, job.stops)
        traced = tuple(progress.track(run.truths(), len(job.stops), description="trace"))
        physics: Groups = (present_physics(job.paths.config, traced),)
        rest = [off for off in coalitions(physics) if off]
        objects = tuple(lit_objects(job.scene, true_stops(run), run.config.shapes.min_samples))
        by_stage: dict[frozenset[Part], list[FinalErrors]] = {key: [] for key in coalitions(STAGE_GROUPS)}
        by_physics: dict[frozenset[Part], list[FinalErrors]] = {key: [] for key in coalitions(physics)}
        task = progress.add_task("estimate", total=job.repeats * (1 + len(rest)) * len(job.stops))
        last = progress.add_task("map", total=job.repeats * (len(by_stage) + len(rest)))
        for repeat in range(job.repeats):
            for off in (NOTHING, *rest):
                variant = _variant(job, repeat, off, traced, objects, physics)
                for _ in variant.run.channel(variant.run.truths()):
                    progress.advance(task)
                for replaced in by_stage if not off else (NOTHING,):
                    errors = variant.final_errors(replaced)
                    progress.advance(last)
                    if not off:
                        by_stage[replaced].append(errors)
                    if not replaced:
                        by_physics[off].append(errors)
    return _budget(job, objects, {"stages": (by_stage, STAGE_GROUPS), "physics": (by_physics, physics)})


def true_stops(run: CampaignRun) -> list[TrueStop]:
    """The stops of a run prepared for scoring."""
    limits = significance(run.config, run.link)
    return [true_stop(truth, run.scene.tx, run.true_power_dbm(truth), limits, None) for truth in run.truths()]


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
    name = Path(f"repeat_{repeat:02d}", f"without_{label(off, groups)}" if off else "all")
    store = replace(job.paths, directory=job.out / name, side=job.side and job.side / name, config=config)
    store.open_for_writing()
    paths, observer = [without_paths(truth, off) for truth in traced], partial(observe_without, off=off)
    run = CampaignRun(config, job.scene, store, None, paths, observer)
    return Variant(store, run, off, objects, groups)


def _budget(job: BudgetJob, objects: tuple[LitObject, ...], kinds: dict[str, tuple[Variants, Groups]]) -> Budget:
    seed = job.paths.config.seed
    found = {kind: attributions(*pair, np.random.default_rng(seed)) for kind, pair in kinds.items()}
    ordered = {(name, kind): found[kind][name] for name in OUTCOMES for kind in kinds if name in found[kind]}
    names = tuple(item.name for item in objects)
    return Budget(job.paths.config.name, job.stops, names, job.repeats, ordered)
