"""Commands enter the files that they write in the manifest of the directory, and compute with one thread.

A command enters each file with the hash of what it writes and changes no other entry. So the entry of a file that
is damaged later keeps its hash and shows the damage. An entry is removed before its file is replaced, so a killed
command leaves no wrong entry.
"""

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from isac_arena.campaign.files import notify_of_files
from isac_arena.campaign.integrity import file_digest, is_sealed
from isac_arena.campaign.lock import DirectoryHeldError, one_run
from isac_arena.campaign.manifest import (
    MANIFEST,
    PARTIAL,
    Manifest,
    file_names,
    made_by,
    read_manifest,
    write_manifest,
)
from isac_arena.campaign.shards import is_whole_shard
from isac_arena.workers.threads import one_thread

PASSING = "signals"  # a folder of a sweep whose files are removed after use


class Recording:
    """The manifest of a directory while files are written there."""

    def __init__(self, directory: Path, *, is_run: bool) -> None:
        self._directory, self._root, self._is_run = directory, directory.resolve(), is_run
        is_known = (directory / MANIFEST).is_file()
        stored = read_manifest(directory) if is_known else Manifest([], {}, finished=False)
        self._origins, self._files, self._finished = stored.made_by, stored.files, stored.finished
        self._written: dict[str, dict[str, Any]] = {}

    @property
    def names(self) -> list[str]:
        """Names of the files that were entered before."""
        return list(self._files)

    def enter(self, path: Path, complete: Path | None) -> None:
        """Enter a file that is about to take its name; drop the entry of one that is about to be removed."""
        path = path.parent.resolve() / path.name
        if not path.is_relative_to(self._root) or path == self._root / MANIFEST:
            return
        name = path.relative_to(self._root).as_posix()
        if PARTIAL in name.partition("/")[0]:  # of a side folder: it is entered when it is swapped in
            return
        self._written.pop(name, None)
        self.drop([name])
        if complete is not None:
            self._written[name] = self._entry(complete)

    def drop(self, names: Iterable[str]) -> None:
        """Drop the entries of files that are about to be made again."""
        stale = [name for name in names if self._files.pop(name, None)]
        if stale or (self._is_run and self._finished):
            self._finished = self._finished and not self._is_run
            if (self._directory / MANIFEST).is_file():
                write_manifest(self._directory, Manifest(self._origins, self._files, self._finished))

    def finish(self) -> None:
        """Write the manifest; a run also enters the whole records of a run before it that was killed."""
        files = {**self._files, **self._written}
        if self._is_run:
            for name in file_names(self._directory):
                path = self._directory / name
                if name not in files and Path(name).parts[0] != PASSING and _is_whole(path):
                    files[name] = self._entry(path)
        write_manifest(self._directory, Manifest(self._origins, files, self._is_run or self._finished))

    def _entry(self, path: Path) -> dict[str, Any]:
        here = made_by()
        if here not in self._origins:
            self._origins.append(here)
        index = self._origins.index(here)
        return {"sha256": file_digest(path), "bytes": path.stat().st_size, "made_by": index}


@contextmanager
def recorded_run(directory: Path) -> Iterator[Recording]:
    """A run that fills a directory: its manifest is written when the block ends without an error.

    Raises `ValueError`, one line, where the directory has a manifest that is damaged.
    """
    with one_thread():
        recording = Recording(directory, is_run=True)
        with notify_of_files(recording.enter):
            yield recording
        recording.finish()


@contextmanager
def recorded_additions(directory: Path) -> Iterator[None]:
    """Enter the files that the block adds to a directory in its manifest, where one exists.

    While a run works in the directory, its manifest is locked and the files are not entered.
    """
    with one_thread(), ExitStack() as stack:
        is_ours = (directory / MANIFEST).is_file()
        if is_ours:
            try:
                stack.enter_context(one_run(directory))
            except DirectoryHeldError:
                is_ours = False
        if not is_ours:
            yield
            return
        recording = Recording(directory, is_run=False)
        with notify_of_files(recording.enter):
            yield
        recording.finish()


def _is_whole(file: Path) -> bool:
    """Whether a file shows by its own seal that it is whole: a record, or a manifest."""
    if file.name == MANIFEST:
        try:
            return bool(read_manifest(file.parent).files)
        except ValueError:
            return False
    return (file.suffix == ".nc" and is_sealed(file)) or is_whole_shard(file)
