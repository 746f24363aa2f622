"""Many cases on many processes: what to run in which order, by dask.distributed. The only user of dask."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from distributed import Client, Future, LocalCluster, WorkerPlugin, as_completed

from scripts.sweep_run import Job, make_signals, run_case, store_scene, trace_stops

STOPS_PER_TASK = 8
DEATHS_ALLOWED = 3  # of workers on the same case
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "NUMBA")}

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

    Raises `OSError` where no scheduler answers.
    """
    if scheduler is not None:
        with Client(scheduler, timeout="10s") as client:
            client.register_plugin(WarmUp())
            yield client
        return
    n_workers = workers or os.cpu_count() or 1
    with (
        LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            dashboard_address=None,
            silence_logs="ERROR",
            env=ONE_THREAD,
        ) as cluster,
        Client(cluster) as client,
    ):
        client.register_plugin(WarmUp())
        yield client


def run_jobs(client: Client, jobs: Sequence[Job], report: Report) -> None:
    """Run all jobs, the paths and samples they share first; `report` is told of each one that ends.

    A job whose worker dies is tried again elsewhere; one that fails is reported with its error and stops no other.
    """
    for job in jobs:
        store_scene(job)
    paths = _submit_paths(client, jobs)
    signals = _submit_signals(client, jobs, paths)
    waiting = Counter(job.signal_hash for job in jobs)
    futures = {}
    for job in jobs:
        before = signals.get(job.signal_hash) or paths[job.paths_hash]
        futures[client.submit(_after, before, run_case, job, key=f"case-{job.key}", pure=False)] = job
    for future in as_completed(futures):
        job = futures.pop(future)
        error = future.exception()
        report(job, error)
        waiting[job.signal_hash] -= 1
        if not waiting[job.signal_hash]:
            shutil.rmtree(job.signal_file(0).parent, ignore_errors=True)
        future.release()


def _submit_paths(client: Client, jobs: Sequence[Job]) -> dict[str, list[Future]]:
    """Tasks that trace what is not stored, in blocks of stops, by the hash of the paths."""
    found: dict[str, list[Future]] = {}
    for job in jobs:
        if job.paths_hash not in found:
            missing = [stop for stop in job.stops if not job.paths_file(stop).is_file()]
            found[job.paths_hash] = [
                client.submit(trace_stops, job, block, key=f"paths-{job.paths_hash}-{block[0]}", pure=False)
                for block in _blocks(missing)
            ]
    return found


def _submit_signals(
    client: Client, jobs: Sequence[Job], paths: dict[str, list[Future]]
) -> dict[str, list[Future]]:
    """Tasks that make the samples for which several jobs wait, by the hash of the samples."""
    shared = Counter(job.signal_hash for job in jobs)
    found: dict[str, list[Future]] = {}
    for job in jobs:
        if shared[job.signal_hash] > 1 and job.signal_hash not in found:
            missing = [stop for stop in job.stops if not job.signal_file(stop).is_file()]
            found[job.signal_hash] = [
                client.submit(
                    _after,
                    paths[job.paths_hash],
                    make_signals,
                    job,
                    block,
                    key=f"signals-{job.signal_hash}-{block[0]}",
                    pure=False,
                )
                for block in _blocks(missing)
            ]
    return found


def _after(done: Sequence[None], function: Callable[..., None], *arguments: Any) -> None:
    """Call a function when the tasks whose results stand in `done` have ended."""
    del done
    function(*arguments)


def _blocks(stops: Sequence[int]) -> list[Sequence[int]]:
    return [stops[start : start + STOPS_PER_TASK] for start in range(0, len(stops), STOPS_PER_TASK)]
