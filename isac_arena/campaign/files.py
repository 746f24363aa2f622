"""Files that appear under their name only when they are complete: texts, and records as netCDF-4 files."""

import csv
import io
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeVar

from isac_arena.campaign.netcdf import from_netcdf, global_attribute, to_netcdf
from isac_arena.campaign.shards import Member, Stored
from scenes.arguments import need
from scenes.record import Record

# What HDF5 raises on files whose bytes were changed
READ_ERRORS = (OSError, LookupError, AttributeError, ValueError, TypeError, RuntimeError, MemoryError)
R = TypeVar("R", bound=Record)

# Called before a file takes its name, with the name and the complete file, or None before a file is removed
FileListener = Callable[[Path, Path | None], None]
_LISTENER: ContextVar[FileListener | None] = ContextVar("file_listener", default=None)


@contextmanager
def notify_of_files(listener: FileListener) -> Iterator[None]:
    """Call a listener for every file that the functions here write or remove in the block."""
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def _notify(path: Path, complete: Path | None) -> None:
    listener = _LISTENER.get()
    if listener is not None:
        listener(path, complete)


@contextmanager
def complete_file(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, renamed to `path` when the block ends without an error.

    Raises `OSError` where the folder cannot be written, or its disk is full.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        _notify(path, partial)
        os.replace(partial, path)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(partial), str(path.parent)):
            raise
        raise OSError(error.errno, f"cannot be written ({error.strerror})", str(path)) from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def take_over(complete: Path, path: Path) -> None:
    """Give a complete file its name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _notify(path, complete)
    os.replace(complete, path)


def remove_file(path: Path) -> None:
    """Remove a file where it exists."""
    if path.exists():
        _notify(path, None)
        path.unlink(missing_ok=True)


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files and folders directly in a folder whose process has ended."""
    for leftover in folder.glob(".*.part"):
        match = re.fullmatch(r"\..+\.(\d+)\.part", leftover.name)
        if match and not _is_running(int(match[1])):
            if leftover.is_dir():
                shutil.rmtree(leftover, ignore_errors=True)
            else:
                leftover.unlink(missing_ok=True)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    try:  # one that ended stays until its parent, in a container perhaps never, asks for its exit code
        return Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(") ")[2][:1] != "Z"
    except OSError:
        return True


def write_text(path: Path, text: str) -> None:
    """Write a whole text file; the old file stays if that fails."""
    with complete_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole binary file; the old file stays if that fails."""
    with complete_file(path) as partial:
        partial.write_bytes(content)


def write_json(path: Path, content: Any, *, allow_nan: bool = True) -> None:
    """Write a whole JSON file; `ValueError` for numbers that are not finite where `allow_nan` is false."""
    write_text(path, json.dumps(content, indent=1, allow_nan=allow_nan) + "\n")


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]], columns: Sequence[str] | None = None) -> None:
    """Write a whole CSV file of rows; columns by default as in the first row."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if columns is None else columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def write_record(path: Path, record: Record, attributes: Mapping[str, str] | None = None) -> None:
    """Write a record and the records inside it, with global `attributes`, as one netCDF-4 file.

    Raises `OSError` where it cannot be written.
    """
    write_bytes(path, to_netcdf(record, attributes or {}))


def read_record(path: str | Stored, kind: type[R]) -> R:
    """Read a record of the given type from a file written by `write_record`, or from one in a shard.

    Raises `FileNotFoundError` where the file is missing; `ValueError` where the file is damaged, has changed
    since it was written, or holds something else.
    """
    need("path", path, str, Path, Member)
    need("kind", kind, type)
    path = Path(path) if isinstance(path, str) else path
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        return from_netcdf(path, kind)
    except READ_ERRORS as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path}: not a readable {kind.__name__} file ({reason})") from error


def read_attribute(path: Stored, name: str) -> str | None:
    """A global attribute of a netCDF file; None where the file or the attribute is missing or unreadable."""
    try:
        return global_attribute(path, name)
    except READ_ERRORS:
        return None
