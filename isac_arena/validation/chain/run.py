"""The chain by the sweep engine: the scores of every campaign, or why it failed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from isac_arena.scoring.record import ScoreTables
from isac_arena.sweep.run import read_times
from isac_arena.validation.case_runs import case_tables, run_cases
from isac_arena.validation.chain.campaigns import ChainCampaign, ChainGroup, cases_of
from isac_arena.validation.measurement import Measurement, at_most
from scenes.record import FloatArray
from scenes.scene import Scene


@dataclass(frozen=True)
class ChainResult:
    """A campaign with its scene and its scores."""

    name: str
    group: ChainGroup
    scene: Scene
    tables: ScoreTables
    estimate_s: FloatArray  # (stop,) processor time of the channel estimates; empty where it is not known


@dataclass(frozen=True)
class ChainFailure:
    """A campaign that ended with an error, in one line."""

    name: str
    group: ChainGroup
    reason: str


def failure_row(key: str, failures: Sequence[ChainFailure]) -> Measurement:
    """How many campaigns failed, and why."""
    reason = "; ".join(f"{one.name}: {one.reason}" for one in failures) or "every campaign has scores"
    return at_most(f"{key}.runs_with_errors", len(failures), 0, reason)


def run_chain(
    console: Console, campaigns: Sequence[ChainCampaign], out: Path, n_workers: int | None = None
) -> tuple[list[ChainResult], list[ChainFailure]]:
    """Run what is missing in the directory `out`; the campaigns that ended well, and those that failed.

    Channel estimates are kept, so an interrupted campaign goes on at the stop it had reached, and changed mapping,
    SLAM or scoring needs no new ones.
    """
    results, failures = [], []
    jobs = run_cases(console, cases_of(campaigns), out, n_workers)
    for campaign, job in zip(campaigns, jobs, strict=True):
        if isinstance(job, str):
            failures.append(ChainFailure(campaign.name, campaign.group, job))
            continue
        tables = case_tables(job)
        times = np.array(list(read_times(job).values()), float)
        results.append(ChainResult(campaign.name, campaign.group, job.scene, tables, times))
    return results, failures
