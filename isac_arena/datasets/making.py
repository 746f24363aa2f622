"""Make a data set: shards side by side on workers, each whole or not there, then what accompanies them."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np

from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.files import remove_leftovers, write_json, write_text
from isac_arena.campaign.integrity import code_digest, digest, file_digest
from isac_arena.campaign.lock import one_run
from isac_arena.datasets.config import FORMAT, DatasetConfig, Split
from isac_arena.datasets.datasheet import datasheet
from isac_arena.datasets.samples import ABOUT, campaign_config, fields_of, scene_of, stops_of
from isac_arena.datasets.shards import read_index, write_shard
from isac_arena.workers.threads import one_thread
from isac_arena.workers.workers import Workers, n_cores
from scenes.toml_config import validate_config, validate_stored

SETTINGS, CONTENTS = "dataset.json", "contents.json"
CODE = ("scenes", "sim", "estimation/channel/beam_power_map.py", "isac_arena/datasets")
SPLITS: tuple[Split, ...] = get_args(Split)


@dataclass(frozen=True)
class Shard:
    """A file of a data set and the scenes in it. Small, because it is sent to the workers."""

    directory: Path
    settings: str  # the specification as JSON
    fingerprint: str
    split: Split
    number: int
    scenes: tuple[int, ...]

    @property
    def path(self) -> Path:
        """The tar file."""
        return self.directory / f"{self.split}-{self.number:05d}.tar"

    @property
    def is_done(self) -> bool:
        """Whether file and index are there, of this specification and code."""
        try:
            return self.path.is_file() and read_index(self.path)["fingerprint"] == self.fingerprint
        except ValueError:
            return False


@dataclass(frozen=True)
class DatasetPlan:
    """The shards of a data set in a directory."""

    config: DatasetConfig
    directory: Path

    @cached_property
    def fingerprint(self) -> str:
        """Of the specification and the code that makes the arrays."""
        return digest(self.config.model_dump_json(), str(FORMAT), code_digest(*CODE))

    @cached_property
    def shards(self) -> list[Shard]:
        """All shards: the scenes of each split in order, some in each."""
        found, settings = [], self.config.model_dump_json()
        for split, scenes in scenes_by_split(self.config).items():
            size = self.config.scenes_per_shard
            for number, start in enumerate(range(0, len(scenes), size)):
                some = tuple(scenes[start : start + size])
                found.append(Shard(self.directory, settings, self.fingerprint, split, number, some))
        return found


def scenes_by_split(config: DatasetConfig) -> dict[Split, list[int]]:
    """Numbers of the scenes of each split: a scene is in one of them, drawn by the seed."""
    count = config.scenes.count
    order = np.random.default_rng([config.seed, 0]).permutation(count)
    ends = np.round(np.cumsum([0.0, *(getattr(config.splits, split) for split in SPLITS)]) * count).astype(int)
    return {split: sorted(order[ends[k] : ends[k + 1]].tolist()) for k, split in enumerate(SPLITS)}


def make_dataset(
    config: DatasetConfig,
    out: Path,
    *,
    workers: int | None = 1,
    limit_s: float | None = None,
    tell: Callable[[Shard], None] = lambda _: None,
) -> DatasetPlan:
    """Make what is missing of a data set; the same bytes for any number of workers and interruptions.

    Raises `ValueError` where the directory holds another data set, or the specification cannot be used;
    `ChildProcessError` where a shard ends its worker.
    """
    campaign_config(config)
    scene_of(config, 0)
    plan = DatasetPlan(config, out)
    with one_run(out), one_thread():
        _open(plan)
        remove_leftovers(out)
        missing = [shard for shard in plan.shards if not shard.is_done]
        n_workers = min(workers or n_cores(), max(1, len(missing)))
        if n_workers == 1:
            for shard in missing:
                make_shard(shard)
                tell(shard)
        else:
            _by_workers(missing, n_workers, limit_s, tell)
        _finish(plan)
    return plan


def make(spec: Mapping[str, Any], out: str | Path, *, workers: int = 1) -> Path:
    """A data set from the tables of a specification, as `arena dataset`; returns its directory.

    Raises as `make_dataset`, and `ConfigError` where a table is wrong.
    """
    make_dataset(validate_config(dict(spec), DatasetConfig, "spec"), Path(out), workers=workers)
    return Path(out)


def behind(directory: str | Path, key: str) -> tuple[CampaignRun, int]:
    """The simulation behind a stop of a data set by its key, and its number there: to run other methods on it.

    Raises `ValueError` where the data set was made by another version, or has no such stop.
    """
    file = Path(directory) / SETTINGS
    about = json.loads(file.read_text(encoding="utf-8"))
    config = validate_stored(about["settings"], DatasetConfig, str(file))
    if about["fingerprint"] != DatasetPlan(config, Path(directory)).fingerprint:
        raise ValueError(f"{file}: made by another version of ISAC Arena; its stops cannot be made again here")
    scene, _, stop = key.partition("_")
    if not (scene.isdecimal() and stop.isdecimal() and int(scene) < config.scenes.count):
        raise ValueError(f"key = '{key}': the data set has no such stop")
    return CampaignRun(campaign_config(config, int(scene)), scene_of(config, int(scene))), int(stop)


def make_shard(shard: Shard) -> None:
    """Make a shard, in any process and any number of times."""
    config = DatasetConfig.model_validate_json(shard.settings)
    scenes = ((f"{scene:06d}", stops_of(config, scene)) for scene in shard.scenes)
    about = {"fingerprint": shard.fingerprint, "split": shard.split}
    with one_thread():
        write_shard(shard.path, scenes, about)


def _by_workers(
    missing: Sequence[Shard], n_workers: int, limit_s: float | None, tell: Callable[[Shard], None]
) -> None:
    from isac_arena.workers.tasks import STOP_LIMIT_S, WorkerDiedError, each_outcome  # noqa: PLC0415  (imports dask)

    longest = max(len(shard.scenes) for shard in missing)
    stops = DatasetConfig.model_validate_json(missing[0].settings).scenes.n_stops
    with Workers(n_workers, None) as workers:
        limit = (limit_s or STOP_LIMIT_S) * longest * stops
        for shard, found in each_outcome(workers.client, n_workers, make_shard, missing, limit):
            if isinstance(found, WorkerDiedError):
                raise ChildProcessError(f"{shard.path.name}: its worker died each time; the other shards stay")
            if isinstance(found, BaseException):
                raise found
            tell(shard)


def _open(plan: DatasetPlan) -> None:
    """Use a directory for a new data set, or continue one; `ValueError` where it holds something else."""
    file = plan.directory / SETTINGS
    if file.is_file():
        held = json.loads(file.read_text(encoding="utf-8")).get("fingerprint")
        if held != plan.fingerprint:
            what = "holds a data set of another specification or version"
            raise ValueError(f"--out = {plan.directory}: {what}; choose another directory")
        return
    others = [one.name for one in plan.directory.iterdir() if not one.name.startswith(".")]
    if others:
        raise ValueError(f"--out = {plan.directory}: holds other files ({others[0]}); choose an empty directory")
    fields = {field: ABOUT[field] for field in fields_of(plan.config)}
    shards: dict[str, list[str]] = {split: [] for split in SPLITS}
    for shard in plan.shards:
        shards[shard.split].append(shard.path.name)
    about = {"format": FORMAT, "fingerprint": plan.fingerprint, "fields": fields, "shards": shards}
    write_json(file, {**about, "settings": plan.config.model_dump(mode="json")})


def _finish(plan: DatasetPlan) -> None:
    """Write checksums, counts and the datasheet."""
    counts: dict[str, Any] = {split: {"scenes": 0, "stops": 0, "bytes": 0} for split in SPLITS}
    lines = []
    for shard in plan.shards:
        entry = counts[shard.split]
        entry["scenes"] += len(shard.scenes)
        entry["stops"] += len(read_index(shard.path)["samples"])
        entry["bytes"] += shard.path.stat().st_size
        for file in (shard.path, shard.path.with_suffix(".json")):
            lines.append(f"{file_digest(file)}  {file.name}\n")
    write_json(plan.directory / CONTENTS, counts)
    write_text(plan.directory / "DATASHEET.md", datasheet(plan.config, counts))
    write_text(plan.directory / "LICENCE", f"{plan.config.name} is published under {plan.config.licence}.\n")
    write_text(plan.directory / "SHA256SUMS", "".join(lines))
