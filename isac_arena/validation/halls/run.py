"""Random halls by the sweep engine: resumable, on all cores, no further than the channel estimates."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from threadpoolctl import threadpool_limits

from isac_arena.campaign.files import read_record
from isac_arena.campaign.load import SceneSource
from isac_arena.campaign.lock import one_run
from isac_arena.campaign.recording import recorded_run
from isac_arena.scoring.record import ScoreTables
from isac_arena.sweep.cases import Case
from isac_arena.sweep.job import Job, make_job, store_scene
from isac_arena.sweep.run import check_case, read_times
from isac_arena.sweep.runner import Workers, run_missing
from isac_arena.sweep.store import forget_failures, read_failures, stale_names
from isac_arena.validation.scenarios.random_halls import RandomHall
from scenes.record import FloatArray


@dataclass(frozen=True)
class HallResult:
    """A room and the scores of its channel estimates."""

    hall: RandomHall
    tables: ScoreTables
    estimate_s: FloatArray  # (stop,) processor time; empty where it is not known


def run_halls(
    console: Console, halls: Sequence[RandomHall], out: Path, method: str, estimator: str | None
) -> list[HallResult]:
    """Estimate and score the rooms that are not yet in the directory `out`, and return all.

    Traced paths are shared by all methods; a room that failed before is tried again.

    Raises `ValueError` for an unknown method, or with the reason where a room failed.
    """
    with one_run(out), threadpool_limits(limits=1), recorded_run(out) as recording:
        forget_failures(out, read_failures(out))
        jobs = [_job(hall, out, method, estimator) for hall in halls]
        recording.drop(stale_names(out, recording.names))
        with Workers(None, None) as workers:
            run_missing(workers, console, out, jobs)
    failures = read_failures(out)
    for hall, job in zip(halls, jobs, strict=True):
        if not job.is_done:
            raise ValueError(f"room {hall.room}: {failures.get(job.key, 'did not finish')}")
    return [_result(hall, job) for hall, job in zip(halls, jobs, strict=True)]


def _job(hall: RandomHall, out: Path, method: str, estimator: str | None) -> Job:
    """The job of a room, its scene stored."""
    channel = type(hall.config.channel).model_validate({**hall.config.channel.model_dump(), "method": method})
    config = hall.config.model_copy(update={"channel": channel})
    scene = SceneSource(hall.scene_text, {})
    case = Case(hall.room, 0, (), config, scene, estimator, stop_every=1, stages="channel")
    n_stops = len(check_case(case).stops)
    store_scene(out, scene)
    return make_job(case, out, n_stops)


def _result(hall: RandomHall, job: Job) -> HallResult:
    tables = read_record(job.directory / "provenance.nc", ScoreTables)
    return HallResult(hall, tables, np.array(list(read_times(job).values()), float))
