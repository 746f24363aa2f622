"""What a run found, the same whether it is kept in a directory or in memory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from estimation.channel.record import ChannelEstimate
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.driver import CampaignRun
from isac_arena.campaign.results import CampaignResults, MapResult
from isac_arena.progress import counted, told
from isac_arena.scoring.doubts import run_doubts
from isac_arena.scoring.headline import headline
from isac_arena.scoring.score import Scores
from scenes.display import Displayed
from scenes.scene import Scene
from sim.truth import Truth

SHOWN = (  # in the short form of a run
    "channel.detection_rate",
    "slam.position.rmse_m",
    "contours.mapping.objects_found.pillar",
    "contours.mapping.objects_found.wall",
)


class RunResults(Displayed, ABC):
    """The truths, estimates and scores of a run; each is read or computed when it is first used."""

    @property
    @abstractmethod
    def directory(self) -> Path | None:
        """Where the files are; None in memory."""

    @property
    @abstractmethod
    def config(self) -> CampaignConfig:
        """The settings, with all defaults."""

    @property
    @abstractmethod
    def scene(self) -> Scene:
        """The scene."""

    @property
    @abstractmethod
    def truths(self) -> list[Truth]:
        """The truth of every stop; a measured campaign has none."""

    @property
    @abstractmethod
    def results(self) -> CampaignResults:
        """All estimates."""

    @property
    @abstractmethod
    def scores(self) -> Scores:
        """The scores; `ValueError` where the run was not scored."""

    @property
    def channel(self) -> tuple[ChannelEstimate, ...]:
        """The channel estimate of every stop."""
        return self.results.channel

    @property
    def mapping(self) -> MapResult:
        """The map from the surveyed receiver."""
        return self.results.mapping

    @property
    def slam(self) -> MapResult:
        """The map and the receiver states found together."""
        return self.results.slam

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is doubtful about the results, a sentence each, with what to do; empty where nothing is.

        What is doubtful about settings and scene before anything is computed, as heights, places and what no path
        meets, is not among them: `arena run` says it first, and the report of a run has both.

        Raises `ValueError` where the run was not scored.
        """
        return run_doubts(self.scores.metrics, self.slam.poses)

    @abstractmethod
    def _known_scores(self) -> Scores | None:
        """The scores where they are at hand."""

    def __repr__(self) -> str:
        scores = self._known_scores()
        found = "; ".join(_main(scores)) if scores else "no scores yet"
        doubtful = "; doubtful, see .doubts" if scores and scores.doubts else ""
        where = f"{self.config.name!r} in {self.directory or 'memory'}"
        return f"{type(self).__name__}({where}, {counted(self._n_stops, 'stop')}: {found}{doubtful})"

    @property
    def _n_stops(self) -> int:
        return len(self.scene.stops)


def _main(scores: Scores) -> Iterator[str]:
    """The main scores in a few words each."""
    for label, (_, ours, _), unit in headline(scores.metrics):
        if ours is not None and ours.key in SHOWN:
            yield f"{label} {ours.value:.3g} {unit}".rstrip()


@dataclass(frozen=True, repr=False)
class MemoryRun(RunResults):
    """The results of a run in memory, computed when they are first used. `chain` is the driver that does it."""

    chain: CampaignRun

    @property
    def directory(self) -> None:
        """None: there are no files."""
        return

    @property
    def config(self) -> CampaignConfig:
        """The settings, with all defaults."""
        return self.chain.config

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.chain.scene

    @cached_property
    @told(lambda self: "trace")
    def truths(self) -> list[Truth]:
        """The truth of every stop of this run, traced now; of several TX or links one after the other."""
        return list(self.chain.truths())

    @cached_property
    @told(lambda self: f"run of {len(self.chain.chosen_stops)} stops")
    def results(self) -> CampaignResults:
        """All estimates, made now; `EstimatorError` where a function of yours fails."""
        return self.chain.estimates(self.truths)

    @cached_property
    def scores(self) -> Scores:
        """The scores of all estimates."""
        return self.chain.score(self.truths, self.results)

    def _known_scores(self) -> Scores | None:
        return vars(self).get("scores")

    @property
    def _n_stops(self) -> int:
        return len(self.chain.chosen_stops)
