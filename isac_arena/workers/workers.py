"""The workers of a command: they start where they are first needed."""

from __future__ import annotations

import os
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
        self._options = workers, scheduler
        self.limits = {} if stop_limit_s is None else {"stop_limit_s": stop_limit_s}
        self._stack = ExitStack()
        self._client: Client | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    @property
    def client(self) -> Client:
        """The client of the scheduler."""
        from isac_arena.workers.cluster import connect_scheduler  # noqa: PLC0415

        if self._client is None:
            self._client = self._stack.enter_context(connect_scheduler(*self._options))
        return self._client
