"""Input files, which may come from strangers: regular files of a sane size, packed or not."""

import os
import stat
import zipfile
import zlib
from pathlib import Path
from typing import Literal

from scenes.memory import ask_memory

LARGEST_TEXT = 32_000_000  # bytes of a table, a floor plan or a settings file
HELD_PER_BYTE = 3  # of a binary file while a library reads it
CHUNK = 1 << 20


class InputError(ValueError):
    """A file is no input that can be read; the message names it."""


def read_input(path: str | Path, largest_bytes: int | None = None) -> bytes:
    """The bytes of a regular file.

    Raises `OSError` where it cannot be opened; `InputError` where it is a folder, a device or a pipe, or larger
    than `largest_bytes`; `MemoryLimitError` where it does not fit into the memory.
    """
    handle = _opened(path)
    with os.fdopen(handle, "rb") as file:
        size = os.fstat(handle).st_size
        if largest_bytes is not None and size > largest_bytes:
            raise InputError(f"{path}: has {size} bytes, at most {largest_bytes} are read")
        ask_memory(HELD_PER_BYTE * size, "its content", str(path))
        return file.read(size)


def check_input(path: str | Path) -> None:
    """Check a file that a library will open: as `read_input`, and with the unpacked size of a zip archive."""
    handle = _opened(path)
    with os.fdopen(handle, "rb") as file:
        size = os.fstat(handle).st_size
        if zipfile.is_zipfile(file):
            try:
                with zipfile.ZipFile(file) as archive:
                    size = sum(member.file_size for member in archive.infolist())
            except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
                raise InputError(f"{path}: a damaged archive ({error})") from error
        ask_memory(HELD_PER_BYTE * size, "its content when unpacked", str(path))


def check_matlab(path: str | Path) -> None:
    """Check a MATLAB 5 file as `check_input`, with the unpacked size of its compressed variables."""
    content, at, size = memoryview(read_input(path)), 128, 0
    while at + 8 <= len(content):
        order: Literal["little", "big"] = "little" if bytes(content[126:128]) == b"IM" else "big"
        kind, length = (int.from_bytes(content[at + k : at + k + 4], order) for k in (0, 4))
        at += 8
        size += length
        if kind == 15:  # miCOMPRESSED
            size += _unpacked(content[at : at + length], path, size)
        at += length


def _unpacked(packed: memoryview, path: str | Path, before: int) -> int:
    """Bytes of a compressed block; it is unpacked in pieces, and only until it is too large."""
    stream, size, rest = zlib.decompressobj(), 0, bytes(packed)
    try:
        while rest and not stream.eof:
            size += len(stream.decompress(rest, CHUNK))
            rest = stream.unconsumed_tail
            ask_memory(HELD_PER_BYTE * (before + size), "its content when unpacked", str(path))
    except zlib.error:
        return size  # damaged: its reader says so
    return size


def _opened(path: str | Path) -> int:
    """A file descriptor of a regular file; opening a pipe does not wait for its other end."""
    if "\0" in str(path):
        raise InputError(f"{str(path)!r}: the name of a file holds no NUL")
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise InputError(f"{path}: no regular file; folders, devices and pipes are not read")
    return handle
