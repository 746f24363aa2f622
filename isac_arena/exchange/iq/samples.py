"""Samples of a recording: SigMF, NPZ or HDF5, contiguous or in segments with their times."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from isac_arena.exchange.path_columns import READERS, read_columns
from isac_arena.exchange.sigmf_recording import read_sigmf
from scenes.record import ComplexArray, IntArray, Record, array

TYPES = ".sigmf-meta, .npz, .h5"


@dataclass(frozen=True)
class IqRecording(Record):
    """Samples in segments; sample `first` of a segment was taken at tick `count` of the receiver's clock."""

    samples: ComplexArray = array("sample", dtype="complex64", doc="one segment after the other")
    first: IntArray = array("segment", dtype=int, doc="index of the first sample of each segment")
    count: IntArray = array("segment", dtype=int, doc="ticks of the sampling clock from the start to that sample")
    sample_rate_hz: float = array(unit="Hz", doc="nominal sampling rate; NaN where the files do not say")

    @property
    def end_tick(self) -> int:
        """Tick after the last sample."""
        return int(self.count[-1]) + len(self.samples) - int(self.first[-1])

    def windows(self, starts: IntArray, length: int) -> ComplexArray:
        """Windows (window, sample) that start at ticks of the clock; zero where nothing was recorded."""
        found = np.zeros((len(starts), length), np.complex64)
        ends = np.append(self.first[1:], len(self.samples))
        for first, end, count in zip(self.first, ends, self.count, strict=True):
            size = end - first
            for row in np.flatnonzero((starts + length > count) & (starts < count + size)):
                skip = max(0, count - starts[row])
                at = first + max(0, starts[row] - count)
                part = self.samples[at : min(end, at + length - skip)]
                found[row, skip : skip + len(part)] = part
        return found


def read_recording(files: Sequence[Path]) -> IqRecording:
    """The samples of one stop; files without times follow each other without gaps.

    Raises `FileNotFoundError`; `ValueError`, one line, where a file is damaged or holds no samples.
    """
    parts = [_read(file) for file in files]
    rates = {part.sample_rate_hz for part in parts if np.isfinite(part.sample_rate_hz)}
    if len(rates) > 1:
        raise ValueError(
            f"{files[0]}: the files of a stop have sampling rates of {sorted(rates)} Hz; one is needed"
        )
    first, count, at, tick = [], [], 0, 0
    for part in parts:
        later = tick if part.count[0] == 0 else 0  # a file without times goes on where the last one ended
        first.append(part.first + at)
        count.append(part.count + later)
        at, tick = at + len(part.samples), later + part.end_tick
    counts = np.concatenate(count)
    if np.any(np.diff(counts) <= 0):
        raise ValueError(f"{files[0]}: segments must follow each other in time")
    samples = np.concatenate([part.samples for part in parts])
    return IqRecording(samples, np.concatenate(first), counts, rates.pop() if rates else np.nan)


def _read(file: Path) -> IqRecording:
    if file.suffix == ".sigmf-meta":
        return _sigmf(file)
    if file.suffix not in (".npz", *READERS):
        raise ValueError(f"{file}: the name ends with '{file.suffix}'; it must end with {TYPES}")
    columns = read_columns(file)
    if "samples_real" in columns and "samples_imag" in columns:
        columns["samples"] = columns["samples_real"] + 1j * columns["samples_imag"]
    if "samples" not in columns:
        raise ValueError(f"{file}: holds no `samples` (sample,), nor samples_real and samples_imag")
    if ("first" in columns) != ("count" in columns):
        raise ValueError(f"{file}: first, count: segments need both, or none of them")
    rate = columns.get("sample_rate_hz", np.array([np.nan]))
    return _checked(file, columns["samples"], columns.get("first"), columns.get("count"), float(np.ravel(rate)[0]))


def _sigmf(file: Path) -> IqRecording:
    samples, about = read_sigmf(file.with_suffix(""))
    try:
        rate = float(about["global"].get("core:sample_rate", np.nan))
        captures = about.get("captures") or [{"core:sample_start": 0}]
        first = [int(one["core:sample_start"]) for one in captures]
        count = [int(one["core:global_index"]) for one in captures if "core:global_index" in one]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"{file}: not readable SigMF metadata ({error})") from error
    if len(count) < len(first):  # without times: one after the other
        return _checked(file, samples, None, None, rate)
    return _checked(file, samples, first, [one - count[0] for one in count], rate)


def _checked(file: Path, samples: Any, first: Any, count: Any, rate: float) -> IqRecording:
    try:
        samples = np.asarray(samples, np.complex64)
        first = np.zeros(1, int) if first is None else np.asarray(first, int)
        count = np.zeros(1, int) if count is None else np.asarray(count, int)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{file}: samples, first, count: must be numbers") from error
    if not len(samples) or not np.isfinite(samples.view(np.float32)).all():
        raise ValueError(f"{file}: samples: must be there and finite")
    if first.shape != count.shape or first[0] != 0 or np.any(np.diff(first) <= 0) or first[-1] >= len(samples):
        raise ValueError(f"{file}: first: must ascend from 0 within {len(samples)} samples, one for each count")
    return IqRecording(samples, first, count, rate)
