"""The estimation chain in Python: functions of a campaign and of records, and runs on a directory.

The campaign gives settings, scene and link; `CampaignRun` in `campaign/driver.py` does the work.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from estimation.channel.record import ChannelEstimate
from estimation.slam.checks import check_estimates
from estimation.slam.record import IncidencePoints, PoseEstimates
from estimation.tracks.record import Tracks
from isac_arena.campaign import stages, stored
from isac_arena.campaign.campaign import Campaign, load_campaign
from isac_arena.campaign.chain.inputs import unsolved_poses
from isac_arena.campaign.chain.maps import campaign_tracks
from isac_arena.campaign.chain.memory import RunResults
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.directory import CampaignStore
from isac_arena.campaign.results import CampaignResults, MapResult
from isac_arena.progress import told
from isac_arena.scoring.chain import score_metrics
from isac_arena.scoring.measured import measured_metrics
from isac_arena.scoring.score import Scores
from isac_arena.user_functions.errors import summed
from isac_arena.user_functions.room import not_found
from isac_arena.workers.stops import StopMakers
from scenes.arguments import need, need_each
from scenes.record import empty_record
from scenes.scene import Scene
from sim.truth import Truth

Located = tuple[PoseEstimates, IncidencePoints]


@told(lambda *_, **__: "mapping")
def map_points(campaign: Campaign, channel: Sequence[ChannelEstimate], truths: Sequence[Truth]) -> Located:
    """Mapping: the incidence points of all paths, from the surveyed receiver states of the truths.

    Returns the states and the points. Raises `ValueError` where an estimate does not fit the others.
    """
    usable = _usable(campaign, channel)
    need_each("truths", truths, Truth)
    _check_stops("truths", [truth.stop for truth in truths], channel)
    run = campaign.chain()
    return run.locate(usable, run.surveyed_receiver(truths))


@told(lambda *_, **__: "SLAM")
def slam(campaign: Campaign, channel: Sequence[ChannelEstimate]) -> Located:
    """SLAM: receiver states and incidence points, found together; raises as `map_points` does."""
    usable = _usable(campaign, channel)
    return campaign.chain().locate(usable)


@told(lambda *_, **__: "contours")
def fit_contours(
    campaign: Campaign, channel: Sequence[ChannelEstimate], poses: PoseEstimates, points: IncidencePoints
) -> MapResult:
    """The map with the paper's shapes of clusters and our contours of objects."""
    usable = _usable(campaign, channel)
    need("poses", poses, PoseEstimates)
    need("points", points, IncidencePoints)
    _check_stops("poses", poses.stop.tolist(), channel)
    return campaign.chain().shape(usable, poses, points)


@told(lambda *_, **__: "tracks")
def track(campaign: Campaign, channel: Sequence[ChannelEstimate], poses: PoseEstimates) -> Tracks | None:
    """The tracks of what moves, at receiver states; None where nothing does. Raises as `map_points` does."""
    usable = _usable(campaign, channel)
    need("poses", poses, PoseEstimates)
    _check_stops("poses", poses.stop.tolist(), channel)
    run = campaign.chain()
    return campaign_tracks(run.config, run.scene, run.tx, usable, poses)


@told(lambda *_, **__: "scores")
def score(
    campaign: Campaign,
    truths: Sequence[Truth],
    channel: Sequence[ChannelEstimate],
    mapping: MapResult | None = None,
    slam: MapResult | None = None,
) -> Scores:
    """Scores of the channel estimates and of the maps that are given, against the truths.

    Raises `ValueError` where a stop has a truth but no estimate, or an estimate but no truth.
    """
    need_each("truths", truths, Truth)
    need("mapping", mapping, MapResult, type(None))
    need("slam", slam, MapResult, type(None))
    results = CampaignResults(
        tuple(_usable(campaign, channel)), (), mapping or empty_record(MapResult), slam or _no_slam(truths)
    )
    scores = campaign.chain([truth.stop for truth in truths]).score(truths, results)
    absent = {name for name, given in (("mapping", mapping), ("slam", slam)) if given is None}
    kept = (metric for metric in scores.metrics if absent.isdisjoint(metric.key.split(".")))
    return replace(scores, metrics=tuple(kept))


