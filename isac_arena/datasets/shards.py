"""Shards: tar files as WebDataset reads them, with an index beside each.

    train-00000.tar     SCENE_STOP.FIELD.npy of every stop, SCENE.FIELD.npy of what a scene holds once
    train-00000.json    where the numbers of each array are, and their type and shape; written last

All members have the same owner and time, so the same arrays make the same bytes.
"""

import io
import json
import os
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isac_arena.campaign.files import complete_file, write_json
from isac_arena.datasets.samples import Arrays


class ShardWriter:
    """A tar file that is being written."""

    def __init__(self, file: io.BufferedIOBase) -> None:
        self._tar = tarfile.TarFile(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT)
        self._file = file

    def add(self, key: str, arrays: Arrays) -> dict[str, list[Any]]:
        """Add the arrays of a stop or a scene; returns their places by field."""
        places = {}
        for field, value in arrays.items():
            content = io.BytesIO()
            np.save(content, np.ascontiguousarray(value), allow_pickle=False)
            member = tarfile.TarInfo(f"{key}.{field}.npy")
            member.size = content.tell()
            content.seek(0)
            begin = self._file.tell()
            self._tar.addfile(member, content)
            header = tarfile.BLOCKSIZE + member.size - value.nbytes
            places[field] = [begin + header, value.dtype.str, list(value.shape)]
        return places

    def close(self) -> None:
        """Write the end of the archive."""
        self._tar.close()


def write_shard(
    path: Path, scenes: Iterator[tuple[str, tuple[Arrays, Iterator[Arrays]]]], about: dict[str, Any]
) -> None:
    """Write a shard of scenes by key, a stop at a time in memory, and then its index."""
    index: list[dict[str, Any]] = []
    with complete_file(path) as partial, partial.open("wb") as file:
        writer = ShardWriter(file)
        for key, (of_scene, stops) in scenes:
            shared = writer.add(key, of_scene)
            for stop, arrays in enumerate(stops):
                name = f"{key}_{stop:04d}"
                index.append({"key": name, "fields": shared | writer.add(name, arrays)})
        writer.close()
    write_json(path.with_suffix(".json"), {**about, "samples": index})


def read_index(path: Path) -> dict[str, Any]:
    """The index of a shard; `ValueError` where it is damaged."""
    file = path.with_suffix(".json")
    try:
        found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        _ = found["samples"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{file}: damaged index of a shard; use the same 'arena dataset' again") from error
    return found


def array_at(content: NDArray[np.uint8], place: list[Any]) -> NDArray[Any]:
    """The array at a place in the bytes of a shard, without a copy."""
    offset, kind, shape = place
    size = int(np.prod(shape, dtype=int)) * np.dtype(kind).itemsize
    return np.asarray(content[offset : offset + size].view(kind).reshape(shape))


def read_array(handle: int, place: list[Any]) -> NDArray[Any]:
    """The array at a place in an open shard; `ValueError` where the shard ends before it."""
    offset, kind, shape = place
    found: NDArray[Any] = np.empty(shape, kind)
    if os.preadv(handle, [found.reshape(-1).view(np.uint8).data], offset) != found.nbytes:
        raise ValueError("a shard is shorter than its index says")
    return found
