"""Many cases on many processes, and their order."""

import shutil
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from isac_arena.sweep.job import Job
from isac_arena.sweep.run import make_signals, reason, run_cases, trace_stops
from isac_arena.workers.tasks import (
    STOP_LIMIT_S,
    Client,
    Future,
    WorkerDiedError,
    as_completed,
    outcome,
    run_within,
)

STOPS_PER_TASK = 8
CASES_PER_TASK = 8  # at most, of cases that share their samples: samples are read once for all
DIED = "its worker died each time: out of memory, ended or crashed by the estimator, or longer than --stop-limit"

Report = Callable[[Job, str | None], None]  # of a case that ended, and why where it failed
T = TypeVar("T")


def run_jobs(client: Client, jobs: Sequence[Job], report: Report, stop_limit_s: float = STOP_LIMIT_S) -> None:
    """Run all jobs, their shared paths and samples first; `report` is called for each job that ends.

    A worker that takes longer than `stop_limit_s` for each stop of its cases is ended, as one that hangs.

    Jobs that share their samples are neighbours, so samples are removed before many others are made. A failure is
    reported with its reason and stops no other job. A batch whose worker dies is divided. A job whose worker died
    may have waited there behind the one that killed it, so it is tried again alone, when nothing else runs.

    Raises `OSError` where the directory of the sweep cannot be written, or its disk is full; `ConnectionError`
    where the scheduler was lost.
    """
    waiting: dict[str, list[Job]] = {}
    for job in jobs:
        waiting.setdefault(job.signal_hash, []).append(job)
    futures = _submit(client, waiting, stop_limit_s)
    ended, suspects = as_completed(futures), []

    def end(job: Job, why: str | None) -> None:
        report(job, why)
        waiting[job.signal_hash].remove(job)
        if not waiting[job.signal_hash]:
            shutil.rmtree(job.signal_file(0).parent, ignore_errors=True)

    for future in ended:
        batch = futures.pop(future)
        reasons = _reasons(future, batch)
        if reasons is None:  # one of them killed its worker: run them one by one to find which
            alone = {_submit_batch(client, [job], [], 0, stop_limit_s, "case"): [job] for job in batch}
            futures |= alone
            ended.update(alone)
        elif reasons == [DIED]:
            suspects += batch
        else:
            for job, why in zip(batch, reasons, strict=True):
                end(job, why)
        future.release()
    for job in suspects:
        (future,) = as_completed([_submit_batch(client, [job], [], 0, stop_limit_s, "alone")])
        (why,) = _reasons(future, [job]) or [DIED]
        end(job, why)


def _submit(client: Client, groups: dict[str, list[Job]], stop_limit_s: float) -> dict[Future, list[Job]]:
    """Tasks of all cases, grouped by shared samples, after the tasks that they wait for."""
    futures: dict[Future, list[Job]] = {}
    paths: dict[str, list[Future]] = {}
    n_cases, n_threads = sum(map(len, groups.values())), sum(client.nthreads().values())
    size = min(CASES_PER_TASK, -(-n_cases // max(n_threads, 1)))
    for rank, group in enumerate(groups.values()):
        first = group[0]
        if first.paths_hash not in paths:
            paths[first.paths_hash] = _submit_paths(client, first, -rank)
        before = paths[first.paths_hash]
        if len(group) > 1:
            before = _submit_signals(client, first, before, -rank) or before
        for batch in _blocks(group, size):
            futures[_submit_batch(client, batch, before, -rank, stop_limit_s)] = list(batch)
    return futures


def _submit_batch(
    client: Client, batch: Sequence[Job], before: Sequence[Future], priority: int, stop_limit_s: float,
    kind: str = "cases",
) -> Future:  # fmt: skip
    """The task of some cases that share their samples; another kind is another try."""
    options = _options(f"{kind}-{batch[0].key}-{len(batch)}", priority)
    limit_s = stop_limit_s * sum(len(job.stops) for job in batch)
    return client.submit(_after, before, run_within, limit_s, run_cases, batch, **options)


def _submit_paths(client: Client, job: Job, priority: int) -> list[Future]:
    """Tasks that trace what is not stored, in blocks of stops."""
    missing = job.missing(job.paths_file)
    return [
        client.submit(trace_stops, job, block, **_options(f"paths-{job.paths_hash}-{block[0]}", priority))
        for block in _blocks(missing, STOPS_PER_TASK)
    ]


def _submit_signals(client: Client, job: Job, paths: list[Future], priority: int) -> list[Future]:
    """Tasks that make the samples for which several jobs wait."""
    missing = job.missing(job.signal_file)
    key = f"signals-{job.signal_hash}"
    return [
        client.submit(_after, paths, make_signals, job, block, **_options(f"{key}-{block[0]}", priority))
        for block in _blocks(missing, STOPS_PER_TASK)
    ]


def _options(key: str, priority: int) -> dict[str, Any]:
    return {"key": key, "pure": False, "priority": priority}


def _reasons(future: Future, batch: Sequence[Job]) -> list[str | None] | None:
    """The reason of every failure in a batch, None for a case that is done; None where several share a fault.

    Raises errors that are no fault of a case.
    """
    found = outcome(future)
    if isinstance(found, BaseException):
        if len(batch) > 1:
            return None
        return [DIED if isinstance(found, WorkerDiedError) else reason(found)]
    return list(found)


def _after(done: Sequence[None], function: Callable[..., T], *arguments: Any) -> T:
    """Call a function after the tasks whose results are in `done`."""
    del done
    return function(*arguments)


def _blocks(items: Sequence[T], size: int) -> list[Sequence[T]]:
    return [items[start : start + size] for start in range(0, len(items), size)]
