"""The one driver of the chain: truths, sweeps, calibration, channel estimates, maps, scores.

A `CampaignRun` states what is computed (which stops), from what (settings, scene, paths traced before), what
replaces a stage (a user's function, another way to make sweeps, truth) and where results are kept. Stages use kept
results and make the others. Every stop has its own random numbers, so any subset of stops gives the same bits.
A stage is imported when it runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, get_args

import numpy as np

from estimation.channel.calibration.record import Calibration, spread_rows
from estimation.channel.config import SelfCalibrationConfig
from estimation.channel.record import ChannelEstimate, ChannelEstimator, EstimateStatus, empty_estimate
from estimation.slam.config import MappingConfig, TrajectoryConfig
from estimation.slam.level import KnownHeights
from estimation.slam.record import IncidencePoints, PoseEstimates
from estimation.slam.transmitters import AnyTx
from estimation.steps import STEPS
from isac_arena.campaign.chain.inputs import (
    all_tx,
    channel_estimator,
    known_heights,
    known_receiver,
    significance,
    walk_settings,
)
from isac_arena.campaign.chain.links import disturbing, runs_of_links
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.results import CampaignResults, MapName, MapResult, MemoryResults, Oracle, ResultStore
from isac_arena.progress import told
from isac_arena.scoring.score import Scores
from isac_arena.user_functions.errors import EstimatorError
from scenes.record import FloatArray
from scenes.scene import Scene
from sim.observation import BeamSweep
from sim.signal.hardware.apply_impairments import with_surveyed_pose
from sim.signal.link import Link, best_beam_power_dbm, make_link
from sim.simulate import OtherTx, clock_biases_s, observe, simulate_truth
from sim.truth import Truth

if TYPE_CHECKING:
    from isac_arena.scoring.true_stop import TrueStop

Channel = Sequence[ChannelEstimate]
Observe = Callable[[CampaignConfig, Link, Scene, Truth], BeamSweep]


@dataclass(frozen=True, repr=False)
class CampaignRun:
    """One run of the chain; `scores` is the whole of it.

    `stops` are indices into the walk of the scene: by default those of `paths`, without `paths` all. `paths` are
    truths whose paths replace traced ones. `observer` makes the sweep of a stop. `oracle` replaces records by
    truth. Where a user's function fails the run ends with `EstimatorError`; or, with `on_failure`, it tells that
    the error and goes on without: the stop has no paths, the map no points or no contours.
    """

    config: CampaignConfig
    scene: Scene
    results: ResultStore = field(default_factory=MemoryResults)
    stops: Sequence[int] | None = None
    paths: Sequence[Truth] = ()
    observer: Observe = observe
    oracle: Oracle = field(default_factory=Oracle)
    on_failure: Callable[[EstimatorError], None] | None = None
    on_step: Callable[[str], None] = STEPS.info  # is told every one of `MAP_STEPS` when it begins
    whole: CampaignRun | None = None  # of several TX: the run of all, where this one is of one TX
    only: Sequence[int] | None = None  # numbers of the links of this run, None for all

    @told(lambda self: f"run of {len(self.chosen_stops)} stops")
    def scores(self) -> Scores:
        """The scores of all estimates; raises as `score_campaign` does."""
        truths = list(self.truths())
        return self.score(truths, self.estimates(truths))

    def estimates(self, truths: Sequence[Truth]) -> CampaignResults:
        """All estimates at the stops of the truths."""
        channel = tuple(self.channel(truths))
        return CampaignResults(channel, (), **self.maps(channel, self.surveyed_receiver(truths)))

    def __repr__(self) -> str:
        return f"CampaignRun({self.config.name!r}: {len(self.chosen_stops)} of {len(self.scene.stops)} stops)"

    def channel_scores(self) -> Scores:
        """The scores of the channel estimates alone: no later stage runs. Raises as `score_campaign` does."""
        from isac_arena.scoring.chain import channel_scores_of  # noqa: PLC0415

        truths = list(self.truths())
        return channel_scores_of(self.true_stops(truths), list(self.channel(truths)))

    def truths(self) -> Iterator[Truth]:
        """The truth of every stop in order, of several TX or links one after the other."""
        return (link.truth(stop) for stop in self.chosen_stops for link in self.links_at(stop))

    def truth(self, stop: int) -> Truth:
        """The truth of a stop: given, kept or traced paths, and the clock of these settings; of the first TX."""
        if self.links[0] is not self:
            return self.links_at(stop)[0].truth(stop)
        truth = next((one for one in self.paths if one.stop == stop), None) or self.results.truth(stop)
        if truth is None:
            wanted, traced = self._tracing
            wanted.append(stop)
            try:
                truth = replace(next(traced), tx=self.config.tx_number)
            except BaseException:
                self.__dict__.pop("_tracing")  # it ended with the error
                raise
            self.results.write_truth(truth)
        return replace(truth, clock_bias_s=float(self._clock_biases_s[stop]), tx=self.config.tx_number)

    def sweep(self, truth: Truth) -> BeamSweep:
        """The samples of a stop, kept or made, of the TX of the truth."""
        link = self.link_of(truth)
        if (kept := link.results.sweep(truth.stop)) is not None:
            return kept
        if link.disturbers and link.observer is observe:
            there = [one for one in link.disturbers if truth.stop in one.chosen_stops]
            others = [OtherTx(one.config, one.link, one.scene, one.truth(truth.stop)) for one in there]
            return observe(link.config, link.link, link.scene, truth, others)
        return link.observer(link.config, link.link, link.scene, truth)

    @property
    def calibrates(self) -> bool:
        """Whether the arrays of a link are calibrated from its own stops."""
        return any(link._calibration is not None for link in self.links)

    @property
    def _calibration(self) -> SelfCalibrationConfig | None:
        """The settings of self-calibration; None where it is off, and where a user's estimator gets none."""
        channel = self.config.channel
        wanted = channel.self_calibration.use
        is_off = wanted == "never" or (wanted == "auto" and channel.method == "power")
        return None if is_off or self.config.functions.of("channel") else channel.self_calibration

    def calibrate(self) -> Calibration | None:
        """The self-calibration of both arrays, kept or made from some stops; None where it is off.

        Arrays that show no errors stay as designed. A user's estimator gets no calibration. Each of several TX has
        its own.
        """
        if self.links[0] is not self:
            first, *_ = [link.calibrate() for link in self.links]
            return first
        if (settings := self._calibration) is None:
            return None
        calibration = self.results.calibration()
        if calibration is None:
            from estimation.channel.calibration.self_calibration import self_calibrate  # noqa: PLC0415

            chosen = [self.chosen_stops[row] for row in spread_rows(len(self.chosen_stops), settings.stops)]
            kept = ((stop, self.results.sweep(stop)) for stop in chosen)
            sweeps = (self.sweep(self.truth(stop)) if sweep is None else sweep for stop, sweep in kept)
            calibration = self_calibrate(sweeps, settings, self.config.channel.maximum_likelihood)
            self.results.write_calibration(calibration)
        return calibration

    def channel(self, truths: Iterable[Truth]) -> Iterator[ChannelEstimate]:
        """The paths reported at every stop, of all TX in `truths`, kept or made with one sweep in memory.

        In a hall the versions of a path by floor and ceiling are tied, so all stops are estimated first.
        """
        from isac_arena.campaign.chain.halls import in_halls  # noqa: PLC0415

        reported: list[list[ChannelEstimate]] = [[] for _ in self.links]
        for stop, group in groupby(truths, key=lambda truth: truth.stop):
            STEPS.info(f"channel estimate of stop {stop}")
            for truth in group:
                reported[self._row(truth)].append(self._kept_estimate(truth).reported)
        yield from in_halls(self, reported)

    def _kept_estimate(self, truth: Truth) -> ChannelEstimate:
        kept = self.link_of(truth).results.estimate(truth.stop)
        return self.estimate(truth) if kept is None else kept

    def estimate(self, truth: Truth, sweep: BeamSweep | None = None) -> ChannelEstimate:
        """The channel estimate of a stop, made now and kept; from `sweep` where the caller has it."""
        if (link := self.link_of(truth)) is not self:
            return link.estimate(truth, sweep)
        estimator = self.channel_estimator  # first: it may be calibrated on sweeps of its own
        return self.estimate_sweep(self.sweep(truth) if sweep is None else sweep, estimator)

    def estimate_sweep(self, sweep: BeamSweep, estimator: ChannelEstimator | None = None) -> ChannelEstimate:
        """The channel estimate of a sweep, made now and kept."""
        estimator = estimator or self.channel_estimator
        try:
            estimate = estimator(sweep)
        except EstimatorError as error:
            self.tell(error)
            estimate = empty_estimate(sweep.stop, "function", EstimateStatus.FAILED, str(error))
        self.results.write_estimate(estimate, sweep)
        return estimate

    def maps(self, channel: Channel, receiver: PoseEstimates) -> dict[MapName, MapResult]:
        """Both maps, kept or made: mapping from the given receiver states, SLAM without them."""
        names: tuple[MapName, ...] = get_args(MapName)
        return {name: self.map(name, channel, receiver) for name in names}

    def map(self, name: MapName, channel: Channel, receiver: PoseEstimates) -> MapResult:
        """One of the maps, kept or made."""
        from isac_arena.campaign.chain.one_map import one_map  # noqa: PLC0415

        return one_map(self, name, channel, receiver)

    def learned_mapping(self, channel: Channel, receiver: PoseEstimates | None) -> MappingConfig | None:
        """The settings of mapping at given states; None for SLAM."""
        from isac_arena.campaign.chain.maps import learned_mapping  # noqa: PLC0415

        channel = channel if self.oracle.channel is None else self.oracle.channel
        receiver = receiver if self.oracle.receiver is None else self.oracle.receiver
        return None if receiver is None else learned_mapping(self.config, channel, self.tx, receiver, self.heights)

    def tell(self, error: EstimatorError) -> None:
        """Say the error of a user's function, or raise it where nobody listens."""
        if self.on_failure is None:
            raise error
        self.on_failure(error)

    def locate(
        self, channel: Channel, receiver: PoseEstimates | None = None, mapping: MappingConfig | None = None
    ) -> tuple[PoseEstimates, IncidencePoints]:
        """Receiver states and incidence points: of the given states, or found together (SLAM).

        `mapping` is `learned_mapping` of the given states, where the caller has it.
        """
        from isac_arena.campaign.chain.maps import locate_or_take  # noqa: PLC0415

        tx, oracle = self.tx, self.oracle
        channel = channel if oracle.channel is None else oracle.channel
        receiver = receiver if oracle.receiver is None else oracle.receiver
        poses, ips = locate_or_take(self.config, channel, tx, receiver, self.heights, self.trajectory, mapping)
        if oracle.has_all_points:
            if receiver is None:
                _, ips = locate_or_take(self.config, channel, tx, poses, self.heights)
            ips = replace(ips, is_inlier=np.asarray(np.isfinite(ips.position_m).all(axis=1)))
        return poses, ips

    def shape(
        self, channel: Channel, poses: PoseEstimates, ips: IncidencePoints, mapping: MappingConfig | None = None
    ) -> MapResult:
        """The map with the shapes of its clusters and the contours of its objects; `mapping` as for `locate`."""
        from isac_arena.campaign.chain.maps import with_shapes  # noqa: PLC0415

        channel = channel if self.oracle.channel is None else self.oracle.channel
        label = None if self.oracle.clusters is None else self.oracle.clusters(ips)
        return with_shapes(self.config, channel, self.tx, poses, ips, label, self.heights, mapping)

    def score(self, truths: Iterable[Truth], results: CampaignResults) -> Scores:
        """The scores of estimates against the truth; raises as `score_campaign` does."""
        from isac_arena.scoring.chain import score_stops  # noqa: PLC0415

        return score_stops(self.scene, self.true_stops(truths), results, motion=self.config.tracks)

    def true_stops(self, truths: Iterable[Truth]) -> Iterator[TrueStop]:
        """The truths prepared for scoring, each with the view of its link."""
        from isac_arena.scoring.link_view import link_view  # noqa: PLC0415
        from isac_arena.scoring.true_stop import true_stop  # noqa: PLC0415

        views = [(significance(r.config, r.link), link_view(r.config, r.link, r.scene)) for r in self.links]
        for truth in truths:
            link, (limits, view) = self.link_of(truth), views[self._row(truth)]
            yield true_stop(truth, truth.tx_pose or link.scene.tx, link.true_power_dbm(truth), limits, view)

    def surveyed_receiver(self, truths: Iterable[Truth]) -> PoseEstimates:
        """The receiver states that mapping gets: the true ones with the errors of the survey."""
        surveyed = (with_surveyed_pose(self.link_of(truth).config, truth) for truth in truths)
        return known_receiver(surveyed, len(self.links))

    def true_power_dbm(self, truth: Truth) -> FloatArray:
        """Received power (path,) of the true paths in their best beam pairs."""
        return best_beam_power_dbm(truth.paths, self.link, truth.tx_pose or self.scene.tx, truth.rx_pose)

    def link_of(self, truth: Truth) -> CampaignRun:
        """The run of the TX of a truth."""
        return self.links[self._row(truth)]

    def _row(self, truth: Truth) -> int:
        return truth.tx if len(self.links) > 1 else 0

    def links_at(self, stop: int) -> list[CampaignRun]:
        """The runs of the links of a stop, in order."""
        return [link for link in self.links if stop in link.chosen_stops]

    @cached_property
    def links(self) -> tuple[CampaignRun, ...]:
        """A run for every TX or link; of a campaign with one TX this run itself."""
        return runs_of_links(self)

    @cached_property
    def disturbers(self) -> tuple[CampaignRun, ...]:
        """The other TX that are heard in the sweeps of this one."""
        return disturbing(self)

    @cached_property
    def tx(self) -> AnyTx:
        """The TX as mapping and SLAM take it: its pose, or all of several."""
        return all_tx([link.config for link in self.links], [link.scene.tx for link in self.links])

    @cached_property
    def heights(self) -> KnownHeights | None:
        """The surveyed heights of the devices, where mapping and SLAM may use them."""
        rx_height_m = self.scene.walk.positions_m()[list(self.chosen_stops), 2]
        poses, arrays = ([one.scene.tx for one in self.links], [one.config.end_arrays for one in self.links])
        return known_heights(self.config, poses, rx_height_m=rx_height_m, arrays=arrays)

    @cached_property
    def trajectory(self) -> TrajectoryConfig | None:
        """Settings with which SLAM solves all stops together; None where it solves each alone."""
        return walk_settings(self.config, self.scene.walk.positions_m()[list(self.chosen_stops)])

    @cached_property
    def chosen_stops(self) -> Sequence[int]:
        """The stops of this run, in order."""
        if self.stops is not None:
            return self.stops
        return list(dict.fromkeys(truth.stop for truth in self.paths)) or range(len(self.scene.stops))

    @cached_property
    def link(self) -> Link:
        """The link of the settings; of the first of several TX."""
        return make_link(self.config) if self.links[0] is self else self.links[0].link

    @cached_property
    def channel_estimator(self) -> ChannelEstimator:
        """The channel estimator, calibrated where the settings ask for it."""
        return channel_estimator(self.config, self.calibrate(), is_disturbed=bool(self.disturbers))

    @cached_property
    def _tracing(self) -> tuple[list[int], Iterator[Truth]]:
        """Stops to trace, and their truths: the scene is prepared once, one stop is taken per `next`."""
        wanted: list[int] = []
        return wanted, simulate_truth(self.config, self.scene, iter(wanted.pop, None))

    @cached_property
    def _clock_biases_s(self) -> FloatArray:
        return clock_biases_s(self.config, len(self.scene.stops))
