"""The process in which a user's function runs: it gets the input of a stage and sends the checked result back.

It ends when our side closes the connection or dies. Its input is read-only; that it stayed the same is checked.
"""

import hashlib
import inspect
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from multiprocessing.connection import Connection
from typing import Any, Literal

import numpy as np

from isac_arena.user_functions.contracts import CONTRACTS
from isac_arena.user_functions.errors import fenced, told
from isac_arena.user_functions.names import full_name, imported_function

POLL_S = 0.5
Answer = tuple[Literal["result", "error", "interrupt"], Any]


def serve(handle: int) -> None:
    """Import the function that the connection names, then answer calls until the connection is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # our side hears it, and ends this process
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    connection = Connection(handle)
    try:
        stage, name, settings = connection.recv()
        contract = CONTRACTS[stage]
        function, answer = _imported(name, len(contract.arguments), settings)
        connection.send(answer)
        while function is not None:
            arguments = connection.recv()
            _send(connection, _answer(function, arguments, settings, contract.check))
    except (EOFError, OSError):  # our side is gone
        return


def _end_with(parent: int) -> None:
    """End this process when the one that started it is gone, whatever the function does."""
    while os.getppid() == parent:
        time.sleep(POLL_S)
    os.kill(os.getpid(), signal.SIGKILL)


def _imported(
    name: str, n_arguments: int, settings: dict[str, Any]
) -> tuple[Callable[..., object] | None, Answer]:
    try:
        full = full_name(name)
    except ValueError as error:
        return None, ("error", (str(error), ""))
    try:
        with fenced():
            function = imported_function(full)
    except KeyboardInterrupt:
        return None, ("interrupt", None)
    except BaseException as error:
        line, trace = told(error)
        return None, ("error", (f"cannot be imported: {line}", trace))
    try:
        inspect.signature(function).bind(*range(n_arguments), **settings)
    except TypeError as error:
        return None, ("error", (f"cannot be called with {n_arguments} arguments and its settings: {error}", ""))
    except ValueError:  # of C code, whose arguments are not known
        pass
    return function, ("result", None)


def _answer(
    function: Callable[..., object],
    arguments: tuple[Any, ...],
    settings: dict[str, Any],
    check: Callable[..., Any],
) -> Answer:
    for _, value in _arrays(arguments, ""):
        value.setflags(write=False)
    before = _marks(arguments)
    try:
        with fenced():
            found = function(*arguments, **settings)
    except KeyboardInterrupt:
        return "interrupt", None
    except BaseException as error:
        return "error", told(error)
    after = _marks(arguments)
    changed = [name for name, mark in before.items() if after.get(name) != mark]
    if changed:
        return "error", (f"changed its input: {changed[0]}", "")
    try:
        return "result", check(found, *arguments)
    except Exception as error:
        words = " ".join(str(error).split())
        return "error", (words if isinstance(error, ValueError) else f"{type(error).__name__}: {words}", "")


def _send(connection: Connection, answer: Answer) -> None:
    try:
        connection.send(answer)
    except OSError:
        raise
    except Exception as error:  # what cannot be sent
        connection.send(("error", told(error)))


def _marks(arguments: tuple[Any, ...]) -> dict[str, bytes]:
    """A hash of every array of the input, by its name."""
    return {
        name: hashlib.blake2b(np.ascontiguousarray(value).tobytes(), digest_size=16).digest()
        for name, value in _arrays(arguments, "")
    }


def _arrays(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """All arrays inside records, tuples and lists, each with the name of its field."""
    if isinstance(value, np.ndarray):
        yield name, value
    elif is_dataclass(value):
        for spec in fields(value):
            yield from _arrays(getattr(value, spec.name), f"{name} {spec.name}".strip())
    elif isinstance(value, tuple | list):
        for index, part in enumerate(value):
            yield from _arrays(part, f"{name} {index}".strip())
