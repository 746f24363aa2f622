"""What the commands write is entered in the manifest of its directory, and what they read is checked against it.

A command enters the files that it writes, with the hash they are written with, and no others: a file that was
damaged meanwhile keeps the hash by which that shows. The entry of a file goes before the file is replaced, so a
command that is killed leaves no entry that is wrong.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from isac_arena.campaign.files import files_told_to
from isac_arena.campaign.lock import DirectoryHeldError, one_run
from isac_arena.campaign.manifest import (
    MANIFEST,
    Manifest,
    file_digest,
    file_names,
    made_by,
    read_manifest,
    shows_whole,
    write_manifest,
)

SETTINGS = ("campaign.json", "scene.toml", "scene_files")
MAKERS = {
    "truth": "generate",
    "sweep": "generate",
    "channel": "estimate",
    "map": "estimate",
    "provenance.nc": "score",
    "scores.json": "score",
}  # by the folder or the file
PASSING = "signals"  # a folder of a sweep whose files go when they were used


class Recording:
    """The manifest of a directory while files are written there."""

    def __init__(self, directory: Path, *, is_run: bool) -> None:
        self._directory, self._root, self._is_run = directory, directory.resolve(), is_run
        held = (
            read_manifest(directory) if (directory / MANIFEST).is_file() else Manifest([], {}, finished=False)
        )
        self._origins, self._files, self._finished = held.made_by, held.files, held.finished
        self._written: dict[str, dict[str, Any]] = {}

    @property
    def names(self) -> list[str]:
        """Names of the files that were entered before."""
        return list(self._files)

    def tell(self, path: Path, complete: Path | None) -> None:
        """Enter a file that is about to take its name; drop the entry of one that is about to go."""
        path = path.parent.resolve() / path.name
        if not path.is_relative_to(self._root) or path == self._root / MANIFEST:
            return
        name = path.relative_to(self._root).as_posix()
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
        """Write the manifest; that of a run with the records that a run which was killed has left as well."""
        files = {**self._files, **self._written}
        if self._is_run:
            for name in file_names(self._directory):
                path = self._directory / name
                if name not in files and Path(name).parts[0] != PASSING and shows_whole(path):
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
    recording = Recording(directory, is_run=True)
    with files_told_to(recording.tell):
        yield recording
    recording.finish()


@contextmanager
def recorded_additions(directory: Path) -> Iterator[None]:
    """Enter the files that the block adds to a directory in its manifest, where that has one.

    A run at work in the directory holds its manifest: then they are not entered.
    """
    with ExitStack() as stack:
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
        with files_told_to(recording.tell):
            yield
        recording.finish()


def check_unchanged(directory: Path, parts: Sequence[str]) -> None:
    """Refuse files, and files of folders, that are not as the manifest of their directory says.

    Raises `ValueError`, one line that names the first such file and says what to do.
    """
    if not (directory / MANIFEST).is_file():
        return
    entries = read_manifest(directory).files
    for name, entry in entries.items():
        part = next((part for part in parts if name == part or name.startswith(f"{part}/")), None)
        file = directory / name
        if part is not None and file.is_file() and file_digest(file) != entry["sha256"]:
            raise ValueError(f"{file}: damaged or edited since it was written; {remedy(name)}")


def remedy(name: str) -> str:
    """What to do about a damaged file of a campaign, by its name in the directory."""
    verb = MAKERS.get(Path(name).parts[0])
    if verb is None:
        return "put it back as it was, or run again in a new directory"
    return f"remove it and run 'arena {verb}' again"
