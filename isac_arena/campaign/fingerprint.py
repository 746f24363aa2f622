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
    """Hash of the source of files and packages of this project, named by their path; read once per process."""
    root = Path(__file__).resolve().parents[2]
    files = [file for part in parts for file in _sources(root / part)]
    return digest(*(file.read_text(encoding="utf-8") for file in files))


def _sources(path: Path) -> list[Path]:
    return [path] if path.suffix == ".py" else sorted(path.rglob("*.py"))


def estimator_source(estimator: str | None) -> str:
    """The source of the top-level package that a user's estimator stands in."""
    if estimator is None:
        return ""
    spec = importlib.util.find_spec(estimator.partition(":")[0].partition(".")[0])
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return ""
    origin = Path(spec.origin)
    files = [origin] if spec.submodule_search_locations is None else _sources(origin.parent)
    return digest(*(file.read_text(encoding="utf-8", errors="replace") for file in files))
