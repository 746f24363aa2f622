"""The stages of a campaign on a directory: files, progress and messages around the driver."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from isac_arena.campaign.campaign import Campaign, campaign_store, load_campaign
from isac_arena.campaign.chain.halls import make_halls
from isac_arena.campaign.directory import CampaignStore, check_is_campaign, open_campaign
from isac_arena.campaign.lock import one_run
from isac_arena.campaign.manifest import MANIFEST, SETTINGS, check_unchanged
from isac_arena.campaign.plan import RunPlan, check_elevations, plan_run
from isac_arena.campaign.recording import recorded_run
from isac_arena.campaign.results import MAP_STEPS, CampaignResults
from isac_arena.campaign.shards import STOPS_A_SHARD
from isac_arena.campaign.side import swapped_in
from isac_arena.campaign.stored import (
    channel_estimates,
    measured_truths,
    pack_stops,
    present,
    stored_results,
    stored_truths,
)
from isac_arena.campaign.summary import TraceCounts, run_facts, score_table
from isac_arena.progress import counted, heard_steps, progress_bar, working
from isac_arena.report.page.budget_file import BUDGET_FILE, read_budget
from isac_arena.scoring.doubts import run_doubts
from isac_arena.scoring.record import ScoreTables
from isac_arena.scoring.score import Scores
from isac_arena.user_functions.config import with_functions
from isac_arena.user_functions.errors import EstimatorError
from isac_arena.user_functions.room import check_functions
from isac_arena.workers.maps import make_maps
from isac_arena.workers.stops import StopMakers, StopRun, campaign_run, make_stops, stop_run
from isac_arena.workers.workers import n_cores
from scenes.scene import Scene
from sim.clock import checked_clock
from sim.links import link_nodes, uplink_names
from sim.signal.demand import ask_sample_memory
from sim.signal.link import make_link

console = Console(highlight=False)
Named = Mapping[str, str]  # functions of a user by the stage that they replace
HERE = StopMakers(workers=1)

# Files and folders of a campaign directory that a command reads beside the settings
SHOWN_FAILURES = 3  # of a user's function at stops; a mistake in it fails at most stops
ALL_FAILED = (
    "it failed at all of the first {} stops; the others may go better, so the run goes on. Ctrl-C ends it, and "
    "the same command continues"
)
SAMPLES = ("truth", "sweep")
ESTIMATES = ("truth", "channel", "map")
SCORED = (*ESTIMATES, "provenance.nc")


def prepare(campaign: str | Campaign, out: Path, seed: int | None, named: Named | None = None) -> CampaignStore:
    """Open a campaign directory for a campaign file. All inputs are checked before anything is written.

    `named` are functions of a user by the stage that they replace.
    """
    store = _checked(campaign, out, seed, named, None)
    store.open_for_writing()
    return store


@contextmanager
def opened(
    campaign: str | Campaign, out: Path, seed: int | None, named: Named | None = None, limit_s: float | None = None
) -> Iterator[CampaignStore]:
    """As `prepare`, for a whole run: the directory is locked for it, and its manifest is written at the end."""
    store = _checked(campaign, out, seed, named, limit_s)
    with one_run(out), recorded_run(out):
        check_unchanged(out, (*SETTINGS, *SAMPLES, *ESTIMATES))
        with swapped_in(store) as beside:
            beside.open_for_writing()
            yield beside


def _checked(
    campaign: str | Campaign, out: Path, seed: int | None, named: Named | None, limit_s: float | None
) -> CampaignStore:
    loaded = campaign if isinstance(campaign, Campaign) else load_campaign(campaign, seed=seed)
    loaded = replace(loaded, config=with_functions(loaded.config, named or {}, limit_s))
    check_functions(loaded.config.functions)
    check_elevations(loaded.config)
    if loaded.scene.is_moving:
        checked_clock(loaded.config, loaded.scene)
    ask_sample_memory(loaded.config)
    return campaign_store(loaded, out)


def run_campaign(
    campaign: str | Campaign, out: Path, *, seed: int | None = None, named: Named | None = None,
    keep_sweeps: bool = False, makers: StopMakers = HERE,
) -> list[EstimatorError]:  # fmt: skip
    """All stages from the scene to the report, into a directory; an interrupted run continues.

    Returns the failures of a user's functions that the run went on without.
    """
    with opened(campaign, out, seed, named, makers.limit_s) as store:
        _ = store.scene.standing_tx
        plan = run_plan(store)
        print_plan(plan)
        with makers:
            failures = sweep_and_estimate(store, makers, keep_sweeps=keep_sweeps)
            failures += build_maps(store, makers)
        write_scores(store, plan.doubts)
        write_report(store, plan)
    return failures


def run_plan(store: CampaignStore) -> RunPlan:
    """What a run does and what is doubtful about it."""
    with working(console, "looking for what is doubtful"):
        scene = store.scene
        return plan_run(store.config, scene, make_link(store.config))


def print_plan(plan: RunPlan) -> None:
    """Print the plan of a run, a line for everything doubtful."""
    console.print(f"plan: {plan.does}", markup=False, soft_wrap=True)
    print_scene_notices(plan.notices, plan.doubts)


def print_scene_notices(notices: Sequence[str], doubts: Sequence[str]) -> None:
    """Print a line for every notice of a scene and for everything doubtful."""
    for notice in notices:
        console.print(f"note: {notice}", markup=False, soft_wrap=True)
    print_doubts(doubts)


def print_doubts(doubts: Sequence[str]) -> None:
    """Print a line for everything doubtful."""
    for doubt in doubts:
        console.print(f"doubtful: {doubt}", markup=False, soft_wrap=True)


@contextmanager
def reopened(
    directory: Path, named: Named | None = None, reads: Sequence[str] = ESTIMATES, limit_s: float | None = None
) -> Iterator[CampaignStore]:
    """As `reopen`, for a run: the directory is locked for it, and its manifest is written at the end.

    With `named` functions, what they and the stages after them make is made again. Raises `ValueError`
    where a report has no manifest, which would say to which results it belongs.
    """
    check_is_campaign(directory)
    with one_run(directory), recorded_run(directory):
        store = reopen(directory, reads)
        if (directory / "report.html").is_file() and not (directory / MANIFEST).is_file():
            what = "missing, so it is not known which results report.html shows"
            raise ValueError(
                f"{directory / MANIFEST}: {what}; use the same 'arena run' again, or remove report.html"
            )
        if named:
            if not store.has_samples and "channel" in named:
                raise ValueError(f"--channel = '{named['channel']}': {directory} is measured and holds no samples")
            store = replace(store, config=with_functions(store.config, named, limit_s))
            check_functions(store.config.functions)
        with swapped_in(store) as beside:
            if named:
                beside.open_for_writing()
            yield beside


def reopen(directory: Path, reads: Sequence[str] = ESTIMATES) -> CampaignStore:
    """The campaign in a directory.

    Raises `ValueError`, one line, where its settings or the files in `reads` are not as they were written.
    """
    check_is_campaign(directory)
    check_unchanged(directory, (*SETTINGS, *reads))
    return open_campaign(directory)


def sweep_only(store: CampaignStore, makers: StopMakers = HERE, *, keep_sweeps: bool) -> None:
    """Make the truth of every stop, and keep its sweep where asked for."""
    _each_stop(stop_run(store, keeps_sweeps=keep_sweeps, estimates=False), makers, "trace, sweep")


def sweep_and_estimate(
    store: CampaignStore, makers: StopMakers = HERE, *, keep_sweeps: bool, again: bool = False
) -> list[EstimatorError]:
    """Make missing truths and channel estimates, with one stop in the memory of a process at a time.

    `again` makes all channel estimates, also stored ones. Measured paths are both. Returns
    the failures of a user's function, stop by stop; raises the first where it failed at every stop.
    """
    if not store.has_samples:
        return []
    work = stop_run(store, keeps_sweeps=keep_sweeps, estimates=True, again=again)
    if not all(map(work.is_done, (work.run.chosen_stops[0], work.run.chosen_stops[-1]))):
        _ensure_kernels()
    failures = _each_stop(work, makers, "trace, sweep, estimate", more="SLAM and contours")
    if failures and len(failures) == len(work.run.chosen_stops):
        raise failures[0]
    if store.measured is None:
        with working(console, "floor and ceiling: which paths are versions of others?"):
            make_halls(work.run, again=again)
    return failures


def _each_stop(stops: StopRun, makers: StopMakers, description: str, more: str = "") -> list[EstimatorError]:
    """Make what is missing at every stop, here or on workers; failures of a user's function. `more` follows."""
    counts = TraceCounts()
    failures: list[EstimatorError] = []
    if stops.run.calibrates:
        with working(console, "self-calibration: do both arrays differ from their design?"):
            stops.run.calibrate()
    with progress_bar(console) as progress, closing(make_stops(stops, makers, progress.console.print)) as made:
        n_stops = len(stops.run.chosen_stops)
        task = progress.add_task(description, total=n_stops, side_by_side=makers.workers or n_cores(), more=more)
        for number, one in enumerate(progress.track(made, n_stops, task_id=task), 1):
            if number % STOPS_A_SHARD == 0:
                pack_stops(stops.store)
            counts += one.counts
            if one.failure is not None:
                failures.append(one.failure)
                if len(failures) <= SHOWN_FAILURES:
                    _print_failure(one.failure, progress.console)
                if number == len(failures) == SHOWN_FAILURES < n_stops:
                    progress.console.print(ALL_FAILED.format(number), markup=False, soft_wrap=True)
    pack_stops(stops.store)
    unshown = max(len(failures) - SHOWN_FAILURES, 0)
    if unshown and len(failures) < len(stops.run.chosen_stops):  # else there is no report
        console.print(f"failed: {counted(unshown, 'more stop', 'more stops')}; the report has them all")
    for line in counts.lines:
        console.print(line)
    return failures


