"""The directory of a sweep beside its cases: what it is a sweep of, and which cases failed.

sweep.json          the resolved sweep and its base campaign
failures/KEY.json   the error of a case; dropped when it is tried again
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from scripts.sweep_config import SweepConfig
from sim.store import remove_leftovers, write_text


def open_sweep(directory: Path, config: SweepConfig, base_text: str) -> None:
    """Claim a directory for a sweep, or go on with the sweep that is there.

    Raises `ValueError` where the directory holds another sweep or other files.
    """
    content = json.dumps({"sweep": config.model_dump(mode="json"), "base": base_text}, indent=1) + "\n"
    settings = directory / "sweep.json"
    if settings.is_file():
        if settings.read_text(encoding="utf-8") != content:
            raise ValueError(
                f"--out = {directory}: holds a sweep with other settings; choose another directory"
            )
    elif directory.is_dir() and any(not entry.name.endswith(".part") for entry in directory.iterdir()):
        raise ValueError(f"--out = {directory}: holds other files; choose an empty or a new directory")
    write_text(settings, content)
    for folder in (directory, directory / "failures"):
        remove_leftovers(folder)


def read_failures(directory: Path) -> dict[str, str]:
    """The errors of the failed cases, one line each, by the key of the case."""
    return {
        file.stem: json.loads(file.read_text(encoding="utf-8"))["error"]
        for file in sorted((directory / "failures").glob("*.json"))
    }


def write_failure(directory: Path, key: str, error: BaseException) -> None:
    """Record that a case failed and why."""
    reason = " ".join(f"{type(error).__name__}: {error}".split())
    write_text(directory / "failures" / f"{key}.json", json.dumps({"error": reason}) + "\n")


def forget_failures(directory: Path, keys: Iterable[str]) -> None:
    """Drop recorded failures, so that their cases run again."""
    for key in keys:
        (directory / "failures" / f"{key}.json").unlink(missing_ok=True)
