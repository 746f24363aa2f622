"""Shards: the files of many stops in one archive, so that a long campaign has few files.

    truth/stop_000.nc ... truth/stop_255.nc  ->  truth/stops_000-255.zip

Each stop is first a file of its own: a run can end at any moment, and processes write side by side. When all files
of a block of stops are there, they become the members of an archive, uncompressed and byte by byte as they were.
One member is read without the others, and `unzip` gives the files back. Samples stay files of their own: one stop
has about 40 MB.
"""

import re
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

STOPS_A_SHARD = 256  # 10 - 40 MB; a campaign with no more stops keeps a file per stop
MADE = (1980, 1, 1, 0, 0, 0)  # the time of all members: the same files make the same archive
DIGITS = 3
_STOP_FILE = re.compile(r"stop_(\d+)(.*)\.nc")
_SHARD_FILE = re.compile(r"stops_(\d+)-(\d+)(.*)\.zip")


@dataclass(frozen=True)
class Member:
    """A file in a shard."""

    shard: Path
    name: str

    def __str__(self) -> str:
        return f"{self.shard}, {self.name}"

    def is_file(self) -> bool:
        """Whether the shard is there and holds it; `ValueError` where the shard is damaged."""
        if not self.shard.is_file():
            return False
        about = self.shard.stat()
        return self.name in _names(self.shard, about.st_mtime_ns, about.st_size)

    def content(self) -> bytes:
        """Its bytes; `ValueError` where the shard is damaged, `KeyError` where it does not hold it."""
        with _opened(self.shard) as archive:
            about = archive.getinfo(self.name)
            if about.compress_type != zipfile.ZIP_STORED:  # it could unpack to any size
                raise ValueError(f"{self.shard}: {self.name} is compressed; put the shard back as it was")
            return archive.read(self.name)


Stored = Path | Member  # a record on the disk


def places(path: Path) -> Iterator[Stored]:
    """Where the file of a path can be: under its own name, or as the file of a stop in a shard."""
    yield path
    if match := _STOP_FILE.fullmatch(path.name):
        yield Member(path.with_name(shard_name(int(match[1]), match[2])), path.name)


def shard_name(stop: int, tx: str = "") -> str:
    """Name of the shard of a stop."""
    first = stop - stop % STOPS_A_SHARD
    return f"stops_{first:0{DIGITS}d}-{first + STOPS_A_SHARD - 1:0{DIGITS}d}{tx}.zip"


def stop_name(stop: int, tx: str = "") -> str:
    """Name of the file of a stop."""
    return f"stop_{stop:0{DIGITS}d}{tx}.nc"


def replaced_by(shard: Path) -> list[Path]:
    """The files of single stops, beside a shard, whose place it takes; none where it is no shard."""
    if not (match := _SHARD_FILE.fullmatch(shard.name)):
        return []
    files = (shard.with_name(stop_name(stop, match[3])) for stop in range(int(match[1]), int(match[2]) + 1))
    return [file for file in files if file.is_file()]


def blocks(n_stops: int) -> list[range]:
    """The stops of each shard of a campaign, the last one shorter; none where it is too short for shards."""
    if n_stops <= STOPS_A_SHARD:
        return []
    return [range(first, min(first + STOPS_A_SHARD, n_stops)) for first in range(0, n_stops, STOPS_A_SHARD)]


def write_shard(path: Path, files: Sequence[tuple[str, Stored]]) -> None:
    """Write an archive of files by their names."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, stored in files:
            content = stored.read_bytes() if isinstance(stored, Path) else stored.content()
            archive.writestr(zipfile.ZipInfo(name, MADE), content)


def is_whole_shard(path: Path) -> bool:
    """Whether a file is a shard, and all members are as they were written."""
    if not _SHARD_FILE.fullmatch(path.name):
        return False
    try:
        with _opened(path) as archive:
            return archive.testzip() is None
    except ValueError:
        return False


@lru_cache(maxsize=16)
def _names(shard: Path, *_written: int) -> frozenset[str]:
    """Names of the members of a shard; `_written` changes when it is written again."""
    with _opened(shard) as archive:
        return frozenset(archive.namelist())


@contextmanager
def _opened(shard: Path) -> Iterator[zipfile.ZipFile]:
    try:
        with zipfile.ZipFile(shard) as archive:
            yield archive
    except (zipfile.BadZipFile, OSError) as error:
        verb = "generate" if shard.parent.name == "truth" else "estimate"
        raise ValueError(f"{shard}: damaged ({error}); remove it and run 'arena {verb}' again") from error
