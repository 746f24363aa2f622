"""The workers of a command: they start where they are first needed."""

from __future__ import annotations

import os
import signal
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from distributed import Client


def n_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0))


class Workers:
    """Processes here, one per core by default, or those of a scheduler. A command without calls starts none."""

    def __init__(self, workers: int | None, scheduler: str | None, stop_limit_s: float | None = None) -> None:
        self._n_workers, self._scheduler = workers or n_cores(), scheduler
        self.limits = {} if stop_limit_s is None else {"stop_limit_s": stop_limit_s}
        self._stack = ExitStack()
        self._client: Future[Client] | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *error: object) -> None:
        if self._client is not None:
            self._client.exception()  # one that is starting has to be there to be closed
        self._stack.close()

    def start(self) -> None:
        """Start them beside what this process does meanwhile; interrupts are heard by this process alone."""
        if self._client is None:
            starter = ThreadPoolExecutor(1, initializer=_block_interrupts)
            self._client = starter.submit(self._connected)
            starter.shutdown(wait=False)

    @property
    def is_ready(self) -> bool:
        """Whether they take calls at once, or failed to start."""
        return self._client is not None and self._client.done()

    @property
    def client(self) -> Client:
        """The client of the scheduler."""
        if self._client is None:
            connected = self._connected()
            self._client = Future()
            self._client.set_result(connected)
        return self._client.result()

    def keep(self, n_workers: int) -> None:
        """End all processes here but so many, with the memory that they hold; their calls go to the others."""
        self._n_workers = min(self._n_workers, n_workers)
        self.client.cluster.scale(self._n_workers)

    def _connected(self) -> Client:
        from isac_arena.workers.cluster import connect_scheduler  # noqa: PLC0415

        return self._stack.enter_context(connect_scheduler(lambda: self._n_workers, self._scheduler))


def _block_interrupts() -> None:
    """Block Ctrl-C in this thread, and so in the processes that it starts."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
