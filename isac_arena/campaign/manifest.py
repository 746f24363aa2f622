"""The manifest of a directory: a hash of every file that a run wrote there, and what made them.

It shows which files were damaged or edited later, and which code, libraries and machine made each: several where
a run was resumed elsewhere. `recording.py` writes it, `integrity.py` explains the hashes. An inner directory with
its own manifest, such as a case of a sweep, is a unit: the outer manifest lists only the inner manifest.
"""

import json
import os
import platform
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_info

from isac_arena.campaign.files import write_json
from isac_arena.campaign.integrity import code_digest, file_digest, manifest_seal
from scenes.inputs import read_input
from scenes.names import path_in, refuse_outer_links

MANIFEST = "manifest.json"
LIBRARIES = ("numpy", "scipy", "numba", "scikit-learn", "shapely", "trimesh", "sionna-rt", "h5py", "pydantic")
PARTIAL = ".part"
SETTINGS = ("campaign.json", "scene.toml", "scene_files")
MAKERS = {  # command that makes a folder or a file
    "truth": "generate", "sweep": "generate", "channel": "estimate", "map": "estimate",
    "provenance.nc": "score", "scores.json": "score",
}  # fmt: skip


@dataclass(frozen=True)
class Manifest:
    """What made the files of a directory, and the entry of each: `sha256`, `bytes` and `made_by`, an index."""

    made_by: list[dict[str, Any]]
    files: dict[str, dict[str, Any]]  # by the name relative to the directory
    finished: bool  # False while a run changes the files, and where it was killed


@dataclass(frozen=True)
class FileCheck:
    """How the files of a directory compare with its manifest; names relative to the directory."""

    n_files: int
    missing: tuple[str, ...]
    changed: tuple[str, ...]
    unknown: tuple[str, ...]  # in the directory, but in no manifest
    unfinished: tuple[str, ...]  # manifests of runs that did not end
    made_by: tuple[dict[str, Any], ...]

    @property
    def problems(self) -> list[str]:
        """One line per file that is not as it was written; unknown files are no problem."""
        return [
            *(f"{name}: a run here did not end; run the same command again" for name in self.unfinished),
            *(f"{name}: missing" for name in self.missing),
            *(f"{name}: damaged or edited since it was written" for name in self.changed),
        ]


def made_by() -> dict[str, Any]:
    """What results depend on beside their settings: code, library versions, machine, number of threads."""
    return {**_software(), "threads": max((pool["num_threads"] for pool in threadpool_info()), default=1)}


@cache
def _software() -> dict[str, Any]:
    return {
        "code": code_digest("scenes", "sim", "estimation", "isac_arena"),
        "python": platform.python_version(),
        "libraries": {name: _version(name) for name in LIBRARIES},
        "machine": {"system": platform.system(), "processor": _processor()},
    }


def write_manifest(directory: Path, manifest: Manifest) -> None:
    """Write a sealed manifest, without the entries of `made_by` that no file refers to."""
    used = sorted({entry["made_by"] for entry in manifest.files.values()})
    content = {
        "made_by": [manifest.made_by[index] for index in used],
        "finished": manifest.finished,
        "files": {
            name: {**entry, "made_by": used.index(entry["made_by"])}
            for name, entry in sorted(manifest.files.items())
        },
    }
    write_json(directory / MANIFEST, {**content, "seal": manifest_seal(content)})


def read_manifest(directory: Path) -> Manifest:
    """The manifest of a directory.

    Raises `ValueError`, one line, where there is none, or it is not as it was written.
    """
    file = directory / MANIFEST
    if not file.is_file():
        raise ValueError(f"{file}: missing; a finished run writes it: run the same command again")
    try:
        content = json.loads(read_input(file))
        seal, manifest = content.pop("seal"), Manifest(**content)
        for name, entry in manifest.files.items():
            path_in(directory, name)
            _ = entry["sha256"], manifest.made_by[entry["made_by"]]["code"]
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{file}: damaged ({reason}); remove it and run the same command again") from error
    if seal != manifest_seal(content):
        what = "damaged or edited since it was written"
        raise ValueError(f"{file}: {what}; remove it and run the same command again")
    return manifest


def check_files(directory: Path) -> FileCheck:
    """Hash every file of a directory and of the units in it and compare with the manifests.

    Raises as `read_manifest`, and where a link leads out of the directory.
    """
    refuse_outer_links(directory)
    manifest = read_manifest(directory)
    entries, here = manifest.files, set(file_names(directory))
    changed = set(_changed(directory, manifest, here))
    units = sorted(Path(name).parent for name in here - changed if name.endswith(f"/{MANIFEST}"))
    found = FileCheck(
        n_files=len(entries),
        missing=tuple(sorted(set(entries) - here)),
        changed=tuple(sorted(changed)),
        unknown=tuple(sorted(name for name in here - set(entries) if Path(name).parent not in units)),
        unfinished=() if manifest.finished else (MANIFEST,),
        made_by=tuple(manifest.made_by),
    )
    for unit in units:
        found = _with_unit(found, unit, check_files(directory / unit))
    return found


def _with_unit(found: FileCheck, unit: Path, inner: FileCheck) -> FileCheck:
    """The findings of a directory and of a unit in it."""
    lists = {
        name: getattr(found, name) + tuple((unit / one).as_posix() for one in getattr(inner, name))
        for name in ("missing", "changed", "unknown", "unfinished")
    }
    origins = tuple(origin for origin in inner.made_by if origin not in found.made_by)
    return FileCheck(found.n_files + inner.n_files, **lists, made_by=found.made_by + origins)


def check_unchanged(directory: Path, parts: Sequence[str]) -> None:
    """Compare files, and the files of folders, with the manifest of their directory.

    Raises `ValueError`, one line that names the first file that differs and says what to do, or a link that leads
    out of the directory.
    """
    refuse_outer_links(directory)
    if not (directory / MANIFEST).is_file():
        return
    manifest, folders = read_manifest(directory), tuple(f"{part}/" for part in parts)
    reads = {name for name in manifest.files if name in parts or name.startswith(folders)}
    for name in _changed(directory, manifest, {name for name in reads if (directory / name).is_file()}):
        raise ValueError(f"{directory / name}: damaged or edited since it was written; {remedy(name)}")


def remedy(name: str) -> str:
    """What to do about a damaged file of a campaign, by its name in the directory."""
    verb = MAKERS.get(Path(name).parts[0])
    if verb is None:
        return "put it back as it was, or run again in a new directory"
    return f"remove it and run 'arena {verb}' again"


def _changed(directory: Path, manifest: Manifest, names: Set[str]) -> Iterator[str]:
    """Those of some existing files that have another hash than their entry in the manifest."""
    for name, entry in manifest.files.items():
        if name in names and file_digest(directory / name) != entry["sha256"]:
            yield name


def file_names(directory: Path) -> Iterator[str]:
    """Names of all files below a directory but its manifest and unfinished ones; of a unit its manifest alone."""
    for folder, folders, names in os.walk(directory):
        here = Path(folder)
        is_unit = here != directory and MANIFEST in names
        folders[:] = [] if is_unit else sorted(name for name in folders if not name.endswith(PARTIAL))
        for name in [MANIFEST] if is_unit else sorted(names):
            if not name.endswith(PARTIAL) and here / name != directory / MANIFEST:
                yield (here / name).relative_to(directory).as_posix()


def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    """The model of the processor: the last digits of results depend on its instruction set."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        text = ""
    models = [line.partition(":")[2].strip() for line in text.splitlines() if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()
