"""Data sets: cost of their files over bare generation, workers, memory, and reading beside a plain read."""

import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np
import tomli_w

from isac_arena.campaign.files import write_json
from isac_arena.datasets.config import DatasetConfig
from isac_arena.datasets.making import DatasetPlan, make_dataset, make_shard
from isac_arena.datasets.reading import Dataset, open_dataset
from isac_arena.datasets.samples import Arrays, stops_of
from isac_arena.datasets.shards import write_shard
from isac_arena.validation.measurement import Measurement, at_least, at_most
from isac_arena.workers.tasks import each_outcome
from isac_arena.workers.threads import one_thread
from isac_arena.workers.workers import Workers

ARRAY = {"rows": 1, "columns": 8, "beams_per_panel": 16}
CAMPAIGN = {
    "waveform": {"n_rb": 64, "comb": 4}, "tx_array": ARRAY,
    "rx_array": ARRAY | {"panel_azimuth_deg": [0.0, 180.0]},
    "propagation": {"max_bounces": 1, "diffuse_samples": 0, "diffraction": False, "compare_planar": False},
}  # fmt: skip
STOP_BYTES, STOPS_A_SHARD = 1 << 20, 64


def _config(seed: int, count: int, n_stops: int, per_shard: int) -> DatasetConfig:
    return DatasetConfig.model_validate(
        {
            "name": "bench", "seed": seed, "keep": ["cube", "paths", "poses", "occupancy"], "dtype": "float16",
            "scenes": {"count": count, "n_stops": n_stops, "difficulty": [0.0, 0.1]},
            "scenes_per_shard": per_shard, "cube_delays": 32, "campaign": CAMPAIGN,
        }
    )  # fmt: skip


def bench_making(seed: int, quick: bool) -> list[Measurement]:
    """Processor time of a data set over that of its arrays alone; two workers over one."""
    config = _config(seed, 2 if quick else 12, 10 if quick else 50, 1)
    with tempfile.TemporaryDirectory() as name, one_thread():
        _generate(_config(seed + 1, 1, 2, 1))
        runs = [
            (
                _processor_s(partial(_generate, config)),
                _processor_s(partial(make_dataset, config, Path(name, made))),
            )
            for made in ("made0", "made1")
        ]
        bare_s, made_s = np.min(runs, axis=0)
        one_s, two_s = np.min(
            [
                [_time_workers(config, Path(name, f"by{n}_{k}"), n) for n in (1, 2)]
                for k in range(1 if quick else 2)
            ],
            axis=0,
        )
    cost = f"processor time of {made_s:.1f} s, {bare_s:.1f} s for the arrays alone"
    speed = f"{one_s:.1f} s on one worker, {two_s:.1f} s on two"
    return [
        at_most("dataset.making.cost", made_s / bare_s, 1.5 if quick else 1.1, cost),
        at_least("dataset.making.two_workers", one_s / two_s, 0.5 if quick else 1.8, speed),
    ]


def bench_kills(seed: int, quick: bool) -> list[Measurement]:
    """`arena dataset` killed at ten moments and resumed: files that differ from those of a run without."""
    n_kills, n_shards = (2, 8) if quick else (10, 100)
    config, rng = _config(seed, n_shards, 4, 1), np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as name:
        spec, whole, out = (Path(name, one) for one in ("spec.toml", "whole", "killed"))
        spec.write_text(tomli_w.dumps(config.model_dump(mode="json", exclude_unset=True)), encoding="utf-8")
        _command(spec, whole).wait()
        killed = sum(_killed(_command(spec, out), out, float(rng.uniform(0.0, 0.2))) for _ in range(n_kills))
        resumed = _command(spec, out).wait() == 0
        kept, wanted = ({one.name: one.read_bytes() for one in where.iterdir()} for where in (out, whole))
    differing = sum(kept.get(file) != wanted.get(file) for file in kept.keys() | wanted.keys())
    return [
        at_least("dataset.making.kills", killed, n_kills, "of the command and its workers, each in another shard"),
        at_most("dataset.making.other_files", differing if resumed else np.nan, 0, f"of {len(wanted)}, resumed"),
    ]


def bench_memory(seed: int, quick: bool) -> list[Measurement]:
    """Largest memory of a process that makes 10,000 stops, over that after the first quarter."""
    n_shards, n_scenes, n_stops = (4, 1, 10) if quick else (20, 5, 100)
    config = _config(seed, n_shards * n_scenes, n_stops, n_scenes)
    with tempfile.TemporaryDirectory() as name:
        context = multiprocessing.get_context("spawn")
        with context.Pool(1) as pool:
            early, late = pool.apply(_memory, (config, Path(name)))
    count = n_shards * n_scenes * n_stops
    reason = f"{1e-3 * late:.0f} MB after {count} stops, {1e-3 * early:.0f} MB after a quarter"
    return [at_most("dataset.making.memory_growth", late / early - 1, 0.3 if quick else 0.05, reason)]


