"""Make a task: a folder of observations for everybody, and a sealed file with the truth of all scenes.

    public/task.json               tier, stage, scenes, stops, the settings, and the hash of the seal
    public/scene_000/...           samples of every stop (channel); else a table of paths and an empty hall
    seal.tar                       scenes and truths; keep it
    leaderboard.json, .html        results that were graded

Whoever has the seal can show later that it is the one of the task: its hash is public from the start.
"""

import io
import json
import shutil
import tarfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, get_args

import numpy as np
import tomli_w

from estimation.channel.estimate import estimate_channel
from estimation.channel.record import ChannelEstimate
from isac_arena.campaign.campaign import load_campaign
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.files import (
    complete_file,
    read_record,
    write_bytes,
    write_csv,
    write_json,
    write_record,
    write_text,
)
from isac_arena.campaign.integrity import file_digest
from isac_arena.campaign.lock import one_run
from isac_arena.campaign.netcdf import to_netcdf
from isac_arena.public_tasks.scenes import Tier, n_seen, task_scene
from isac_arena.workers.threads import one_thread
from scenes.config import load_scene
from scenes.pose import Pose
from scenes.scene import Scene
from scenes.tables import scene_tables
from sim.clock import campaign_clock
from sim.truth import Truth

Stage = Literal["channel", "slam", "contours"]
TASK_STAGES: tuple[Stage, ...] = get_args(Stage)
SEAL, ABOUT, UNFINISHED = "seal.tar", "task.json", ".public"
UNKNOWN_M = 1000.0  # half the side of a hall that is not known
N_ROOMS = 50  # rooms tried for a scene
# An object has a point a stop, and methods need five points near one another to tell an object from clutter.
LEAST_STOPS: dict[Stage, int] = {"contours": 6}
# A TX may stand in the middle of a room: one panel would take a path behind it for its mirror image in front.
ALL_AROUND = {"panel_azimuth_deg": [-180.0, -90.0, 0.0, 90.0], "sector_deg": 90.0}
SETTINGS: dict[str, Any] = {
    "waveform": {"n_rb": 264, "comb": 4},
    "tx_array": {"rows": 1, "columns": 16, "beams_per_panel": 12, **ALL_AROUND},
    "rx_array": {"rows": 1, "columns": 8, "beams_per_panel": 8, **ALL_AROUND},
    "channel": {"maximum_likelihood": {"max_paths": 40}},
    "propagation": {"diffuse_samples": 0, "compare_planar": False},
}


@dataclass(frozen=True)
class TaskSpec:
    """A task: which rooms, which stage, how many scenes and stops, and the seed of all of it."""

    name: str
    tier: Tier
    stage: Stage
    n_scenes: int
    n_stops: int
    seed: int


@dataclass(frozen=True)
class SealedScene:
    """A scene of a task with its truth."""

    config: CampaignConfig
    scene: Scene
    truths: list[Truth]

    @cached_property
    def run(self) -> CampaignRun:
        """The chain over this scene."""
        return CampaignRun(self.config, self.scene, paths=self.truths)

    @cached_property
    def channel(self) -> list[ChannelEstimate]:
        """The channel estimates that everybody gets for SLAM and contours: ours."""
        sweeps = (self.run.sweep(truth) for truth in self.truths)
        return [estimate_channel(sweep, config=self.config.channel).reported for sweep in sweeps]


def make_task(spec: TaskSpec, out: Path, tell: Callable[[int], None] = lambda _: None) -> None:
    """Write a task; `ValueError` where the directory holds other files, or stops are too few for the stage."""
    least = LEAST_STOPS.get(spec.stage, 1)
    if spec.n_stops < least:
        raise ValueError(f"--stops = {spec.n_stops}: must be at least {least} for {spec.stage}")
    with one_run(out), one_thread():
        if any(not one.name.startswith(".") for one in out.iterdir()):
            raise ValueError(f"--out = {out}: holds other files; choose an empty or a new directory")
        public = out / UNFINISHED
        shutil.rmtree(public, ignore_errors=True)  # of a command that was ended
        with complete_file(out / SEAL) as partial, tarfile.TarFile(partial, "w") as seal:
            for number in range(spec.n_scenes):
                sealed = _simulated(spec, number)
                for name, content in _contents(sealed, number):
                    member = tarfile.TarInfo(name)
                    member.size = len(content)
                    seal.addfile(member, io.BytesIO(content))
                _observe(sealed, spec.stage, public / f"scene_{number:03d}")
                tell(number)
        about = {**spec.__dict__, "settings": SETTINGS, "seal_sha256": file_digest(out / SEAL)}
        about.pop("seed")  # the truth follows from it
        write_json(public / ABOUT, about)
        public.rename(out / "public")


def read_task(directory: Path) -> tuple[dict[str, Any], list[SealedScene]]:
    """What a task states, and its sealed scenes; `ValueError` where the seal is not the one of the task."""
    about, seal = _about(directory), directory / SEAL
    if not seal.is_file():
        raise ValueError(f"{directory}: has no {SEAL}; only who made the task can grade")
    if file_digest(seal) != about["seal_sha256"]:
        raise ValueError(f"{seal}: is not the seal of this task: its hash is not that of public/{ABOUT}")
    with tarfile.TarFile(seal) as tar, TemporaryDirectory() as folder:
        for member in tar.getmembers():
            stream = tar.extractfile(member)
            write_bytes(Path(folder) / Path(member.name).name, b"" if stream is None else stream.read())
        try:
            return about, [_unsealed(Path(folder), number, about) for number in range(about["n_scenes"])]
        except FileNotFoundError as error:
            counts = f"{about['n_scenes']} scenes of {about['n_stops']} stops"
            raise ValueError(f"{directory / 'public' / ABOUT}: states {counts}; the seal holds fewer") from error


