"""Beam weights from a file: one row of complex weights per beam."""

import hashlib
import zipfile
from pathlib import Path

import numpy as np

from scenes.inputs import LARGEST_TEXT, check_input, read_input
from scenes.memory import MemoryLimitError
from scenes.record import ComplexArray


def read_weights(path: str | Path) -> ComplexArray:
    """Weights (beam, element) of a .npz file with an array `weights`, or a .csv file of numbers like 0.5-0.25j.

    Raises `FileNotFoundError` if the file is missing; `ValueError` if it has another type, is damaged, or holds
    no weights.
    """
    path = Path(path)
    if path.suffix not in (".npz", ".csv"):
        raise ValueError(f"weights_file = {path}: must end in .npz or .csv")
    try:
        check_input(path)
        weights = _npz(path) if path.suffix == ".npz" else _csv(path)
    except MemoryLimitError as error:
        raise MemoryLimitError(f"weights_file = {error}") from error
    except FileNotFoundError:
        raise FileNotFoundError(f"weights_file = {path}: no such file") from None
    except (OSError, KeyError, ValueError, EOFError, NotImplementedError, zipfile.BadZipFile) as error:
        raise ValueError(f"weights_file = {path}: not readable as complex weights ({error})") from error
    if weights.ndim != 2 or not weights.size:
        raise ValueError(f"weights_file = {path}: shape {weights.shape}, needed is (beam, element)")
    return weights


def weights_digest(path: str | Path) -> str:
    """Checksum of the contents of a weights file, independent of its name. Raises `OSError` if unreadable."""
    return hashlib.sha256(read_input(path)).hexdigest()


def _npz(path: Path) -> ComplexArray:
    with np.load(path, allow_pickle=False) as arrays:
        return np.asarray(arrays["weights"], complex)


def _csv(path: Path) -> ComplexArray:
    lines = [line for line in read_input(path, LARGEST_TEXT).decode("utf-8").splitlines() if line.strip()]
    return np.array([[complex(cell.replace(" ", "")) for cell in line.split(",")] for line in lines], complex)
