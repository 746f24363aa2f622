"""Data sets: the same bytes for any number of workers and interruptions, splits by scene, and what readers get."""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import subprocess
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

import isac_arena as ia
from isac_arena.datasets import making, reading
from isac_arena.datasets.config import DatasetConfig
from isac_arena.datasets.making import make_dataset, scenes_by_split
from isac_arena.datasets.samples import campaign_config, occupancy, scene_of
from scenes.contours import rectangle
from scenes.pose import Pose
from scenes.scene import Scene, SceneObject
from tests.command_line import ROOT, arena_here, failure

ARRAY = {"rows": 1, "columns": 8, "beams_per_panel": 6}
SPEC: dict[str, Any] = {
    "name": "rooms", "keep": ["samples", "power_map", "cube", "paths", "poses", "contours", "occupancy"],
    "scenes": {"count": 4, "n_stops": 2, "difficulty": [0.0, 0.1]}, "scenes_per_shard": 1, "cube_delays": 16,
    "splits": {"train": 0.5, "validation": 0.25, "test": 0.25}, "dtype": "float16",
    "campaign": {
        "waveform": {"n_rb": 24, "comb": 4}, "tx_array": ARRAY,
        "rx_array": ARRAY | {"panel_azimuth_deg": [0.0, 180.0]},
        "propagation": {"diffuse_samples": 0, "compare_planar": False},
    },
}  # fmt: skip
CONFIG = DatasetConfig.model_validate(SPEC)
READ_SHARD = """
import sys, numpy as np, webdataset
read = webdataset.WebDataset(sys.argv[1], shardshuffle=False).decode()
np.savez(sys.argv[2], **{one["__key__"] + "." + name: one[name] for one in read for name in one if name[0] != "_"})
"""


def contents(folder: Path) -> dict[str, str]:
    return {
        file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in folder.iterdir() if file.is_file()
    }


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sets") / "rooms"
    (folder.parent / "spec.toml").write_text(tomli_w.dumps(SPEC))
    result = arena_here("dataset", "spec.toml", "--out", "rooms", "--workers", "1", cwd=folder.parent)
    assert "8 stops of 4 scenes in 4 shards" in result.stdout, result.stderr
    return folder


def test_a_scene_is_in_one_split() -> None:
    config = CONFIG.model_copy(update={"scenes": CONFIG.scenes.model_copy(update={"count": 101})})
    splits = scenes_by_split(config)
    assert sorted(scene for scenes in splits.values() for scene in scenes) == list(range(101))
    assert [len(scenes) for scenes in splits.values()] == [50, 26, 25]


def test_stops_hold_what_the_simulation_gives(made: Path) -> None:
    test = ia.datasets.open(made, "test")
    assert len(test) == 2 and test.fields == list(test.about)
    sample = test[1]
    number = int(sample["key"].partition("_")[0])
    scene = scene_of(CONFIG, number)
    run = ia.CampaignRun(campaign_config(CONFIG, number), scene)
    truth = list(run.truths())[1]
    sweep = run.sweep(truth)
    assert np.array_equal(sample["samples"], (sweep.samples * sweep.prs_symbol[:, None].conj()))
    assert sample["pose"][:2] == pytest.approx(truth.rx_pose.position_m[:2])
    assert sample["power_map"].dtype == np.float16
    power = 10 * np.log10(np.square(np.abs(sweep.samples)).mean(axis=2))
    assert np.abs(sample["power_map"] - power).max() < 0.1
    los = sample["paths"][sample["paths"][:, 7] == 1]
    length_m = np.linalg.norm(truth.rx_pose.position_m - scene.tx.position_m)
    if len(los):
        assert los[0, 0] == pytest.approx(1e9 * (length_m / 299792458 + truth.clock_bias_s), abs=1e-3)
    assert sample["cube"].shape == (6, 12, 16) and sample["cube"].min() == 0
    assert sample["contours"].shape == (len(scene.objects), 32, 2)


def test_the_simulation_behind_a_stop_is_that_of_its_arrays(made: Path, tmp_path: Path) -> None:
    sample = ia.datasets.open(made)[1]
    run, stop = ia.datasets.behind(made, sample["key"])
    sweep = run.sweep(run.truth(stop))
    assert np.array_equal(sample["samples"], sweep.samples * sweep.prs_symbol[:, None].conj())
    with pytest.raises(ValueError, match="has no such stop"):
        ia.datasets.behind(made, "chair")
    small = SPEC | {"keep": ["poses"], "scenes": SPEC["scenes"] | {"count": 1, "n_stops": 1}}
    assert len(ia.datasets.open(ia.datasets.make(small, tmp_path / "small"), "train")) in (0, 1)


def test_the_cube_peaks_at_the_delay_of_a_path() -> None:
    """The strongest beam pair peaks where the strongest path arrives."""
    run = ia.CampaignRun(campaign_config(CONFIG, 0), scene_of(CONFIG, 0))
    truth = run.truth(0)
    cube = making.stops_of(CONFIG, 0)[1]
    first = next(cube)["cube"].astype(float)
    pair = np.unravel_index(first.max(axis=2).argmax(), first.shape[:2])
    strongest = truth.paths.power.argmax()
    delay_s = truth.paths.delay_s[strongest] + truth.clock_bias_s
    band_hz = 24 * 12 * 120e3
    assert abs(first[pair].argmax() - delay_s * band_hz) < 1.5


