"""Calls on the workers, and how they end."""

import errno
import faulthandler
import os
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from functools import partial
from typing import Any, ParamSpec, TypeVar

from distributed import Client, Future, KilledWorker, as_completed

__all__ = [
    "STOP_LIMIT_S", "Client", "Future", "WorkerDiedError", "as_completed", "begun", "each_outcome", "outcome",
    "run_within",
]  # fmt: skip

STOP_LIMIT_S = 3600.0  # of a stop: a worker that takes longer is taken as one that hangs
IN_FLIGHT = 2  # calls for every worker: the next one is there when one ends
# Faults of the disk, not of a call: the command ends at once.
PLACE_FAULTS = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.EFBIG}
LOST = "the scheduler was lost; the same command continues where it stopped"

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


class WorkerDiedError(ChildProcessError):
    """The process that ran a call died each time: by itself, by the system, or because it took too long."""


def outcome(future: Future) -> Any:
    """What a call returned, or the error that it raised; `WorkerDiedError` where its worker died each time.

    A call that ended is lost with its worker where that dies before its result is here: both requests below wait
    until it has run again. Raises faults of the disk, and `ConnectionError` where the scheduler was lost.
    """
    error = future.exception()
    if isinstance(error, OSError) and error.errno in PLACE_FAULTS:
        raise error
    if isinstance(error, KilledWorker):
        return WorkerDiedError()
    if isinstance(error, BaseException):
        return error
    try:
        return future.result()
    except (OSError, CancelledError) as gone:
        raise ConnectionError(LOST) from gone


def each_outcome(
    client: Client, n_workers: int, function: Callable[[T], R], items: Sequence[T], limit_s: float
) -> Iterator[tuple[T, R | BaseException]]:
    """Call a function with every item, side by side, and yield item and outcome as they end.

    A worker that takes longer than `limit_s` for a call is ended, as one that hangs. A call whose worker died may
    have waited there behind the one that killed it. So it is tried again alone, before others start, and only
    `WorkerDiedError` of such a try is an outcome. Raises as `outcome` does.
    """
    waiting: list[T] = list(reversed(items))
    suspects: list[T] = []
    running: dict[Future, T] = {}
    ended = as_completed()

    def submit(item: T) -> None:
        future = client.submit(run_within, limit_s, returned, function, item, pure=False)
        running[future] = item
        ended.add(future)

    while waiting or running or suspects:
        while waiting and not suspects and len(running) < IN_FLIGHT * n_workers:
            submit(waiting.pop())
        is_alone = not running
        if is_alone:
            submit(suspects.pop())
        future = next(ended)
        item, found = running.pop(future), outcome(future)
        future.release()
        if isinstance(found, WorkerDiedError) and not is_alone:
            suspects.append(item)
        else:
            yield item, found


def begun(client: Client, function: Callable[[T], R], item: T) -> Callable[[], R | BaseException]:
    """Let a worker call a function; what comes back waits for its outcome, and raises as `outcome` does."""
    return partial(outcome, client.submit(returned, function, item, pure=False))


def returned(function: Callable[[T], R], item: T) -> R | BaseException:
    """What a function returns or raises, also an interruption: dask would take it as one of the worker."""
    try:
        return function(item)
    except BaseException as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            return RuntimeError(f"{type(error).__name__}: {error}")
        return error


def run_within(limit_s: float, function: Callable[P, R], *arguments: P.args, **options: P.kwargs) -> R:
    """Call a function; end this process, as a crash would, where it takes longer, also where it holds the GIL."""
    with open(os.devnull, "w", encoding="utf-8") as nothing:
        faulthandler.dump_traceback_later(limit_s, exit=True, file=nothing)
        try:
            return function(*arguments, **options)
        finally:
            faulthandler.cancel_dump_traceback_later()
