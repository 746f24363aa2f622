"""A campaign in hand: settings, scene and link, with the truth and the samples of its stops."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from estimation.channel.record import ChannelEstimate, ChannelEstimator
from isac_arena.campaign.chain.memory import MemoryRun, RunResults
from isac_arena.campaign.config import CampaignConfig, methods
from isac_arena.campaign.directory import CampaignStore
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.load import (
    SceneSource,
    campaign_path,
    changed_campaign,
    python_scene_source,
    without_library_paths,
)
from isac_arena.progress import told
from scenes.arguments import need, need_each
from scenes.display import Displayed
from scenes.pose import Pose
from scenes.scene import Scene
from scenes.tables import scene_tables
from scenes.toml_config import ConfigError, read_toml
from sim.links import link_stops
from sim.observation import BeamSweep
from sim.signal.link import Link
from sim.simulate import observe
from sim.truth import Truth

IN_PYTHON = "campaign"  # what errors name in place of a file


@dataclass(frozen=True, repr=False)
class Campaign(Displayed):
    """Settings, scene and what the scene was made from. `load_campaign` makes one."""

    config: CampaignConfig
    scene: Scene
    source: SceneSource

    @property
    def stops(self) -> tuple[Pose, ...]:
        """The receiver pose at every stop of the walk."""
        return self.scene.stops

    @cached_property
    def link(self) -> Link:
        """Beams, signal and noise of the settings."""
        return self.chain().link

    @told(lambda self, stops=None: "trace")
    def trace(self, stops: Iterable[int] | None = None) -> list[Truth]:
        """True paths, receiver pose and clock of the given stops, by default of all; `ValueError` for others."""
        return list(self.chain(stops).truths())

    @told(lambda self, truth: f"samples of {_stop(truth)}")
    def observe(self, truth: Truth) -> BeamSweep:
        """The samples of a stop: what its receiver has."""
        need("truth", truth, Truth)
        return observe(self.config, self.link, self.scene, truth)

    @told(lambda self, sweep: f"channel estimate of {_stop(sweep)}")
    def estimate(self, sweep: BeamSweep) -> ChannelEstimate:
        """The paths of a stop by the channel method, settings and calibration of this campaign."""
        need("sweep", sweep, BeamSweep)
        return self._estimator(sweep)

    @cached_property
    def _estimator(self) -> ChannelEstimator:
        return self.chain().links[0].channel_estimator

    def run(self, stops: Iterable[int] | None = None, *, out: str | Path | None = None) -> RunResults:
        """The whole chain over these stops in memory, or over all into a directory, as `isac_arena.run` does.

        The result has the attributes of that of `isac_arena.open`; in memory each is computed at its first use.
        Stops are as in `trace`.
        """
        if out is None:
            return MemoryRun(self.chain(stops))
        if stops is not None:
            raise ValueError("stops: a directory holds all stops of the walk; leave out either stops or out")
        from isac_arena.api import run  # noqa: PLC0415  (it imports this module)

        return run(self, out)

    def chain(self, stops: Iterable[int] | None = None) -> CampaignRun:
        """The driver of the chain over these stops, to call it stage by stage. Stops are as in `trace`."""
        if stops is not None:
            need_each("stops", stops, int, np.integer)
            stops, n_stops = list(stops), len(self.stops)
            wrong = [stop for stop in stops if not 0 <= stop < n_stops]
            if wrong:
                raise ValueError(f"stops = {wrong[0]}: must be within 0 and {n_stops - 1}, the stops of the walk")
        return CampaignRun(self.config, self.scene, stops=stops)

    def __repr__(self) -> str:
        method = methods(self.config)["channel"]
        return f"Campaign({self.config.name!r}: {self.scene!r}, method {method!r}, seed {self.config.seed})"


def load_campaign(
    source: str | Path | Mapping[str, Any],
    *,
    seed: int | None = None,
    scene: str | Path | Mapping[str, Any] | Scene | None = None,
    **changes: Any,
) -> Campaign:
    """A campaign of the library by name, of a TOML file by path, or of the tables of such a file as a dict.

    Files that a campaign or scene names are looked up beside it; those of a dict in the working folder.

    Parameters
    ----------
    seed
        Replaces the seed of the file.
    scene
        Replaces the scene: a name, a path, the tables of a scene file as a dict, or a `Scene` made in Python.
    changes
        Settings that differ: a table as a dict (`link={"tx_power_dbm": 0.0}`: its other fields stay), or a dotted
        path as in sweeps (`**{"scene.objects.pillar.contour.radius_m": 0.5}`).

    Raises `ConfigError`, one line naming file, field, value and what is allowed, and `ValueError` for a scene that
    cannot be used.
    """
    need("source", source, str, Path, Mapping)
    need("scene", scene, str, Path, Mapping, Scene, type(None))
    try:
        return _loaded(source, scene, seed, changes)
    except ValueError as error:
        raise type(error)(without_library_paths(str(error))) from error


def _loaded(
    source: str | Path | Mapping[str, Any],
    scene: str | Path | Mapping[str, Any] | Scene | None,
    seed: int | None,
    changes: Mapping[str, Any],
) -> Campaign:
    path = Path(IN_PYTHON) if isinstance(source, Mapping) else campaign_path(str(source))
    document = dict(source) if isinstance(source, Mapping) else read_toml(path)
    if "bounds_m" in document and "scene" not in document:
        what = f"'arena new campaign NAME --scene {path}' writes a campaign in it"
        raise ConfigError(f"{path}: is a scene; {what}")
    wanted = list(_fields(changes))
    if seed is not None:
        wanted.append(("seed", seed))
    if scene is None:
        config, made_of = changed_campaign(document, path, wanted)
    elif isinstance(scene, str | Path):
        name = str(Path(scene).resolve()) if str(scene).endswith(".toml") else str(scene)
        config, made_of = changed_campaign(document, path, [*wanted, ("scene", name)])
    else:
        tables = scene_tables(scene) if isinstance(scene, Scene) else dict(scene)
        named = [*wanted, ("scene", f"{tables.get('name', 'scene')}.toml")]
        config, made_of = changed_campaign(document, path, named, lambda _: python_scene_source(tables))
    return Campaign(config, made_of.build(config), made_of)


def _stop(thing: object) -> str:
    return f"stop {getattr(thing, 'stop', '?')}"


def campaign_store(campaign: Campaign, directory: Path) -> CampaignStore:
    """The directory of a campaign; nothing is written yet."""
    return CampaignStore(directory, campaign.config, campaign.source.text, scene_files=campaign.source.files)


def link_stores(store: CampaignStore) -> tuple[tuple[CampaignStore, range], ...]:
    """The files of every TX or link of a campaign with its stops; of one the store itself."""
    stops = link_stops(store.config, store.scene)
    several = len(stops) > 1
    return tuple((store.of_tx(name) if several else store, own) for name, own in stops.items())


def _fields(changes: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Changes as dotted paths and values: tables become their fields."""
    for name, value in changes.items():
        if isinstance(value, Mapping) and value:
            yield from ((f"{name}.{field}", inner) for field, inner in _fields(value))
        else:
            yield name, value