def run(
    campaign: Campaign | str | Path,
    out: str | Path,
    *,
    seed: int | None = None,
    estimator: str | None = None,
    keep_sweeps: bool = False,
    workers: int = 1,
) -> "FinishedRun":
    """The whole chain into a campaign directory, as `arena run`; an interrupted run continues.

    `estimator` is `package.module:function`, a channel estimator of your own; `functions` of the settings replace
    other stages as well. Where one fails the run goes on without it, with a warning. More than one of the
    `workers` are processes of their own, which import the script that calls: guard it by
    `if __name__ == "__main__":`.

    Raises `ValueError` where the directory holds something else or an input is wrong.
    """
    need("campaign", campaign, Campaign, str, Path)
    need("out", out, str, Path)
    need("seed", seed, int, type(None))
    need("estimator", estimator, str, type(None))
    need("keep_sweeps", keep_sweeps, bool)
    need("workers", workers, int)
    for name, number, least in (("seed", seed or 0, 0), ("workers", workers, 1)):
        if number < least:
            raise ValueError(f"{name} = {number}: must be {least} or more")
    given = campaign if isinstance(campaign, Campaign) else load_campaign(campaign)
    if seed is not None:
        given = replace(given, config=given.config.model_copy(update={"seed": seed}))
    named = {} if estimator is None else {"channel": estimator}
    failures = stages.run_campaign(
        given, Path(out), named=named, keep_sweeps=keep_sweeps, makers=StopMakers(workers)
    )
    if failures:
        warnings.warn(str(summed(failures)), stacklevel=2)
    return FinishedRun(stages.reopen(Path(out), reads=stages.SCORED))


def open(directory: str | Path) -> "FinishedRun":
    """The results in a campaign directory; `ValueError` where it holds none, or files changed since."""
    need("directory", directory, str, Path)
    return FinishedRun(stages.reopen(Path(directory), reads=stages.SCORED))


@dataclass(frozen=True, repr=False)
class FinishedRun(RunResults):
    """The results of a run in a directory, read when they are first used."""

    store: CampaignStore

    @property
    def directory(self) -> Path:
        """Where the files are."""
        return self.store.directory

    @property
    def config(self) -> CampaignConfig:
        """The settings, with all defaults."""
        return self.store.config

    @cached_property
    def scene(self) -> Scene:
        """The scene."""
        return self.store.scene

    @cached_property
    def truths(self) -> list[Truth]:
        """The truth of every stop; a measured campaign has none."""
        return list(stored.stored_truths(self.store, len(self.scene.stops)))

    @cached_property
    def results(self) -> CampaignResults:
        """All estimates."""
        return stored.stored_results(self.store, len(self.scene.stops))

    @cached_property
    def scores(self) -> Scores:
        """The scores; `ValueError` where the run was not scored."""
        tables = self.store.score_tables()
        if tables is None:
            cause = not_found(self.config.functions)
            cause = cause or "its scores are missing or of another version; run 'arena score' first"
            raise ValueError(f"{self.directory}: {cause}")
        metrics = score_metrics if self.store.measured is None else measured_metrics
        return Scores(metrics(self.scene, tables), tables)

    def _known_scores(self) -> Scores | None:
        return None if self.store.score_tables() is None else self.scores


def _usable(campaign: Campaign, channel: Sequence[ChannelEstimate]) -> list[ChannelEstimate]:
    """The estimates without their weak paths; `ValueError` where one does not fit the others."""
    need("campaign", campaign, Campaign)
    need_each("channel", channel, ChannelEstimate)
    if not len(channel):
        raise ValueError("channel = []: must hold the estimate of one stop at least")
    check_estimates(channel, campaign.scene.tx)
    return [estimate.reported for estimate in channel]


def _check_stops(name: str, stops: Sequence[int], channel: Sequence[ChannelEstimate]) -> None:
    """Raise `ValueError` where stops, each once for every TX, are not those of the channel estimates."""
    found, wanted = list(dict.fromkeys(stops)), [estimate.stop for estimate in channel]
    if found != wanted:
        raise ValueError(f"{name}: stops {found}: must be those of the channel estimates, in order: {wanted}")


def _no_slam(truths: Sequence[Truth]) -> MapResult:
    """A map of SLAM that solved no stop."""
    return replace(empty_record(MapResult), poses=unsolved_poses([truth.stop for truth in truths]))
