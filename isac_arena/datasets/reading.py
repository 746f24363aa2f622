"""Read a data set: by number, as a map; or shard after shard, as a shuffled stream.

Both have the interface of PyTorch's data sets, and torch is not imported: a `DataLoader` takes a `Dataset` as it
is. It takes `Dataset.stream(...)` as an iterable data set where torch was imported before; each of its workers
then reads shards of its own.
"""

from __future__ import annotations

import json
import os
import sys
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isac_arena.datasets.config import FORMAT, Split
from isac_arena.datasets.samples import Arrays
from isac_arena.datasets.shards import array_at, read_array, read_index

OPEN_FILES = 64


def open_dataset(directory: str | Path, split: Split = "train", fields: Sequence[str] | None = None) -> Dataset:
    """The stops of a split of a data set, with all fields or some.

    Raises `ValueError` where the directory holds no data set, or the split or a field is not in it.
    """
    folder = Path(directory)
    try:
        about = json.loads((folder / "dataset.json").read_text(encoding="utf-8"))
        shards, known = about["shards"], about["fields"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{folder}: holds no data set ({error}); make one with 'arena dataset'") from error
    if about["format"] != FORMAT:
        raise ValueError(f"{folder}: format {about['format']}, this version reads {FORMAT}")
    if split not in shards:
        raise ValueError(f"split = '{split}': must be one of {', '.join(shards)}")
    unknown = [field for field in fields or () if field not in known]
    if unknown:
        raise ValueError(f"fields = '{unknown[0]}': must be among {', '.join(known)}")
    return Dataset([folder / name for name in shards[split]], list(fields or known), known)


class Dataset:
    """A map from numbers to stops: each is a dict of its key and of an array per field."""

    def __init__(self, shards: Sequence[Path], fields: Sequence[str], about: dict[str, str]) -> None:
        self.shards, self.fields, self.about = list(shards), list(fields), about
        self._samples = [read_index(shard)["samples"] for shard in self.shards]
        self._ends = list(accumulate(map(len, self._samples)))

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, number: int) -> dict[str, Any]:
        if not -len(self) <= number < len(self):
            raise IndexError(f"number = {number}: the data set has {len(self)} stops")
        number %= len(self)
        shard = bisect_right(self._ends, number)
        sample = self._samples[shard][number - self._ends[shard]]  # counted from the end
        handle = _handle(self.shards[shard], os.getpid())
        arrays = {field: read_array(handle, sample["fields"][field]) for field in self.fields}
        return {"key": sample["key"], **arrays}

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (self[number] for number in range(len(self)))

    def stream(self, *, shuffle: int | None = None, mixed: int = 2) -> SampleStream:
        """All stops, a shard read at once; with `shuffle` (a seed) in random order among `mixed` shards."""
        return stream_type()(self, shuffle, mixed)

    def __repr__(self) -> str:
        return f"Dataset({len(self)} stops in {len(self.shards)} shards: {', '.join(self.fields)})"


class SampleStream:
    """The stops of a data set in the order of its shards, or shuffled; every pass has another order.

    Workers of a loader are copies of this object, which all begin with pass 0: the loader's own seed, which is
    new in each of its passes, then tells the passes apart. `torch.manual_seed` fixes it.
    """

    def __init__(self, dataset: Dataset, shuffle: int | None, mixed: int) -> None:
        self.dataset, self.shuffle, self.mixed = dataset, shuffle, mixed
        self.passes = 0

    def __len__(self) -> int:
        return len(self.dataset)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        worker, n_workers, loader_seed = loader_worker()
        seeds = [self.shuffle or 0, self.passes, loader_seed]
        rng = None if self.shuffle is None else np.random.default_rng(seeds)
        self.passes += 1
        return self.part(worker, n_workers, rng)

    def part(self, worker: int, n_workers: int, rng: np.random.Generator | None) -> Iterator[dict[str, Any]]:
        """The stops of the shards of one of several workers, which all have the same generator."""
        shards = np.arange(len(self.dataset.shards))
        shards = shards if rng is None else rng.permutation(shards)
        mine = shards[worker::n_workers].tolist()
        size = 1 if rng is None else self.mixed
        for start in range(0, len(mine), size):
            held = [(self._content(shard), self.dataset._samples[shard]) for shard in mine[start : start + size]]
            places = [(content, sample) for content, samples in held for sample in samples]
            order = range(len(places)) if rng is None else rng.permutation(len(places)).tolist()
            for place in order:
                content, sample = places[place]
                yield {"key": sample["key"], **self._arrays(content, sample)}

    def _arrays(self, content: NDArray[np.uint8], sample: dict[str, Any]) -> Arrays:
        return {field: array_at(content, sample["fields"][field]) for field in self.dataset.fields}

    def _content(self, shard: int) -> NDArray[np.uint8]:
        return np.fromfile(self.dataset.shards[shard], np.uint8)


def stream_type() -> type[SampleStream]:
    """`SampleStream`, which torch takes as an iterable data set where it was imported."""
    torch = sys.modules.get("torch")
    if torch is None:
        return SampleStream
    return type("TorchSampleStream", (SampleStream, torch.utils.data.IterableDataset), {"__module__": __name__})


def loader_worker() -> tuple[int, int, int]:
    """The number of this worker of torch's loader, how many there are, and the seed that all of them share."""
    torch = sys.modules.get("torch")
    info = None if torch is None else torch.utils.data.get_worker_info()
    return (0, 1, 0) if info is None else (info.id, info.num_workers, info.seed - info.id)


@lru_cache(maxsize=OPEN_FILES)
def _handle(shard: Path, process: int) -> int:
    """A file that is open in this process; descriptors that fall out of the cache are closed with the process."""
    del process
    return os.open(shard, os.O_RDONLY)
