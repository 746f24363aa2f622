"""Many cases on many processes: what to run in which order, by dask.distributed. The only user of dask."""

from __future__ import annotations

import errno
import logging
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from distributed import Client, Future, LocalCluster, WorkerPlugin, as_completed

from scripts.sweep_job import Job
from scripts.sweep_run import make_signals, run_case, trace_stops

STOPS_PER_TASK = 8
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
# Faults of the place, not of a case: the sweep ends at once and no case is recorded as failed.
PLACE_FAULTS = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.EFBIG}

Report = Callable[[Job, BaseException | None], None]


class WarmUp(WorkerPlugin):  # type: ignore[misc]
    """Imports the heavy libraries once per worker, before its first case."""

    name = "arena-warm-up"

    def setup(self, worker: Any) -> None:
        """Called by dask in every worker, also in those that join late."""
        del worker
        os.environ.update(ONE_THREAD)
        import estimation.pipeline  # noqa: F401, PLC0415
        import sim.propagation  # noqa: F401, PLC0415


@contextmanager
def connected(workers: int | None, scheduler: str | None) -> Iterator[Client]:
    """A client of the scheduler at an address, or of new worker processes here, one per core by default.

    Raises `ValueError` where no scheduler answers at the address.
    """
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(
                logging.CRITICAL + 1
            )  # what matters comes back as an error of a case
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout="10s")
        except (OSError, ValueError, TypeError) as error:
            raise ValueError(
                f"--scheduler = '{scheduler}': no dask scheduler answers there; give its address as tcp://HOST:PORT"
            ) from error
        with client:
            client.register_plugin(WarmUp())
            yield client
        return
    n_workers = workers or os.cpu_count() or 1
    with _interrupts_ignored():
        cluster = LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",
            silence_logs="CRITICAL",
            env=ONE_THREAD,
        )
    with cluster, Client(cluster) as client:
        client.register_plugin(WarmUp())
        yield client


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Ignore Ctrl-C, and for good in processes started meanwhile: it is the client's to handle."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def run_jobs(client: Client, jobs: Sequence[Job], report: Report) -> None:
    """Run all jobs, the paths and samples they share first; `report` is told of each one that ends.

    Jobs that share their samples stand together: their samples are dropped before those of many others are made.
    A job whose worker dies is tried again elsewhere; one that fails is reported with its error and stops no other.

    Raises
    ------
    OSError
        Where the directory of the sweep cannot be written, or its disk is full.
    ConnectionError
        Where the scheduler was lost.
    """
    waiting: dict[str, list[Job]] = {}
    for job in jobs:
        waiting.setdefault(job.signal_hash, []).append(job)
    futures = _submit(client, waiting)
    for future in as_completed(futures):
        job = futures.pop(future)
        report(job, _error(future))
        waiting[job.signal_hash].remove(job)
        if not waiting[job.signal_hash]:
            shutil.rmtree(job.signal_file(0).parent, ignore_errors=True)
        future.release()


def _submit(client: Client, groups: dict[str, list[Job]]) -> dict[Future, Job]:
    """Tasks of all cases, group by group of those that share samples, behind the tasks they wait for."""
    futures: dict[Future, Job] = {}
    paths: dict[str, list[Future]] = {}
    for rank, group in enumerate(groups.values()):
        first = group[0]
        if first.paths_hash not in paths:
            paths[first.paths_hash] = _submit_paths(client, first, -rank)
        before = paths[first.paths_hash]
        if len(group) > 1:
            before = _submit_signals(client, first, before, -rank) or before
        for job in group:
            future = client.submit(
                _after, before, run_case, job, key=f"case-{job.key}", pure=False, priority=-rank
            )
            futures[future] = job
    return futures


def _submit_paths(client: Client, job: Job, priority: int) -> list[Future]:
    """Tasks that trace what is not stored, in blocks of stops."""
    missing = [stop for stop in job.stops if not job.paths_file(stop).is_file()]
    return [
        client.submit(
            trace_stops, job, block, key=f"paths-{job.paths_hash}-{block[0]}", pure=False, priority=priority
        )
        for block in _blocks(missing)
    ]


def _submit_signals(client: Client, job: Job, paths: list[Future], priority: int) -> list[Future]:
    """Tasks that make the samples for which several jobs wait."""
    missing = [stop for stop in job.stops if not job.signal_file(stop).is_file()]
    return [
        client.submit(
            _after,
            paths,
            make_signals,
            job,
            block,
            key=f"signals-{job.signal_hash}-{block[0]}",
            pure=False,
            priority=priority,
        )
        for block in _blocks(missing)
    ]


def _error(future: Future) -> BaseException | None:
    """The error of a case that ended; raises those that are no fault of the case."""
    if future.status in ("cancelled", "lost"):
        raise ConnectionError("the scheduler was lost; the same command goes on where the sweep stopped")
    error = future.exception()
    if isinstance(error, OSError) and error.errno in PLACE_FAULTS:
        raise error
    return error if isinstance(error, BaseException) else None


def _after(done: Sequence[None], function: Callable[..., None], *arguments: Any) -> None:
    """Call a function when the tasks whose results stand in `done` have ended."""
    del done
    function(*arguments)


def _blocks(stops: Sequence[int]) -> list[Sequence[int]]:
    return [stops[start : start + STOPS_PER_TASK] for start in range(0, len(stops), STOPS_PER_TASK)]