def _ensure_kernels() -> None:
    from isac_arena.kernels import ensure_kernels  # noqa: PLC0415  (brings numba)

    ensure_kernels(console)


def _print_failure(error: EstimatorError, where: Console) -> None:
    where.print(f"failed: {error}", markup=False, soft_wrap=True)


def build_maps(store: CampaignStore, makers: StopMakers = HERE) -> list[EstimatorError]:
    """Map with the known receiver, run SLAM without it, and fit shapes to both maps.

    Mapping takes a worker where `makers` have some, beside SLAM here. Returns the failures of a user's functions;
    the same command tries these again.
    """
    kept = [store.map_result(name) for name in ("mapping", "slam")]
    if all(one is not None and not one.problem for one in kept):
        return []
    _ensure_kernels()
    failures: list[EstimatorError] = []
    run = campaign_run(store, failures.append)
    n_stops = len(run.chosen_stops)
    channel = [estimate.channel for estimate in channel_estimates(store, n_stops)]
    with progress_bar(console) as progress:
        steps = list(MAP_STEPS)
        task = progress.add_task(steps[0], total=sum(MAP_STEPS.values()), told_from=0.5, is_share=True)

        def begin(step: str) -> None:
            before = steps[: steps.index(step)]
            progress.update(task, completed=sum(MAP_STEPS[name] for name in before), description=step)

        def tell(detail: str) -> None:
            step = progress.tasks[task].description.partition(", ")[0]
            progress.update(task, description=f"{step}, {detail}")

        run = replace(run, on_step=begin)
        with heard_steps(tell):
            failures[:0] = make_maps(store, run, makers, channel)
        progress.update(task, completed=progress.tasks[task].total)
    for failure in failures:
        _print_failure(failure, console)
    return failures