def bench_reading(seed: int, quick: bool) -> list[Measurement]:
    """Bytes a second of a shuffled stream in two loader workers over those of a plain read from the disk."""
    n_shards = 2 if quick else 16
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as name:
        dataset = _random_dataset(Path(name), n_shards, rng)
        plain_s = min(_cold(dataset, lambda: _plain(dataset)) for _ in range(3))
        loader, read = _loader(dataset)
        loaded_s = min(_cold(dataset, read) for _ in range(3))
    size = n_shards * STOPS_A_SHARD * STOP_BYTES
    reason = f"{loader}: {1e-6 * size / loaded_s:.0f} MB/s, a plain read {1e-6 * size / plain_s:.0f} MB/s"
    return [at_least("dataset.reading.over_plain_read", plain_s / loaded_s, 0.1 if quick else 0.8, reason)]


def _generate(config: DatasetConfig) -> int:
    """Make all arrays, and keep none."""
    count = 0
    for scene in range(config.scenes.count):
        _, stops = stops_of(config, scene)
        count += sum(1 for _ in stops)
    return count


def _processor_s(call: Callable[[], object]) -> float:
    started = time.process_time()
    call()
    return time.process_time() - started


def _time_workers(config: DatasetConfig, out: Path, n_workers: int) -> float:
    """Time of all shards on workers that have made others before."""
    warm = DatasetPlan(_config(config.seed + 1, n_workers, 1, 1), out).shards
    out.mkdir()
    with Workers(n_workers, None) as workers:
        list(each_outcome(workers.client, n_workers, make_shard, warm, 600.0))
        shards = DatasetPlan(config, out).shards
        started = time.perf_counter()
        failed = [
            found
            for _, found in each_outcome(workers.client, n_workers, make_shard, shards, 600.0)
            if found is not None
        ]
        taken_s = time.perf_counter() - started
    if failed:
        raise RuntimeError(str(failed[0]))
    return taken_s


def _command(spec: Path, out: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "isac_arena", "dataset", str(spec), "--out", str(out), "--workers", "2"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)


def _killed(process: subprocess.Popen[bytes], out: Path, later_s: float) -> bool:
    """Kill a command with its workers after the next shard, and some time; whether it was at work."""
    before = len(list(out.glob("*.tar")))
    while process.poll() is None and len(list(out.glob("*.tar"))) <= before:
        time.sleep(0.01)
    time.sleep(later_s)
    is_at_work = process.poll() is None
    if is_at_work:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    return is_at_work


def _memory(config: DatasetConfig, folder: Path) -> tuple[float, float]:
    """Largest resident memory in kB after a quarter of the shards and after all."""
    shards, found = DatasetPlan(config, folder).shards, []
    for number, shard in enumerate(shards):
        make_shard(shard)
        if number in (len(shards) // 4 - 1, len(shards) - 1):
            found.append(float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss))
    return found[0], found[-1]


def _random_dataset(folder: Path, n_shards: int, rng: np.random.Generator) -> Dataset:
    names = [f"train-{number:05d}.tar" for number in range(n_shards)]

    def stops() -> Iterator[Arrays]:
        for _ in range(STOPS_A_SHARD):
            yield {"cube": rng.integers(0, 2**16, STOP_BYTES // 2, np.uint16)}

    for name in names:
        write_shard(folder / name, iter([(name[6:11], ({}, stops()))]), {})
        with (folder / name).open("rb") as file:
            os.fsync(file.fileno())
    about = {"format": 1, "fields": {"cube": "random numbers"}, "shards": {"train": names}}
    write_json(folder / "dataset.json", about)
    return open_dataset(folder)


def _cold(dataset: Dataset, read: Callable[[], object]) -> float:
    """Time of a read of files that the system does not hold in memory."""
    for shard in dataset.shards:
        with shard.open("rb") as file:
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    started = time.perf_counter()
    read()
    return time.perf_counter() - started


def _plain(dataset: Dataset) -> int:
    return sum(np.fromfile(shard, np.uint8).size for shard in dataset.shards)


def _loader(dataset: Dataset) -> tuple[str, Callable[[], object]]:
    """Two workers of torch's loader, or two processes where torch is not installed."""
    try:
        torch = import_module("torch")
    except ImportError:
        pool = multiprocessing.get_context("fork").Pool(2)
        return "two processes", lambda: pool.starmap(_part, [(dataset, worker) for worker in range(2)])
    loader = torch.utils.data.DataLoader(dataset.stream(shuffle=1), batch_size=None, num_workers=2)
    return "torch's loader", lambda: sum(sample["cube"].shape[0] for sample in loader)


def _part(dataset: Dataset, worker: int) -> int:
    stream = dataset.stream(shuffle=1)
    return sum(int(sample["cube"][-1]) for sample in stream.part(worker, 2, np.random.default_rng(1)))
