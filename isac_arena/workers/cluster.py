"""The processes of workers: some here, or those of a scheduler elsewhere. Only this package uses dask."""

import logging
import os
import signal
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

import dask.config
from distributed import Client, LocalCluster, WorkerPlugin
from distributed.versions import VersionMismatchWarning
from distributed.worker_memory import parse_memory_limit
from tornado.ioloop import PeriodicCallback

from isac_arena.campaign.integrity import code_digest
from isac_arena.workers.threads import ONE_THREAD

ANSWER_S = 10  # within which a scheduler answers
REPLACE_S = 5.0  # between looks at how many workers are left
ALONE = {**ONE_THREAD, "NUMBA_NUM_THREADS": "1"}
# By default dask returns freed memory to the system at once and samples the stack of every task: a fifth of the
# time of small cases, mostly page faults, and 0.2 MB a case of samples that are kept.
LEAN = {
    "distributed.nanny.pre-spawn-environ": ALONE,
    "distributed.worker.profile.enabled": False,
    "distributed.scheduler.allowed-failures": 1,  # a task may lose two workers: a case that hangs takes its time
}
CODE = ("scenes", "sim", "estimation", "isac_arena")  # that results depend on


class WarmUp(WorkerPlugin):  # type: ignore[misc]
    """Imports the heavy libraries once per worker, before its first case; refuses workers with other code."""

    name = "arena-warm-up"

    def __init__(self, code: str, *, is_ours: bool) -> None:
        self.code, self.is_ours = code, is_ours

    def setup(self, worker: Any) -> None:
        """Called by dask in every worker, also in those that join late."""
        if self.code != code_digest(*CODE):
            raise ValueError(f"worker {worker.address}: has another version of ISAC Arena; install the same there")
        os.environ.update(ALONE)
        if self.is_ours and threading.current_thread() is threading.main_thread():
            signal.signal(
                signal.SIGINT, signal.SIG_IGN
            )  # also in one that replaces another: the client handles it
        import isac_arena.campaign.driver  # noqa: F401, PLC0415
        import sim.propagation.propagator  # noqa: F401, PLC0415


@contextmanager
def connect_scheduler(n_workers: Callable[[], int], scheduler: str | None) -> Iterator[Client]:
    """A client of the scheduler at an address, or of worker processes here, as many as wanted at any time.

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
            client.register_plugin(WarmUp(code_digest(*CODE), is_ours=False))
            yield client
        return
    options = {"threads_per_worker": 1, "dashboard_address": "127.0.0.1:0", "silence_logs": "CRITICAL"}
    with dask.config.set(LEAN):  # all the while: a worker that replaces a lost one takes it from here
        with _interrupts_ignored():
            cluster = LocalCluster(n_workers=n_workers(), **options)
        with cluster, closing(Client(cluster)) as client:  # as a context it wants one thread for both ends
            # Where a lost worker takes long to start again, dask gives it up: without this none may be left
            replacing = PeriodicCallback(lambda: cluster.scale(n_workers()), REPLACE_S * 1000)
            cluster.loop.add_callback(replacing.start)
            client.register_plugin(WarmUp(code_digest(*CODE), is_ours=True))
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
