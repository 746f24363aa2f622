"""One run at a time in a directory."""

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scenes.names import refuse_outer_links

NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL, errno.EBADF}


class DirectoryHeldError(ValueError):
    """Another run is at work in a directory."""


@contextmanager
def one_run(directory: Path) -> Iterator[None]:
    """Lock a directory, made where missing, for one run; the system unlocks it when the process ends.

    File systems without locks do not lock it.

    Raises `DirectoryHeldError` where another run has locked it, `ValueError` where it cannot be made or opened, or
    a link in it leads elsewhere.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        handle = os.open(directory, os.O_RDONLY)
    except OSError as error:
        reason = "is a file" if isinstance(error, FileExistsError) else error.strerror
        what = f"--out = {directory}: {reason}; must be a directory that can be written, or made"
        raise ValueError(what) from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            what = f"{directory}: another run is at work in this directory; wait for it or choose another"
            raise DirectoryHeldError(what) from error
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
        refuse_outer_links(directory)
        yield
    finally:
        os.close(handle)