def write_scores(store: CampaignStore, said: Sequence[str] = ()) -> None:
    """Score every stage against the truth; write metrics and origins. Doubts `said` before are not printed."""
    scene = store.scene
    results = stored_results(store, len(scene.stops))
    with working(console, "scores"):
        scores = scores_of(store, scene, results)
    store.write_scores(scores)
    console.print(score_table(scores))
    for line in scores.legend:
        console.print(line, markup=False, soft_wrap=True)
    print_doubts([one for one in run_doubts(scores.metrics, results.slam.poses) if one not in said])


def write_report(store: CampaignStore, plan: RunPlan | None = None) -> None:
    """Draw the figures and write the self-contained HTML report, with the doubts of the plan where it is known."""
    from isac_arena.report.figures.by_tx import tx_shares  # noqa: PLC0415  (brings matplotlib)
    from isac_arena.report.page.figures import make_figures  # noqa: PLC0415
    from isac_arena.report.page.html import render_report  # noqa: PLC0415
    from isac_arena.scoring.chain import score_metrics  # noqa: PLC0415
    from isac_arena.scoring.measured import measured_metrics  # noqa: PLC0415

    scene = store.scene
    results = stored_results(store, len(scene.stops))
    tables = present(store, store.score_tables(), "the score (provenance.nc)", "score")
    with working(console, "report"):
        metrics = score_metrics if store.measured is None else measured_metrics
        scores = Scores(metrics(scene, tables), tables)
        txs = link_nodes(store.config, scene)
        figures = make_figures(scene, results, scores, txs=txs)
        facts = run_facts(store.config, scene, store.measured, results.failures)
        if len(txs) > 1:
            facts |= {f"TX {one.name}": one.text for one in tx_shares(list(txs), results.mapping, tables)}
        plan = plan or (run_plan(store) if store.measured is None else None)
        found = run_doubts(scores.metrics, results.slam.poses)
        if doubts := dict.fromkeys((*found, *(plan.doubts if plan else ()))):
            facts = {"Doubtful": "\n".join(f"• {doubt}" for doubt in doubts)} | facts
        page = render_report(_page_payload(store, scene, results, tables), scores, figures, facts)
        store.write_report(page, {name: figure.png for name, figure in figures.items()})
    console.print(f"report: {store.directory / 'report.html'}")


def _page_payload(
    store: CampaignStore, scene: Scene, results: CampaignResults, tables: ScoreTables
) -> dict[str, Any]:
    """The data of the report page; a measured campaign has no true paths."""
    from isac_arena.report.page.payload.campaign import report_payload  # noqa: PLC0415  (brings matplotlib)
    from isac_arena.report.page.payload.thinning import drawn_stops  # noqa: PLC0415

    name, n_stops = store.config.name, len(scene.stops)
    drawn = drawn_stops(results) if store.measured is None else ()
    truths = stored_truths(store, n_stops, drawn)
    check_unchanged(store.directory / BUDGET_FILE.parent, [BUDGET_FILE.name])
    budget, txs = read_budget(store.directory, name), link_nodes(store.config, scene)
    return report_payload(name, scene, results, tables, truths, budget, txs, uplink_names(store.config, scene))


def scores_of(store: CampaignStore, scene: Scene, results: CampaignResults) -> Scores:
    """The scores of a campaign's estimates against its stored truth, or the measurement."""
    n_stops = len(scene.stops)
    if store.measured is not None:
        from isac_arena.scoring.measured import score_measured  # noqa: PLC0415  (slow to import)

        return score_measured(scene, measured_truths(store, n_stops), results)
    return campaign_run(store).score(stored_truths(store, n_stops), results)
