"""The campaign verbs: `run`, its stages alone: `generate`, `estimate`, `score`, `report`; and `arena campaign`."""

from typing import TYPE_CHECKING

import typer

from isac_arena.cli.options import (
    Campaign,
    Channel,
    Directory,
    KeepSweeps,
    Mapping,
    Out,
    Seed,
    Shapes,
    Slam,
    StopLimit,
    Tracker,
    WorkerCount,
    functions,
    with_clock,
)

if TYPE_CHECKING:
    from isac_arena.user_functions.errors import EstimatorError

app = typer.Typer(help="The campaigns of the library and your own.", no_args_is_help=True)


@app.command("list")
def list_campaigns() -> None:
    """List the campaigns of the library, each with what it is."""
    from isac_arena.campaign.load import campaign_path, library_campaigns  # noqa: PLC0415

    for name in library_campaigns():
        head = campaign_path(name).read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
        typer.echo(f"{name:22} {head}")


@app.command("show")
@with_clock
def show(campaign: Campaign, seed: Seed = None) -> None:
    """Print the file of a campaign, what it makes, and what is doubtful about it."""
    from isac_arena.campaign import stages  # noqa: PLC0415
    from isac_arena.campaign.campaign import load_campaign  # noqa: PLC0415
    from isac_arena.campaign.load import campaign_path  # noqa: PLC0415
    from isac_arena.campaign.plan import check_elevations, plan_run  # noqa: PLC0415
    from isac_arena.campaign.summary import run_facts  # noqa: PLC0415
    from scenes.toml_config import read_text  # noqa: PLC0415

    loaded = load_campaign(campaign, seed=seed)
    check_elevations(loaded.config)
    typer.echo(read_text(campaign_path(campaign)))
    for name, fact in run_facts(loaded.config, loaded.scene).items():
        typer.echo(f"{name}: {fact}")
    stages.print_plan(plan_run(loaded.config, loaded.scene, loaded.link))


def run(
    campaign: Campaign, out: Out, seed: Seed = None, channel: Channel = None, mapping: Mapping = None,
    slam: Slam = None, shapes: Shapes = None, tracker: Tracker = None, keep_sweeps: KeepSweeps = False,
    workers: WorkerCount = None, stop_limit: StopLimit = None,
) -> None:  # fmt: skip
    """Run a campaign from the scene to the report. The same command resumes an interrupted run.

    Where a function of yours fails, the run goes on without it, and exits with 1; its traceback is in
    estimator_error.txt in the directory of the run. Where a channel estimator fails at every stop, the exit
    code is 2, a finished run stays as it was, and the traceback is beside its directory.
    """
    from isac_arena.campaign import stages  # noqa: PLC0415
    from isac_arena.user_functions.errors import traces_in  # noqa: PLC0415
    from isac_arena.workers.stops import StopMakers  # noqa: PLC0415

    makers = StopMakers(workers, stop_limit)
    named = functions(channel=channel, mapping=mapping, slam=slam, shapes=shapes, tracker=tracker)
    with traces_in(out):
        raise_summed(
            stages.run_campaign(campaign, out, seed=seed, named=named, keep_sweeps=keep_sweeps, makers=makers)
        )


def generate(
    campaign: Campaign, out: Out, seed: Seed = None, keep_sweeps: KeepSweeps = True, workers: WorkerCount = None,
    stop_limit: StopLimit = None,
) -> None:  # fmt: skip
    """Trace the scene and make the sweeps of a campaign, with the truth behind them."""
    from isac_arena.campaign import stages  # noqa: PLC0415
    from isac_arena.workers.stops import StopMakers  # noqa: PLC0415

    with stages.opened(campaign, out, seed) as store, StopMakers(workers, stop_limit) as makers:
        stages.sweep_only(store, makers, keep_sweeps=keep_sweeps)


def estimate(
    directory: Directory, channel: Channel = None, mapping: Mapping = None, slam: Slam = None,
    shapes: Shapes = None, tracker: Tracker = None, workers: WorkerCount = None, stop_limit: StopLimit = None,
) -> None:  # fmt: skip
    """Estimate channel parameters, maps, poses and shapes from the sweeps of a campaign directory.

    Where a function of yours fails, the others go on without it; exit codes and traceback as of `arena run`.
    """
    from isac_arena.campaign import stages  # noqa: PLC0415
    from isac_arena.user_functions.errors import traces_in  # noqa: PLC0415
    from isac_arena.workers.stops import StopMakers  # noqa: PLC0415

    named = functions(channel=channel, mapping=mapping, slam=slam, shapes=shapes, tracker=tracker)
    with traces_in(directory):
        reads = (*stages.SAMPLES, *stages.ESTIMATES)
        reopened = stages.reopened(directory, named, reads, stop_limit)
        with reopened as store, StopMakers(workers, stop_limit) as makers:
            failures = stages.sweep_and_estimate(store, makers, keep_sweeps=False, again=channel is not None)
            failures += stages.build_maps(store, makers)
        raise_summed(failures)


def score(directory: Directory) -> None:
    """Score the estimates in a campaign directory against the truth."""
    from isac_arena.campaign import stages  # noqa: PLC0415

    with stages.reopened(directory) as store:
        stages.write_scores(store)


def report(directory: Directory) -> None:
    """Write the figures and the HTML report of a scored campaign directory."""
    from isac_arena.campaign import stages  # noqa: PLC0415

    with stages.reopened(directory, reads=stages.SCORED) as store:
        stages.write_report(store)


def raise_summed(failures: "list[EstimatorError]") -> None:
    """End the command with the failures of a user's functions that it went on without, where there are any."""
    from isac_arena.user_functions.errors import summed  # noqa: PLC0415

    if failures:
        raise summed(failures)