def _about(directory: Path) -> dict[str, Any]:
    try:
        found: dict[str, Any] = json.loads((directory / "public" / ABOUT).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{directory}: holds no task; make one with 'arena task make'") from error
    checks: dict[str, Callable[[Any], bool]] = {
        "name": lambda value: isinstance(value, str), "stage": TASK_STAGES.__contains__,
        "tier": get_args(Tier).__contains__, "n_scenes": _is_count, "n_stops": _is_count,
        "settings": lambda value: isinstance(value, dict), "seal_sha256": lambda value: isinstance(value, str),
    }  # fmt: skip
    for name, is_right in checks.items():
        if not isinstance(found, dict) or not is_right(found.get(name)):
            raise ValueError(f"{directory / 'public' / ABOUT}: {name} is not as it was made; put the file back")
    return found


def _is_count(value: Any) -> bool:
    return type(value) is int and value > 0


def _simulated(spec: TaskSpec, number: int) -> SealedScene:
    """A scene in which at least half of the stops see the TX; `ValueError` where none is found."""
    rng = np.random.default_rng([spec.seed, number])
    for _ in range(N_ROOMS):
        scene = task_scene(spec.tier, rng, spec.n_stops)
        config = task_config(int(rng.integers(2**62)))
        if 2 * n_seen(scene, campaign_clock(config, scene).middle_s) >= spec.n_stops:
            return SealedScene(config, scene, list(CampaignRun(config, scene).truths()))
    raise ValueError(f"seed = {spec.seed}: scene {number}: no walk sees enough of the TX in {N_ROOMS} rooms")


def task_config(seed: int) -> CampaignConfig:
    """The settings of the campaigns of all tasks."""
    return load_campaign({"name": "task", "scene": "box_room", "seed": seed, **SETTINGS}).config


def _contents(sealed: SealedScene, number: int) -> Iterator[tuple[str, bytes]]:
    yield f"scene_{number:03d}.toml", tomli_w.dumps(scene_tables(sealed.scene)).encode()
    yield f"scene_{number:03d}.json", json.dumps({"seed": sealed.config.seed}).encode()
    for truth in sealed.truths:
        yield f"scene_{number:03d}_stop_{truth.stop:03d}.nc", to_netcdf(truth, {})


def _unsealed(folder: Path, number: int, about: dict[str, Any]) -> SealedScene:
    name = f"scene_{number:03d}"
    seed = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))["seed"]
    truths = [read_record(folder / f"{name}_stop_{stop:03d}.nc", Truth) for stop in range(about["n_stops"])]
    config = load_campaign({"name": "task", "scene": "box_room", "seed": seed, **about["settings"]}).config
    return SealedScene(config, load_scene(str(folder / f"{name}.toml"), config.waveform.carrier_ghz * 1e9), truths)


def _observe(sealed: SealedScene, stage: Stage, folder: Path) -> None:
    """Write what everybody gets of a scene."""
    tx = sealed.scene.tx
    about = {"tx_position_m": tx.position_m.tolist(), "tx_heading_rad": tx.heading_rad}
    angles = "azimuths are those that horizontal beams see: cone angles about the boresight of the nearest panel"
    write_json(folder / "scene.json", {**about, "angles": angles})
    if stage == "channel":
        for truth in sealed.truths:
            write_record(folder / f"stop_{truth.stop:03d}.nc", sealed.run.sweep(truth))
        return
    write_text(folder / "hall.toml", tomli_w.dumps(_empty_hall(tx)))
    write_csv(folder / "paths.csv", path_rows(sealed, with_poses=stage == "contours"))


def _empty_hall(tx: Pose) -> dict[str, Any]:
    """The scene file of a hall of which the TX alone is known, for `arena import-paths`."""
    x_m, y_m, z_m = tx.position_m.tolist()
    return {
        "name": "unknown_hall", "materials": {}, "bounds_m": [-UNKNOWN_M, -UNKNOWN_M, UNKNOWN_M, UNKNOWN_M],
        "tx": {"position_m": [x_m, y_m, z_m], "heading_deg": float(np.rad2deg(tx.heading_rad))},
        "walk": {"type": "poses", "poses": [[x_m + 1.0, y_m, z_m, 0.0]]},
    }  # fmt: skip


def path_rows(sealed: SealedScene, *, with_poses: bool) -> list[dict[str, Any]]:
    """Rows of a table as `arena import-paths` reads it."""
    rows = []
    tx = sealed.scene.tx
    for truth, estimate in zip(sealed.truths, sealed.channel, strict=True):
        pose = truth.rx_pose
        place = {
            "rx_x_m": pose.position_m[0], "rx_y_m": pose.position_m[1], "rx_z_m": pose.position_m[2],
            "rx_heading_rad": pose.heading_rad, "clock_bias_s": truth.clock_bias_s,
        }  # fmt: skip
        for path in range(len(estimate)):
            std = np.sqrt(np.diagonal(estimate.covariance[path]))
            row = {
                "stop": truth.stop, "delay_s": estimate.delay_s[path],
                "aod_azimuth_rad": estimate.aod_azimuth_rad[path],
                "aoa_azimuth_rad": estimate.aoa_azimuth_rad[path], "power_dbm": estimate.power_dbm[path],
                "delay_std_s": std[0], "aod_azimuth_std_rad": std[1], "aoa_azimuth_std_rad": std[2],
                "is_los": int(estimate.is_los[path]), "tx_x_m": tx.position_m[0], "tx_y_m": tx.position_m[1],
                "tx_z_m": tx.position_m[2], "tx_heading_rad": tx.heading_rad,
            }  # fmt: skip
            rows.append(row | (place if with_poses else {}))
    return rows
