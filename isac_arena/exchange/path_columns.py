"""Columns of a table in a CSV, Parquet, MATLAB or netCDF file: arrays of one value per row, by their names."""

import subprocess
import sys
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyarrow.csv import read_csv
from scipy.io import netcdf_file

from isac_arena.exchange.mat import read_variables
from scenes.inputs import check_input, read_input
from scenes.memory import MemoryLimitError, ask_memory

Columns = dict[str, NDArray[Any]]
HELD_PER_BYTE = 12  # of a text while it is read
LONGEST_HDF5_S = 120.0  # to read an HDF5 file: damaged ones can hang
HDF5 = b"\x89HDF\r\n\x1a\n"
READ_HDF5 = (
    "import sys; sys.path[:] = {path!r}; from isac_arena.campaign.netcdf import send_columns; "
    "send_columns({file!r}, {limit!r})"
)


def read_columns(file: Path) -> Columns:
    """The columns of a file, by the ending of its name.

    Raises `FileNotFoundError`; `ValueError`, one line, where the file has another format or is damaged.
    """
    reader = READERS.get(file.suffix.lower())
    if reader is None:
        raise ValueError(f"{file}: the name ends with '{file.suffix}'; it must end with {', '.join(READERS)}")
    if not file.is_file():
        raise FileNotFoundError(2, "no such file", str(file))
    try:
        return reader(file)
    except (MemoryLimitError, OSError):
        raise
    except Exception as error:  # readers raise many types of exceptions for damaged files
        words = " ".join(str(error).split()).removeprefix(f"{file}: ")
        raise ValueError(f"{file}: no table ({words[:160]})") from error


def _csv(file: Path) -> Columns:
    content = read_input(file)
    ask_memory(HELD_PER_BYTE * len(content), "its content", str(file))
    return _table(read_csv(BytesIO(content)))


def _parquet(file: Path) -> Columns:
    content = read_input(file)
    stored = pq.ParquetFile(BytesIO(content))
    about = stored.metadata
    ask_memory(HELD_PER_BYTE * max(1, about.num_rows) * max(1, about.num_columns), "its content", str(file))
    return _table(stored.read())


def _table(table: pa.Table) -> Columns:
    """Columns of Arrow; empty cells are NaN or None."""
    return {name.strip(): table[name].to_numpy() for name in table.column_names}


def _mat(file: Path) -> Columns:
    found = {}
    for name, value in read_variables(file).items():
        if value.dtype.kind in "fiub" and value.size == max(value.shape, default=0):
            found[name] = value.ravel()
        elif value.dtype.kind == "U":  # a char matrix has a text per row
            found[name] = np.char.strip(value.ravel())
        elif value.dtype == object and value.size == max(value.shape, default=0):  # cells of texts
            found[name] = np.array([str(np.squeeze(one)) if np.size(one) else "" for one in value.ravel()])
    return found


def _npz(file: Path) -> Columns:
    check_input(file)
    with np.load(file, allow_pickle=False) as stored:
        found = {name: np.atleast_1d(stored[name]) for name in stored.files}
    return {name: value for name, value in found.items() if value.ndim == 1}


def _netcdf(file: Path) -> Columns:
    content = read_input(file, None)
    if not content.startswith(HDF5):
        with netcdf_file(BytesIO(content), mmap=False) as stored:
            return {
                name: np.array(one[:], one[:].dtype.newbyteorder("="))
                for name, one in stored.variables.items()
                if len(one.shape) == 1
            }
    check_input(file)
    from scenes.memory import memory_limit_bytes  # noqa: PLC0415

    code = READ_HDF5.format(path=sys.path, file=str(file.resolve()), limit=f"{memory_limit_bytes():.0f}B")
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, check=False, timeout=LONGEST_HDF5_S
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"reading takes longer than {LONGEST_HDF5_S:g} s") from None
    if done.returncode:
        lines = done.stderr.decode("utf-8", "replace").splitlines() or [f"exit code {done.returncode}"]
        raise ValueError(lines[-1].rpartition("Error: ")[2])
    with np.load(BytesIO(done.stdout), allow_pickle=False) as found:
        return {name: found[name] for name in found.files}


READERS: dict[str, Callable[[Path], Columns]] = {
    ".csv": _csv, ".parquet": _parquet, ".mat": _mat, ".nc": _netcdf, ".h5": _netcdf, ".npz": _npz,
}  # fmt: skip
