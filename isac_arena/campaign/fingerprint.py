"""Fingerprints of what results depend on: settings, data and the code that made them."""

from __future__ import annotations

import hashlib
import importlib.util
from functools import cache
from pathlib import Path


def digest(*parts: str) -> str:
    """Hash of texts in their order: 16 hexadecimal digits of SHA-256."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


@cache
def code_digest(*parts: str) -> str:
    """Hash of the source of files and packages of this project, named by their path; read once per process.

    Raises
    ------
    ValueError
        As `source_digest` does.
    """
    return source_digest(Path(__file__).resolve().parents[2], *parts)


def source_digest(root: Path, *parts: str) -> str:
    """Hash of the Python files that `parts` name, files or folders under `root`: relative names and contents.

    Raises
    ------
    ValueError
        Where a part does not exist, or is a folder without Python files; the message names it. A hash of nothing
        would stay the same when the code changes.
    """
    files = [file for part in parts for file in _python_files(root, part)]
    texts = ((file.relative_to(root).as_posix(), _text(file)) for file in files)
    return digest(*(item for pair in texts for item in pair))


def _python_files(root: Path, part: str) -> list[Path]:
    path = root / part
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise ValueError(f"{part}: no such file or folder, its source has no fingerprint")
    files = sorted(path.rglob("*.py"))
    if not files:
        raise ValueError(f"{part}: a folder without Python files, its source has no fingerprint")
    return files


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8", errors="replace")


def estimator_source(estimator: str | None) -> str:
    """Hash of the source of the top-level module or package that a user's estimator is in; empty where unknown."""
    if estimator is None:
        return ""
    spec = importlib.util.find_spec(estimator.partition(":")[0].partition(".")[0])
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return ""
    origin = Path(spec.origin)
    source = origin if spec.submodule_search_locations is None else origin.parent
    return source_digest(source.parent, source.name)
