"""Our side of the process in which a user's function runs: calls with a time limit, failures in one line.

The process starts with the first call and stays for the next. One that ends or hangs is replaced at the next call.
"""

import atexit
import os
import signal
import subprocess
import sys
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import psutil

from isac_arena.user_functions.config import STAGES, Stage, UserFunction, UserFunctions
from isac_arena.user_functions.errors import EstimatorError
from isac_arena.user_functions.names import can_be_found, function_source
from isac_arena.workers.share import share_bytes
from isac_arena.workers.threads import ONE_THREAD

START_LIMIT_S = 600.0  # to start Python and to import the function
LOOK_S = 0.2  # how often the memory of a function is looked at
MOST_ROOMS = len(STAGES)
START = "import sys; sys.path[:] = {path!r}; from isac_arena.user_functions.inside import serve; serve({handle})"


class Room:
    """A process with a function of a user in it."""

    def __init__(self, stage: Stage, function: UserFunction) -> None:
        self.what = f"{stage} = '{function.function}'"
        self._named = stage, function.function, function.settings
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._owner = os.getpid()

    def start(self) -> None:
        """Start the process and import the function; `EstimatorError` where that fails."""
        if self._connection is not None:
            return
        ours, theirs = Pipe()
        code = START.format(path=sys.path, handle=theirs.fileno())
        self._process = subprocess.Popen(
            [sys.executable, "-c", code], pass_fds=(theirs.fileno(),), env={**os.environ, **ONE_THREAD}
        )
        theirs.close()
        self._connection = ours
        self._ask(self._named, START_LIMIT_S, "")

    def call(self, arguments: tuple[Any, ...], limit_s: float, where: str = "") -> Any:
        """The checked result of the function; `EstimatorError` where it fails, `where` names the stop.

        Raises `KeyboardInterrupt` where the function does.
        """
        self.start()
        return self._ask(arguments, limit_s, where)

    def _ask(self, question: Any, limit_s: float, where: str) -> Any:
        assert self._connection is not None
        try:
            self._connection.send(question)
            if problem := self._wait(limit_s):
                self.close()
                raise self._error(where, problem)
            kind, content = self._connection.recv()
        except EstimatorError:
            raise
        except (EOFError, OSError):
            raise self._error(where, f"ended its process{self._ended()}") from None
        except BaseException:  # an interruption
            self.close()
            raise
        if kind == "result":
            return content
        if question is self._named:
            self.close()
        if kind == "interrupt":
            raise KeyboardInterrupt
        raise self._error(where, *content)

    def _wait(self, limit_s: float) -> str:
        """Wait for an answer; what was wrong where the function takes too much time or memory for it."""
        assert self._connection is not None and self._process is not None
        ends, limit_bytes = time.monotonic() + limit_s, share_bytes()
        while not self._connection.poll(max(0.0, min(LOOK_S, ends - time.monotonic()))):
            if time.monotonic() > ends:
                return f"took longer than {limit_s:g} s"
            with suppress(psutil.Error):
                if psutil.Process(self._process.pid).memory_info().rss > limit_bytes:
                    return f"took more than {1e-9 * limit_bytes:.2g} GB of memory"
        return ""

    def _error(self, where: str, line: str, trace: str = "") -> EstimatorError:
        place = "" if line.startswith(where) else where
        return EstimatorError(f"{self.what}: {place}{line}", trace and f"{self.what}: {place}{trace}")

    def _ended(self) -> str:
        """How the process ended: by a signal, or with an exit code."""
        assert self._process is not None
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)
        code = self._process.poll()
        self.close()
        if code is None or code >= 0:
            return "" if code is None else f" with exit code {code}"
        why = ", as where the memory is short" if -code == signal.SIGKILL else ""
        return f" by {signal.Signals(-code).name}{why}"

    def close(self) -> None:
        """End the process; a fork of ours leaves it alone."""
        connection, process = self._connection, self._process
        self._connection = self._process = None
        if connection is not None:
            connection.close()
        if process is not None and self._owner == os.getpid():
            process.kill()
            process.wait()


_ROOMS: OrderedDict[tuple[Any, ...], Room] = OrderedDict()


def room(stage: Stage, function: UserFunction) -> Room:
    """The room of a function; it is kept for the next calls until its source changes."""
    settings = repr(sorted(function.settings.items()))
    source = function_source(function.function)
    key = (os.getpid(), stage, function.function, settings, source, tuple(sys.path), str(Path.cwd()))
    found = _ROOMS.pop(key, None) or Room(stage, function)
    _ROOMS[key] = found
    while len(_ROOMS) > MOST_ROOMS:
        _ROOMS.popitem(last=False)[1].close()
    return found


@atexit.register
def close_rooms() -> None:
    """End all processes of functions."""
    while _ROOMS:
        _ROOMS.popitem()[1].close()


def called(stage: Stage, function: UserFunction, *arguments: Any, where: str = "") -> Any:
    """The checked result of a user's function in place of a stage; `EstimatorError` where it fails."""
    return room(stage, function).call(arguments, function.limit_s, where)


def caller(stage: Stage, function: UserFunction) -> Callable[..., Any]:
    """As `called`, with the room opened once: for a function that is called at every stop."""
    opened = room(stage, function)
    opened.start()
    return lambda *arguments, where="": opened.call(arguments, function.limit_s, where)


def check_functions(functions: UserFunctions) -> None:
    """Import all functions, each in its process; `EstimatorError`, one line, where one cannot be used."""
    for stage, function in functions.given.items():
        room(stage, function).start()


def functions_digest(functions: UserFunctions, *stages: Stage) -> list[str]:
    """What the results of functions depend on: their names, settings and sources."""
    given = ((stage, functions.of(stage)) for stage in stages)
    return [
        f"{stage} {one.function} {sorted(one.settings.items())!r} {function_source(one.function)}"
        for stage, one in given
        if one is not None
    ]


def not_found(functions: UserFunctions) -> str:
    """Which function cannot be imported from here, and what to do, as the end of a line; empty where all can."""
    for one in functions.given.values():
        if not can_be_found(one.function):
            return (
                f"the function {one.function} of these settings cannot be imported from here; "
                "start in the folder of its file, or put that folder on PYTHONPATH"
            )
    return ""
