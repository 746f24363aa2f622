"""Whether a file can be trusted: three questions, and the hash that answers each.

- Is the file whole? Its seal: a SHA-256 of its own bytes, at the end of a record (`add_seal`) and as an entry of a
  manifest (`manifest_seal`). Every reader checks it first: damaged bytes could change values or make HDF5 hang.
  It needs no other file, so it also shows which files of a killed run are whole.
- Is the file still as a run wrote it, and what made it? The manifest of its directory: `file_digest` of every file
  as written, with code, libraries and machine. `arena verify` checks all files, every command those that it reads.
  `manifest.py` reads and checks, `recording.py` writes.
- Would the same settings and code make it again? Its fingerprint: `digest` of settings, scene and source
  (`code_digest`), an attribute of a record. A record with another fingerprint counts as missing.
"""

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from scenes.inputs import read_input

SEAL = b"sha256 "
SEAL_BYTES = len(SEAL) + 64


def add_seal(content: bytes) -> bytes:
    """The bytes of a file, then their seal."""
    return content + _seal(content)


def is_sealed(path: Path) -> bool:
    """Whether a file is, byte by byte, as `add_seal` made it; `OSError` where it cannot be read."""
    return has_seal(read_input(path))


def has_seal(content: bytes) -> bool:
    """Whether the bytes of a file are as `add_seal` made them."""
    whole = memoryview(content)
    return whole[-SEAL_BYTES:] == _seal(whole[:-SEAL_BYTES])


def _seal(content: bytes | memoryview) -> bytes:
    return SEAL + hashlib.sha256(content).hexdigest().encode()


def manifest_seal(content: Mapping[str, Any]) -> str:
    """SHA-256 of the content of a manifest, whatever the order and the spaces of its JSON."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def file_digest(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest(*parts: str) -> str:
    """Hash of texts in their order: 16 hexadecimal digits of SHA-256."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


@cache
def code_digest(*parts: str) -> str:
    """Hash of the source of files and packages of this project, named by their path; read once per process.

    Raises `ValueError` as `source_digest` does.
    """
    return source_digest(Path(__file__).resolve().parents[2], *parts)


def source_digest(root: Path, *parts: str) -> str:
    """Hash of the Python files that `parts` name, files or folders under `root`: relative names and contents.

    Raises `ValueError` where a part does not exist, or is a folder without Python files; the message names it. A
    hash of nothing would stay the same when the code changes.
    """
    files = [file for part in parts for file in _python_files(root, part)]
    texts = (
        (file.relative_to(root).as_posix(), file.read_text(encoding="utf-8", errors="replace")) for file in files
    )
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
