"""Campaigns of a validation by the sweep engine: resumable, on all cores, the same bits for any number of them."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from isac_arena.campaign.files import read_record
from isac_arena.campaign.lock import one_run
from isac_arena.campaign.recording import recorded_run
from isac_arena.scoring.record import ScoreTables
from isac_arena.sweep.cases import Case
from isac_arena.sweep.job import Job, make_job, store_scene
from isac_arena.sweep.run import check_case, reason
from isac_arena.sweep.runner import run_missing
from isac_arena.sweep.store import forget_failures, read_failures, stale_names
from isac_arena.workers.workers import Workers


def run_cases(console: Console, cases: Sequence[Case], out: Path, n_workers: int | None = None) -> list[Job | str]:
    """Run the cases that are not yet in the directory `out`: the job of every case, or why it failed in one line.

    Traced paths are shared by all cases of a scene; a case that failed before is tried again. By default there is
    one worker per core.
    """
    with one_run(out), recorded_run(out) as recording:
        forget_failures(out, read_failures(out))
        jobs = [_job(case, out) for case in cases]
        recording.drop(stale_names(out, recording.names))
        with Workers(n_workers, None) as workers:
            run_missing(workers, console, out, [job for job in jobs if isinstance(job, Job)])
    failures = read_failures(out)
    return [
        job if isinstance(job, str) or job.is_done else failures.get(job.key, "did not finish") for job in jobs
    ]


def case_tables(job: Job) -> ScoreTables:
    """The tables of scores of a case that is done."""
    return read_record(job.directory / "provenance.nc", ScoreTables)


def _job(case: Case, out: Path) -> Job | str:
    """The job of a case, its scene stored; why there is none where its settings or its scene are refused."""
    try:
        n_stops = len(check_case(case).stops)
    except ValueError as error:
        return reason(error)
    store_scene(out, case.scene)
    return make_job(case, out, n_stops)
