"""One run at a time in a directory."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL, errno.EBADF}


class DirectoryHeldError(ValueError):
    """Another run is at work in a directory."""


@contextmanager
def one_run(directory: Path) -> Iterator[None]:
    """Hold a directory, made where missing, for one run; the system lets go of it when the process ends or dies.

    File systems without locks hold nothing.

    Raises `DirectoryHeldError`, one line, where another run holds it, `OSError` where it cannot be made or opened.
    """
    directory.mkdir(parents=True, exist_ok=True)
    handle = os.open(directory, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise DirectoryHeldError(
                f"{directory}: another run is at work in this directory; wait for it or choose another"
            ) from error
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
        yield
    finally:
        os.close(handle)
