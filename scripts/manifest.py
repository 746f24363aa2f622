"""The manifest of a directory: a hash of every file in it, and what made them.

`manifest.json` is written last, when a run ends. It tells damaged and edited files from those a run wrote, and
which code, libraries and machine made each: several where a run was resumed elsewhere.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_info

from estimation.fingerprint import code_digest
from sim.store import write_text

MANIFEST = "manifest.json"
LIBRARIES = ("numpy", "scipy", "numba", "scikit-learn", "shapely", "trimesh", "sionna-rt", "h5py", "pydantic")
PARTIAL = ".part"


@dataclass(frozen=True)
class FileCheck:
    """How the files of a directory compare with its manifest; names relative to the directory."""

    n_files: int
    missing: tuple[str, ...]
    changed: tuple[str, ...]
    unknown: tuple[str, ...]  # there, and not in the manifest

    @property
    def problems(self) -> list[str]:
        """One line per file that is not as it was written; others may have been added since."""
        return [
            *(f"{name}: missing" for name in self.missing),
            *(f"{name}: damaged or edited since it was written" for name in self.changed),
        ]


def made_by() -> dict[str, Any]:
    """What results depend on beside their settings: code, versions of the libraries, machine."""
    return {**_software(), "threads": max((pool["num_threads"] for pool in threadpool_info()), default=1)}


@cache
def _software() -> dict[str, Any]:
    return {
        "code": code_digest("scenes", "sim", "estimation", "scripts"),
        "python": platform.python_version(),
        "libraries": {name: _version(name) for name in LIBRARIES},
        "machine": {"system": platform.system(), "processor": _processor()},
    }


def write_manifest(directory: Path) -> None:
    """Write the manifest over all files of a directory as they are.

    Files whose size and time of change are those of the manifest before keep their entry: bytes that changed
    unnoticed since stay noticeable.
    """
    held = read_manifest(directory) if (directory / MANIFEST).is_file() else {"made_by": [], "files": {}}
    origins, known, here = held["made_by"], held["files"], made_by()
    if here not in origins:
        origins = [*origins, here]
    files = {}
    for name in _files(directory):
        status = (directory / name).stat()
        entry = known.get(name)
        if entry is None or (entry["bytes"], entry["changed_ns"]) != (status.st_size, status.st_mtime_ns):
            entry = {
                "sha256": file_digest(directory / name),
                "bytes": status.st_size,
                "changed_ns": status.st_mtime_ns,
                "made_by": origins.index(here),
            }
        files[name] = entry
    used = sorted({entry["made_by"] for entry in files.values()})
    for entry in files.values():
        entry["made_by"] = used.index(entry["made_by"])
    content = {"made_by": [origins[index] for index in used], "files": files}
    write_text(directory / MANIFEST, json.dumps(content, indent=1) + "\n")


def read_manifest(directory: Path) -> dict[str, Any]:
    """The manifest of a directory.

    Raises `ValueError`, one line, where there is none or it cannot be read.
    """
    file = directory / MANIFEST
    if not file.is_file():
        raise ValueError(f"{file}: missing; a run of 'arena run' or 'arena sweep' ends with writing it")
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        entries = content["files"].values()
        if not all({"sha256", "bytes", "changed_ns"} <= set(entry) for entry in entries):
            raise ValueError("an entry lacks a field")
        origins = content["made_by"]
        _ = [origins[entry["made_by"]]["machine"]["processor"] for entry in entries]
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{file}: damaged ({reason}); remove it and run the same command again") from error
    return content  # type: ignore[no-any-return]


def check_files(directory: Path) -> FileCheck:
    """Hash every file of a directory and compare with its manifest; raises as `read_manifest`."""
    entries = read_manifest(directory)["files"]
    here = set(_files(directory))
    changed = [
        name
        for name in sorted(here & set(entries))
        if file_digest(directory / name) != entries[name]["sha256"]
    ]
    return FileCheck(
        len(entries), tuple(sorted(set(entries) - here)), tuple(changed), tuple(sorted(here - set(entries)))
    )


def file_digest(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _files(directory: Path) -> Iterator[str]:
    """Names of all files below a directory but its manifest and unfinished ones, in order."""
    for folder, folders, names in os.walk(directory):
        folders[:] = sorted(name for name in folders if not name.endswith(PARTIAL))
        for name in sorted(names):
            path = Path(folder, name)
            if not name.endswith(PARTIAL) and path != directory / MANIFEST:
                yield path.relative_to(directory).as_posix()


def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    """The model of the processor: last digits depend on the instructions that it has."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        text = ""
    models = [line.partition(":")[2].strip() for line in text.splitlines() if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()
