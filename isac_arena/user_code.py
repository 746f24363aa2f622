"""A user's function: imported by name, fenced off from our code, and its errors with their traceback."""

import importlib
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager
from itertools import dropwhile
from pathlib import Path

OURS = (str(Path(__file__).parent), importlib.__file__, "<frozen importlib")


class EstimatorError(ValueError):
    """A user's function failed: one line that names file and line; `trace` is the traceback of its own code."""

    def __init__(self, message: str, trace: str) -> None:
        super().__init__(message, trace)  # so that it survives the way from another process
        self.trace = trace

    def __str__(self) -> str:
        """The line."""
        return str(self.args[0])


@contextmanager
def fenced() -> Iterator[None]:
    """Undo what a user's code changes for the code after it: working directory, warnings, errors of numpy."""
    import numpy as np  # noqa: PLC0415  (the command line imports this module for `--help`)

    with chdir("."), warnings.catch_warnings(), np.errstate():
        yield


def user_error(what: str, error: BaseException) -> ValueError:
    """The error of a user's code after `what`, with where it happened, and its traceback without our frames."""
    frames = traceback.TracebackException.from_exception(error)
    own = list(dropwhile(lambda frame: frame.filename.startswith(OURS), frames.stack))
    frames.stack = traceback.StackSummary.from_list(own)
    line = " ".join(f"{what}{type(error).__name__}: {error}".split())
    if not own:
        return ValueError(line)
    place = f" ({own[-1].filename}, line {own[-1].lineno})"
    return EstimatorError(f"{line}{place}", f"{line}\n\n{''.join(frames.format())}")


def imported_function(name: str) -> Callable[..., object]:
    """The function `package.module:function`; raises `ValueError` where the name is no such function."""
    module_name, colon, function_name = name.partition(":")
    if not (module_name and colon and function_name):
        raise ValueError(f"estimator = '{name}': write it as package.module:function")
    try:
        with fenced():
            function = getattr(importlib.import_module(module_name), function_name)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise user_error(f"estimator = '{name}': cannot be imported: ", error) from error
    if not callable(function):
        raise ValueError(f"estimator = '{name}': is no function")
    return function  # type: ignore[no-any-return]
