"""The campaign verbs: `run`, and its stages alone: `generate`, `estimate`, `score`, `report`."""

from isac_arena.cli.options import Campaign, Directory, Estimator, KeepSweeps, Out, Seed


def run(
    campaign: Campaign, out: Out, seed: Seed = None, estimator: Estimator = None, keep_sweeps: KeepSweeps = False
) -> None:
    """Run a campaign from the scene to the report. The same command resumes an interrupted run."""
    from isac_arena.campaign import stages  # noqa: PLC0415

    stages.run_campaign(campaign, out, seed=seed, estimator=estimator, keep_sweeps=keep_sweeps)


def generate(campaign: Campaign, out: Out, seed: Seed = None, keep_sweeps: KeepSweeps = True) -> None:
    """Trace the scene and make the sweeps of a campaign, with the truth behind them."""
    from isac_arena.campaign import stages  # noqa: PLC0415

    with stages.opened(campaign, out, seed, None) as store:
        stages.sweep_only(store, keep_sweeps=keep_sweeps)


def estimate(directory: Directory, estimator: Estimator = None) -> None:
    """Estimate channel parameters, maps, poses and shapes from the sweeps of a campaign directory."""
    from isac_arena.campaign import stages  # noqa: PLC0415

    with stages.reopened(directory, estimator, (*stages.SAMPLES, *stages.ESTIMATES)) as store:
        stages.sweep_and_estimate(store, keep_sweeps=False, again=estimator is not None)
        stages.build_maps(store)


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
