"""Many cases on many processes, and their order. The only user of dask.distributed."""

import errno
import faulthandler
import logging
import os
import shutil
import signal
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from typing import Any, TypeVar

import dask.config
from distributed import Client, Future, KilledWorker, LocalCluster, WorkerPlugin, as_completed
from distributed.versions import VersionMismatchWarning
from distributed.worker_memory import parse_memory_limit
from tornado.ioloop import PeriodicCallback

from isac_arena.campaign.integrity import code_digest
from isac_arena.sweep.job import Job
from isac_arena.sweep.run import make_signals, reason, run_cases, trace_stops

ANSWER_S = 10  # within which a scheduler answers
STOP_LIMIT_S = 3600.0  # of a stop of a case: a worker that takes longer is taken as one that hangs
REPLACE_S = 5.0  # between looks at how many workers are left
STOPS_PER_TASK = 8
CASES_PER_TASK = 8  # at most, of cases that share their samples: samples are read once for all
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
# By default dask returns freed memory to the system at once and samples the stack of every task: a fifth of the
# time of small cases, mostly page faults, and 0.2 MB a case of samples that are kept.
LEAN = {
    "distributed.nanny.pre-spawn-environ": ONE_THREAD,
    "distributed.worker.profile.enabled": False,
    "distributed.scheduler.allowed-failures": 1,  # a task may lose two workers: a case that hangs takes its time
}
CODE = ("scenes", "sim", "estimation", "isac_arena")  # that results depend on
# Faults of the disk, not of a case: the sweep ends at once and no case is recorded as failed.
PLACE_FAULTS = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.EFBIG}

DIED = "its worker died each time: out of memory, ended or crashed by the estimator, or longer than --stop-limit"
LOST = "the scheduler was lost; the same command continues where the sweep stopped"

Report = Callable[[Job, str | None], None]  # of a case that ended, and why where it failed
T = TypeVar("T")


class WarmUp(WorkerPlugin):  # type: ignore[misc]
    """Imports the heavy libraries once per worker, before its first case; refuses workers with other code."""

    name = "arena-warm-up"

    def __init__(self, code: str) -> None:
        self.code = code

    def setup(self, worker: Any) -> None:
        """Called by dask in every worker, also in those that join late."""
        if self.code != code_digest(*CODE):
            raise ValueError(f"worker {worker.address}: has another version of ISAC Arena; install the same there")
        os.environ.update(ONE_THREAD)
        import isac_arena.campaign.driver  # noqa: F401, PLC0415
        import sim.propagation.propagator  # noqa: F401, PLC0415


@contextmanager
def connect_scheduler(workers: int | None, scheduler: str | None) -> Iterator[Client]:
    """A client of the scheduler at an address, or of new worker processes here, one per core by default.

    Raises `ValueError` where no scheduler answers at the address.
    """
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # errors of cases are returned
    if scheduler is not None:
        warnings.simplefilter("ignore", VersionMismatchWarning)  # a table: `_check_versions` says it in one line
        try:
            client = Client(scheduler, timeout=f"{ANSWER_S}s")
        except (OSError, ValueError, TypeError) as error:
            raise ValueError(
                f"--scheduler = '{scheduler}': no dask scheduler answers there; give its address as tcp://HOST:PORT"
            ) from error
        with client:
            _check_versions(client, scheduler)
            client.register_plugin(WarmUp(code_digest(*CODE)))
            yield client
        return
    n_workers = workers or os.cpu_count() or 1
    options = {"threads_per_worker": 1, "dashboard_address": "127.0.0.1:0", "silence_logs": "CRITICAL"}
    with dask.config.set(LEAN):  # all the while: a worker that replaces a lost one takes it from here
        with _interrupts_ignored():
            cluster = LocalCluster(n_workers=n_workers, **options)
        with cluster, Client(cluster) as client:
            # Where a lost worker takes long to start again, dask gives it up: without this none may be left
            replacing = PeriodicCallback(lambda: cluster.scale(n_workers), REPLACE_S * 1000)
            cluster.loop.add_callback(replacing.start)
            client.register_plugin(WarmUp(code_digest(*CODE)))
            try:
                yield client
            finally:
                cluster.loop.add_callback(replacing.stop)


def worker_bytes(n_workers: int) -> float:
    """Memory that dask gives each of some workers here."""
    return float(parse_memory_limit("auto", 1, n_workers, logger=logging.getLogger(__name__)) or 0)


def _check_versions(client: Client, scheduler: str) -> None:
    """Raise `ValueError` where a scheduler or its workers have another Python or dask."""
    found = client.get_versions()
    for place, there in {"the scheduler": found["scheduler"], **found["workers"]}.items():
        for package in ("python", "distributed"):
            versions = [str(one["packages"][package]) for one in (there, found["client"])]
            if versions[0] != versions[1]:
                what = f"{place} has {package} {versions[0]}, here it is {versions[1]}"
                raise ValueError(f"--scheduler = '{scheduler}': {what}; install the same")


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Ignore Ctrl-C here and in the processes that start meanwhile: the client handles it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


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
    return client.submit(_after, before, _run_within, limit_s, batch, **options)


def _submit_paths(client: Client, job: Job, priority: int) -> list[Future]:
    """Tasks that trace what is not stored, in blocks of stops."""
    missing = [stop for stop in job.stops if not job.paths_file(stop).is_file()]
    return [
        client.submit(trace_stops, job, block, **_options(f"paths-{job.paths_hash}-{block[0]}", priority))
        for block in _blocks(missing, STOPS_PER_TASK)
    ]


def _submit_signals(client: Client, job: Job, paths: list[Future], priority: int) -> list[Future]:
    """Tasks that make the samples for which several jobs wait."""
    missing = [stop for stop in job.stops if not job.signal_file(stop).is_file()]
    key = f"signals-{job.signal_hash}"
    return [
        client.submit(_after, paths, make_signals, job, block, **_options(f"{key}-{block[0]}", priority))
        for block in _blocks(missing, STOPS_PER_TASK)
    ]


def _options(key: str, priority: int) -> dict[str, Any]:
    return {"key": key, "pure": False, "priority": priority}


def _reasons(future: Future, batch: Sequence[Job]) -> list[str | None] | None:
    """The reason of every failure in a batch, None for a case that is done; None where several share a fault.

    A task that ended is lost with its worker where that dies before its result is here: both calls below wait
    until it has run again. Raises errors that are no fault of a case.
    """
    error = future.exception()
    if isinstance(error, OSError) and error.errno in PLACE_FAULTS:
        raise error
    if isinstance(error, BaseException):
        if len(batch) > 1:
            return None
        return [DIED if isinstance(error, KilledWorker) else reason(error)]
    try:
        return list(future.result())
    except (OSError, CancelledError) as gone:
        raise ConnectionError(LOST) from gone


def _run_within(limit_s: float, batch: Sequence[Job]) -> list[str | None]:
    """Run cases; end this process, as a crash would, where they take longer, also where a call holds the GIL."""
    with open(os.devnull, "w", encoding="utf-8") as nothing:
        faulthandler.dump_traceback_later(limit_s, exit=True, file=nothing)
        try:
            return run_cases(batch)
        finally:
            faulthandler.cancel_dump_traceback_later()


def _after(done: Sequence[None], function: Callable[..., T], *arguments: Any) -> T:
    """Call a function after the tasks whose results are in `done`."""
    del done
    return function(*arguments)


def _blocks(items: Sequence[T], size: int) -> list[Sequence[T]]:
    return [items[start : start + size] for start in range(0, len(items), size)]
