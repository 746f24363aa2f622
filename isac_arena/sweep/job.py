"""A case in the directory of its sweep, and the names its files go by.

scenes/HASH/scene.toml     a scene and the files it names
paths/HASH/stop_000.nc     traced paths, shared by all cases of the same scene and propagation
signals/HASH/stop_000.nc   samples, while several cases wait for them
cases/HASH/                campaign.json, scores.json, provenance.nc, manifest.json: there only when whole
estimates/HASH/stop_000.nc channel estimates, of cases that keep them
failures/KEY.txt           traceback of a user's function, where it failed
times/HASH.json            processor time in s of each of them

Of several TX or links each has files of its own: stop_000_NAME.nc.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.directory import CampaignStore
from isac_arena.campaign.integrity import code_digest, digest
from isac_arena.campaign.load import SceneSource, scene_in_use
from isac_arena.sweep.cases import Case, Point, Stages
from scenes.names import path_in
from scenes.scene import Scene
from sim.config import WaveformConfig
from sim.links import link_stops, with_link_stops
from sim.transmitters import first_tx

CASE_FILES = ("campaign.json", "provenance.nc", "scores.json", "manifest.json")


@dataclass(frozen=True)
class Job:
    """All inputs of a case except its stored scene. Small, because it is sent to the workers."""

    root: Path
    point: int
    repeat: int
    values: Point
    config: CampaignConfig
    stop_every: int
    stages: Stages
    n_stops: int  # of the walk
    scene_hash: str
    paths_hash: str  # of the inputs of the paths: equal for cases that differ in signal, noise or estimator
    signal_hash: str  # of the inputs of the samples
    channel_hash: str  # of the inputs of the channel estimates
    key: str  # of settings, scene, estimator and code: the name of the case

    @property
    def directory(self) -> Path:
        """Where the finished case is."""
        return path_in(self.root / "cases", self.key)

    @property
    def is_done(self) -> bool:
        """Whether all files of the case exist."""
        return all((self.directory / name).is_file() for name in CASE_FILES)

    @property
    def scene(self) -> Scene:
        """The scene of the case, with the TX and the walk it chooses."""
        config = self.config
        walk = tuple(config.walk) if isinstance(config.walk, list) else config.walk
        loaded = _loaded(self.scene_file, config.waveform.carrier_ghz, first_tx(config), walk)
        return with_link_stops(config, loaded)

    @property
    def scene_file(self) -> Path:
        """The stored scene file of the case."""
        return scene_file(self.root, self.scene_hash)

    @property
    def stops(self) -> range:
        """Indices of the receiver stops that the sweep takes."""
        return range(0, self.n_stops, self.stop_every)

    def paths_file(self, stop: int, tx: str = "") -> Path:
        """The traced paths of a stop; `tx` is `_NAME` of one of several TX or links."""
        return self.root / "paths" / self.paths_hash / f"stop_{stop:03d}{tx}.nc"

    def estimate_file(self, stop: int, tx: str = "") -> Path:
        """The channel estimate of a stop, where the case keeps it."""
        return self.root / "estimates" / self.channel_hash / f"stop_{stop:03d}{tx}.nc"

    def missing(self, file_of: Callable[[int, str], Path]) -> list[int]:
        """The stops for which one of the files of all links, as `paths_file` names them, does not exist."""
        links = link_stops(self.config, self.scene)
        endings = {f"_{name}" if len(links) > 1 else "": own for name, own in links.items()}
        return [
            stop
            for stop in self.stops
            if any(stop in own and not file_of(stop, tx).is_file() for tx, own in endings.items())
        ]

    @property
    def trace_file(self) -> Path:
        """Traceback of a user's function that failed in the case."""
        return path_in(self.root / "failures", f"{self.key}.txt")

    @property
    def times_file(self) -> Path:
        """Processor times of the kept channel estimates, by stop."""
        return self.root / "times" / f"{self.channel_hash}.json"

    def signal_file(self, stop: int, tx: str = "") -> Path:
        """The samples of a stop."""
        return self.root / "signals" / self.signal_hash / f"stop_{stop:03d}{tx}.nc"


def make_job(case: Case, root: Path, n_stops: int, like: Job | None = None) -> Job:
    """The job of a case whose walk has `n_stops` stops; `like` is one of the same point, with the same paths."""
    store = _store(case, root, case.config)
    paths_hash = (
        _store(case, root, tracing_config(case.config)).truth_fingerprint if like is None else like.paths_hash
    )
    return Job(
        root=root,
        point=case.point,
        repeat=case.repeat,
        values=case.values,
        config=case.config,
        stop_every=case.stop_every,
        stages=case.stages,
        n_stops=n_stops,
        scene_hash=case.scene.hash,
        paths_hash=paths_hash,
        signal_hash=store.truth_fingerprint,
        channel_hash=store.channel_fingerprint,
        key=_key(case, store),
    )


def _key(case: Case, store: CampaignStore) -> str:
    """The name of a case: later stages count only where it runs them."""
    if case.stages != "channel":
        return digest(store.score_fingerprint, str(case.stop_every))
    scoring = code_digest("isac_arena/scoring")
    return digest(store.channel_fingerprint, scoring, str(case.stop_every), case.stages)


def tracing_config(config: CampaignConfig) -> CampaignConfig:
    """The settings that paths depend on, all others at their defaults."""
    return CampaignConfig.model_construct(
        name="paths",
        scene=config.scene,
        tx=config.tx,
        walk=config.walk,
        links=config.links,
        propagation=config.propagation,
        waveform=WaveformConfig.model_construct(carrier_ghz=config.waveform.carrier_ghz),
    )


def scene_file(root: Path, scene_hash: str) -> Path:
    """Where a sweep keeps a scene."""
    return path_in(root / "scenes", scene_hash) / "scene.toml"


def store_scene(root: Path, scene: SceneSource) -> None:
    """Store a scene with the files it names, the scene file last; changed files are restored."""
    scene.write(scene_file(root, scene.hash).parent)


@lru_cache(maxsize=2)
def _loaded(file: Path, carrier_ghz: float, tx: str | None, walk: str | tuple[str, ...] | None) -> Scene:
    """A stored scene; the name of its file follows from its content."""
    return scene_in_use(file, carrier_ghz, tx, walk)


def _store(case: Case, root: Path, config: CampaignConfig) -> CampaignStore:
    """The case as a campaign of its own, for its fingerprints."""
    return CampaignStore(root, config, case.scene.text, scene_files=dict(case.scene.files))
