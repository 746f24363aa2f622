"""A command that works over a finished run writes beside it, and its files are swapped in when all are there.

A failed or killed command leaves the run as it was. The side folder is named after the fingerprint of all results,
so the same command continues in it after it was interrupted, and no other command uses it.
"""

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from isac_arena.campaign.directory import RESULTS, CampaignStore
from isac_arena.campaign.files import remove_file, take_over
from isac_arena.campaign.integrity import file_digest
from isac_arena.campaign.manifest import MANIFEST, PARTIAL, read_manifest
from isac_arena.campaign.shards import replaced_by


@contextmanager
def swapped_in(store: CampaignStore) -> Iterator[CampaignStore]:
    """The store to work with: beside the directory where a run has finished there, else in it."""
    with side_folder(store.directory, store.score_fingerprint) as side:
        yield replace(store, side=side)


@contextmanager
def side_folder(directory: Path, fingerprint: str) -> Iterator[Path | None]:
    """The folder to write to where a run has finished in a directory, whose files are then swapped in; else None.

    After an error the side folder is removed, except after one of the disk or an interruption.
    """
    if not (directory / MANIFEST).is_file():
        yield None
        return
    side = directory / f".{fingerprint}{PARTIAL}"
    for old in directory.glob(f".*{PARTIAL}"):
        if re.fullmatch(r"\.[0-9a-f]{16}\.part", old.name) and old != side:
            shutil.rmtree(old, ignore_errors=True)
    try:
        yield side
    except OSError:
        raise
    except Exception:
        shutil.rmtree(side, ignore_errors=True)
        raise
    _swap_in(side, directory)


def _swap_in(side: Path, directory: Path) -> None:
    """Move all files of the side folder to their places, after what they make stale is removed.

    Records that came out as they were, because they had been lost, make nothing stale. A command that is killed
    meanwhile finds the rest in the side folder.
    """
    files = {file.relative_to(side).as_posix(): file for file in sorted(side.rglob("*")) if file.is_file()}
    settings = directory / "campaign.json"
    is_other = settings.name in files and files[settings.name].read_bytes() != settings.read_bytes()
    before = read_manifest(directory).files
    is_new = any(
        name.endswith((".nc", ".zip")) and before.get(name, {}).get("sha256") != file_digest(file)
        for name, file in files.items()
    )
    stale = [name for name in RESULTS if is_other or is_new]
    if "report.html" in files:
        stale += [f"figures/{old.name}" for old in sorted((directory / "figures").glob("*.png"))]
    for name in stale:
        if name not in files:
            remove_file(directory / name)
    for name, file in files.items():
        take_over(file, directory / name)
        for single in replaced_by(directory / name):
            remove_file(single)
    shutil.rmtree(side, ignore_errors=True)
