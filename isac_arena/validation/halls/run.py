"""Random halls by the sweep engine, no further than the channel estimates."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from isac_arena.campaign.load import SceneSource
from isac_arena.scoring.record import ScoreTables
from isac_arena.sweep.cases import Case
from isac_arena.sweep.job import Job
from isac_arena.sweep.run import read_times
from isac_arena.user_functions.config import with_functions
from isac_arena.validation.case_runs import case_tables, run_cases
from isac_arena.validation.scenarios.random_halls import RandomHall
from scenes.record import FloatArray


@dataclass(frozen=True)
class HallResult:
    """A room and the scores of its channel estimates."""

    hall: RandomHall
    tables: ScoreTables
    estimate_s: FloatArray  # (stop,) processor time; empty where it is not known


def run_halls(
    console: Console,
    halls: Sequence[RandomHall],
    out: Path,
    method: str,
    estimator: str | None,
    n_workers: int | None = None,
) -> list[HallResult]:
    """Estimate and score the rooms that are not yet in the directory `out`, and return all.

    Raises `ValueError` for an unknown method, or with the reason where a room failed.
    """
    jobs = run_cases(console, [_case(hall, method, estimator) for hall in halls], out, n_workers)
    results = []
    for hall, job in zip(halls, jobs, strict=True):
        if isinstance(job, str):
            raise ValueError(f"room {hall.room}: {job}")
        results.append(_result(hall, job))
    return results


def _case(hall: RandomHall, method: str, estimator: str | None) -> Case:
    channel = type(hall.config.channel).model_validate({**hall.config.channel.model_dump(), "method": method})
    config = with_functions(hall.config.model_copy(update={"channel": channel}), {"channel": estimator})
    scene = SceneSource(hall.scene_text, {})
    return Case(hall.room, 0, (), config, scene, stop_every=1, stages="channel")


def _result(hall: RandomHall, job: Job) -> HallResult:
    tables = case_tables(job)
    return HallResult(hall, tables, np.array(list(read_times(job).values()), float))
