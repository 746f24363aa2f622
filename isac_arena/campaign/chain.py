"""The estimation chain: sweeps to channel estimates, to maps, to shapes. Pure: records in, records out."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from estimation.channel.calibration.self_calibration import Calibration
from estimation.channel.estimate import ChannelEstimator, checked_estimate, estimate_channel
from estimation.channel.model.delay import hann_window
from estimation.channel.power.detect import noise_threshold
from estimation.channel.power_map import BeamPowerMap
from estimation.channel.record import ChannelEstimate
from estimation.shape.contours import estimate_contours
from estimation.shape.gp.estimate import estimate_shapes
from estimation.slam.checks import check_estimates
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.slam.space.mapping import map_stops_spatial
from estimation.slam.space.problem import is_spatial
from estimation.slam.stops import locate_and_map
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.measured import MeasuredTruth
from isac_arena.campaign.results import CampaignResults, MapResult
from isac_arena.scoring.config import Significance
from isac_arena.scoring.link_view import link_view
from isac_arena.scoring.score import Scores, score_campaign
from scenes.pose import Pose
from scenes.scene import Scene
from sim.observation import BeamSweep
from sim.signal.link import Link, best_beam_power_dbm
from sim.truth import Truth


def channel_estimator(
    config: CampaignConfig, name: str | None = None, calibration: Calibration | None = None
) -> ChannelEstimator:
    """The channel estimator to run: the method of the settings, or a user's `package.module:function`.

    The function takes a `BeamSweep` and returns a `ChannelEstimate`. A calibration replaces the nominal codebooks
    for the methods of the settings; a user's function gets the sweep as it is.

    Raises
    ------
    ValueError
        Where the name has another form, cannot be imported or is no function; and, when called, where the
        function returns something else than the `ChannelEstimate` of the same stop.
    """
    if name is None:
        return lambda sweep: estimate_channel(
            sweep if calibration is None else calibration.applied(sweep), config=config.channel
        )
    function = _imported(name)

    def checked(sweep: BeamSweep) -> ChannelEstimate:
        try:
            estimate = function(sweep)
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise ValueError(f"estimator = '{name}' at stop {sweep.stop}: {reason}") from error
        return checked_estimate(estimate, sweep, name)

    return checked


def known_receiver(truths: Iterable[Truth | MeasuredTruth]) -> PoseEstimates:
    """The true receiver states as given poses: what mapping, and only mapping, is told."""
    states = [(t.stop, *t.rx_pose.position_m, t.rx_pose.heading_rad, t.clock_bias_s) for t in truths]
    table = np.array(states, float).reshape(-1, 6)
    return PoseEstimates(
        stop=table[:, 0].astype(int),
        position_m=table[:, 1:3],
        heading_rad=table[:, 4],
        clock_bias_s=table[:, 5],
        status=np.full(len(table), SolveStatus.GIVEN),
        n_inliers=np.zeros(len(table), int),
        cost=np.zeros(len(table)),
        height_m=table[:, 3],
        height_std_m=np.zeros(len(table)),
    )


def map_known(
    config: CampaignConfig, channel: Sequence[ChannelEstimate], tx_pose: Pose, receiver: PoseEstimates
) -> MapResult:
    """Mapping: incidence points from known receiver states, then shapes."""
    check_estimates(channel, tx_pose)
    spatial = is_spatial(channel, use_elevation=config.mapping.use_elevation)
    ips = (map_stops_spatial if spatial else map_stops)(channel, receiver, tx_pose, config.mapping)
    return _with_shapes(config, channel, tx_pose, receiver, ips)


def map_unknown(config: CampaignConfig, channel: Sequence[ChannelEstimate], tx_pose: Pose) -> MapResult:
    """SLAM: receiver states and incidence points together, then shapes.

    Every stop on its own, or all stops together or by a filter where the campaign has a `trajectory` table; with
    heights where elevations were estimated.
    """
    check_estimates(channel, tx_pose)
    poses, ips = locate_and_map(channel, tx_pose, config.slam, config.trajectory, config.mapping)
    return _with_shapes(config, channel, tx_pose, poses, ips)


def _with_shapes(
    config: CampaignConfig,
    channel: Sequence[ChannelEstimate],
    tx_pose: Pose,
    poses: PoseEstimates,
    ips: IncidencePoints,
) -> MapResult:
    """The map with the paper's shapes of its clusters and our contours of its objects."""
    shapes = estimate_shapes(ips, config.shapes)
    contours = estimate_contours(
        channel, tx_pose, poses, ips, shapes.label, config.mapping.noise, config.contours
    )
    return MapResult(poses, ips, shapes, contours)


def map_both(
    config: CampaignConfig,
    channel: Sequence[ChannelEstimate],
    power_maps: Sequence[BeamPowerMap],
    tx_pose: Pose,
    receiver: PoseEstimates,
) -> CampaignResults:
    """All estimates of a campaign, from the channel estimates of its stops; `receiver` is what mapping is told."""
    return CampaignResults(
        channel=tuple(channel),
        power_maps=tuple(power_maps),
        mapping=map_known(config, channel, tx_pose, receiver),
        slam=map_unknown(config, channel, tx_pose),
    )


def score_simulated(
    config: CampaignConfig, link: Link, scene: Scene, truths: Iterable[Truth], results: CampaignResults
) -> Scores:
    """Score a simulated campaign; raises as `score_campaign` does."""
    return score_campaign(
        scene,
        truths,
        results,
        true_power_dbm=lambda truth: best_beam_power_dbm(truth.paths, link, scene.tx, truth.rx_pose),
        significance=significance(config, link),
        view=link_view(config, link, scene),
    )


def significance(config: CampaignConfig, link: Link) -> Significance:
    """Which true paths the power-only method has a fair chance to detect: its dynamic range and its threshold."""
    n_tx, n_subcarriers = link.prs_symbol.shape
    threshold = noise_threshold(
        n_tx * len(link.rx_codebook) * n_subcarriers, config.channel.power.false_alarm_probability
    )
    noise_mw = link.noise_power_mw.max() * (hann_window(n_subcarriers) ** 2).sum() / n_subcarriers**2
    return Significance(
        dynamic_range_db=config.channel.power.dynamic_range_db,
        noise_threshold_dbm=float(10 * np.log10(threshold * noise_mw)),
    )


def _imported(name: str) -> Callable[[BeamSweep], object]:
    module_name, colon, function_name = name.partition(":")
    if not (module_name and colon and function_name):
        raise ValueError(f"estimator = '{name}': write it as package.module:function")
    try:
        function = getattr(importlib.import_module(module_name), function_name)
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        raise ValueError(f"estimator = '{name}': cannot be imported ({reason})") from error
    if not callable(function):
        raise ValueError(f"estimator = '{name}': is no function")
    return function  # type: ignore[no-any-return]