def test_workers_and_interruptions_leave_the_same_bytes(made: Path, tmp_path: Path) -> None:
    whole = contents(made)
    seen: list[str] = []

    def stop(shard: making.Shard) -> None:
        seen.append(shard.path.name)
        raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            make_dataset(CONFIG, tmp_path / "again", tell=stop)
    (tmp_path / "again" / ".train-00001.tar.999999.part").write_bytes(b"left by a process that was killed")
    make_dataset(CONFIG, tmp_path / "again")
    assert len(set(seen)) == 2
    assert contents(tmp_path / "again") == whole


@pytest.mark.slow
def test_two_workers_leave_the_same_bytes(made: Path, tmp_path: Path) -> None:
    make_dataset(CONFIG, tmp_path / "two", workers=2)
    assert contents(tmp_path / "two") == contents(made)


def test_damaged_and_foreign_directories_are_refused(made: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text(tomli_w.dumps(SPEC | {"seed": 2}))
    assert "another specification" in failure("dataset", other, "--out", made)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    assert "holds other files" in failure("dataset", other, "--out", tmp_path / "full")
    other.write_text(tomli_w.dumps(SPEC | {"splits": {"train": 0.9}}))
    assert "train + validation + test = 1.1" in failure("dataset", other, "--out", tmp_path / "new")
    with pytest.raises(ValueError, match="holds no data set"):
        ia.datasets.open(tmp_path)
    with pytest.raises(ValueError, match="fields = 'chairs'"):
        ia.datasets.open(made, "train", ["chairs"])


def test_a_shard_is_a_plain_tar(made: Path) -> None:
    sample = ia.datasets.open(made)[0]
    with tarfile.open(made / "train-00000.tar") as tar:
        member = tar.extractfile(f"{sample['key']}.cube.npy")
        assert member is not None
        assert np.array_equal(np.load(io.BytesIO(member.read())), sample["cube"])


def test_streams_hold_every_stop_once(made: Path) -> None:
    dataset = pickle.loads(pickle.dumps(ia.datasets.open(made, fields=["pose"])))
    keys = [sample["key"] for sample in dataset]
    stream = dataset.stream(shuffle=1)
    passes = [[sample["key"] for sample in stream] for _ in range(3)]
    assert all(sorted(one) == sorted(keys) for one in passes)
    assert len({tuple(one) for one in passes}) > 1
    shared = [sample["key"] for part in range(2) for sample in stream.part(part, 2, None)]
    assert sorted(shared) == sorted(keys)
    by_key = {sample["key"]: sample["pose"] for sample in stream}
    assert all(np.array_equal(by_key[sample["key"]], sample["pose"]) for sample in dataset)


def test_workers_of_a_loader_shuffle_each_pass_anew(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every pass of a loader begins with new copies of the stream, and has a seed of its own."""
    stream, orders = ia.datasets.open(made, fields=["pose"]).stream(shuffle=1), set()
    for seed in range(4):
        monkeypatch.setattr(reading, "loader_worker", lambda seed=seed: (0, 1, seed))
        orders.add(tuple(sample["key"] for sample in pickle.loads(pickle.dumps(stream))))
    assert len(orders) > 1


def test_torch_loads_maps_and_streams(made: Path) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    dataset = ia.datasets.open(made, fields=["power_map", "pose"])
    loader = torch.utils.data.DataLoader(dataset, batch_size=2, shuffle=True, num_workers=2)
    assert sum(len(batch["pose"]) for batch in loader) == len(dataset)
    streamed = torch.utils.data.DataLoader(dataset.stream(shuffle=1), batch_size=None, num_workers=2)
    passes = [[sample["key"] for sample in streamed] for _ in range(4)]
    assert all(sorted(one) == sorted(sample["key"] for sample in dataset) for one in passes)
    assert len({tuple(one) for one in passes}) > 1


def test_webdataset_reads_shards(made: Path, tmp_path: Path) -> None:
    """In a Python of its own, see `test_other_packages.py`. What a scene holds once is a sample of its own."""
    python = Path(os.environ.get("PEERS_PYTHON", ROOT / ".venv/peers/bin/python"))
    if not python.exists() or subprocess.run([python, "-c", "import webdataset"], check=False).returncode:
        pytest.skip("webdataset is not installed")
    subprocess.run([python, "-c", READ_SHARD, made / "train-00000.tar", tmp_path / "read.npz"], check=True)
    theirs, ours = np.load(tmp_path / "read.npz"), ia.datasets.open(made)[0]
    key = ours.pop("key")
    for field, value in ours.items():
        name = f"{key}.{field}.npy"
        assert np.array_equal(theirs[name if name in theirs else name.replace(key, key[:6])], value)


def test_cells_of_a_grid_are_full_where_they_meet_an_object() -> None:
    plan = rectangle((1.1, 1.9), (0.0, 0.5))
    wall = SceneObject("wall", "wall", plan, 0.0, 3.0, ia.itu_material("concrete", 60e9))
    walk = ia.Walk(np.array([[3.0, 3.0]]), 1.5, 0.0)
    scene = Scene("plan", (wall,), Pose(np.array([3.0, 1.0, 1.5]), 0.0), walk, (0.0, 0.0, 4.0, 4.0))
    grid = occupancy(scene, 4, 1.0)
    assert grid.tolist() == [[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]
