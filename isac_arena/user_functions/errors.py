"""Errors of a user's function, with the traceback of its own code alone, and a fence around its changes."""

import importlib
import os
import sysconfig
import traceback
import warnings
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from itertools import dropwhile
from pathlib import Path

from isac_arena.own_packages import OWN_PACKAGES, ROOT

OURS = (str(Path(__file__).parent), importlib.__file__, "<frozen importlib")
LIBRARIES = (  # an error in them, or in code that has no file, is told at the line of the user that called it
    "<",
    *(f"{ROOT / package}{os.sep}" for package in (*OWN_PACKAGES, "isac_arena")),
    *(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")),
)
TRACE_FILE = "estimator_error.txt"
LONGEST = 500  # characters of an error in its line; the traceback has all of it


class EstimatorError(ValueError):
    """A user's function failed: one line that names file and line; `trace` is the traceback of its own code."""

    def __init__(self, message: str, trace: str = "") -> None:
        super().__init__(message, trace)  # so that it survives the way from another process
        self.trace = trace
        self.trace_file = Path(TRACE_FILE)  # where the command line writes the traceback

    def __str__(self) -> str:
        """The line."""
        return str(self.args[0])


class WentOnError(EstimatorError):
    """A user's function failed at some stops or stages, and the run went on to its end without them."""


@contextmanager
def traces_in(directory: Path) -> Iterator[None]:
    """Say where the traceback of a user's function goes; one of an earlier try is removed.

    It is kept with the results of a run that went on, and beside a run that stays as it was.
    """
    inside, folder = directory / TRACE_FILE, directory.resolve()
    beside = folder.with_name(f"{folder.name}.{TRACE_FILE}")
    try:
        yield
    except EstimatorError as error:
        error.trace_file = inside if isinstance(error, WentOnError) else beside
        raise
    for file in (inside, beside):
        file.unlink(missing_ok=True)


@contextmanager
def fenced() -> Iterator[None]:
    """Undo what a user's code changes for the code after it: working directory, warnings, errors of numpy."""
    import numpy as np  # noqa: PLC0415  (the command line imports this module for `--help`)

    with chdir("."), warnings.catch_warnings(), np.errstate():
        yield


def told(error: BaseException) -> tuple[str, str]:
    """The error of a user's code in one line, with where it happened, and its traceback without our frames."""
    frames = traceback.TracebackException.from_exception(error)
    own = list(dropwhile(lambda frame: frame.filename.startswith(OURS), frames.stack))
    frames.stack = traceback.StackSummary.from_list(own)
    line = " ".join(f"{type(error).__name__}: {error}".split())
    line = line if len(line) <= LONGEST else f"{line[:LONGEST]} ..."
    if not own:
        return line, ""
    theirs = [frame for frame in own if not frame.filename.startswith(LIBRARIES)] or own
    place = f" ({theirs[-1].filename}, line {theirs[-1].lineno})"
    return f"{line}{place}", f"{line}{place}\n\n{''.join(frames.format())}"


def summed(failures: list[EstimatorError]) -> WentOnError:
    """The failures of a run that went on, as one line."""
    first, more = failures[0], len(failures) - 1
    others = f", and {more} more" if more else ""
    return WentOnError(f"{first}{others}; the run went on without", first.trace)
