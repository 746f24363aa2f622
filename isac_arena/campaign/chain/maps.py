"""Maps from channel estimates: receiver states, incidence points, shapes, and the tracks of what moves."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.channel.still import still_paths
from estimation.shape.contours import estimate_contours
from estimation.shape.gp.estimate import estimate_shapes, fit_shapes
from estimation.slam.checks import check_estimates
from estimation.slam.config import MappingConfig, TrajectoryConfig
from estimation.slam.level import KnownHeights, seen_from_above
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.mapping.noise import with_learned_noise
from estimation.slam.pointing import with_array_pointing
from estimation.slam.record import IncidencePoints, PoseEstimates
from estimation.slam.space.mapping import map_stops_spatial
from estimation.slam.space.problem import is_spatial
from estimation.slam.stops import locate_and_map
from estimation.slam.transmitters import AnyTx, map_each_tx, transmitters_of
from estimation.tracks.estimate import estimate_tracks
from estimation.tracks.record import EchoSurvey, Tracks
from isac_arena.campaign.chain.inputs import known_heights
from isac_arena.campaign.config import CampaignConfig
from isac_arena.campaign.results import MapResult
from isac_arena.user_functions.config import UserFunctions
from isac_arena.user_functions.room import called
from scenes.arguments import need, need_each
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray, IntArray
from scenes.scene import Scene
from sim.clock import campaign_clock


def make_map(
    config: CampaignConfig,
    channel: Sequence[ChannelEstimate],
    tx_pose: AnyTx,
    receiver: PoseEstimates | None = None,
    rx_height_m: FloatArray | None = None,
) -> MapResult:
    """The map of all stops: mapping from the given receiver states, SLAM without any.

    `rx_height_m` (stop,) are the heights of the receiver where they are known; by default those of `receiver`.
    """
    need("config", config, CampaignConfig)
    need_each("channel", channel, ChannelEstimate)
    check_estimates(channel, tx_pose)
    heights = known_heights(config, transmitters_of(tx_pose).poses, receiver, rx_height_m)
    mapping = None if receiver is None else learned_mapping(config, channel, tx_pose, receiver, heights)
    poses, ips = locate_or_take(config, channel, tx_pose, receiver, heights, config.trajectory, mapping)
    return with_shapes(config, channel, tx_pose, poses, ips, heights=heights, mapping=mapping)


def campaign_tracks(
    config: CampaignConfig, scene: Scene, tx: AnyTx, channel: Sequence[ChannelEstimate], poses: PoseEstimates
) -> Tracks | None:
    """The tracks of what moves, at receiver states; None where nothing does.

    A function of the settings may take the place of our tracker; raises `EstimatorError` where it fails.
    """
    if not scene.is_moving:
        return None
    survey = echo_survey(config, scene, tx, poses.stop)
    if function := config.functions.of("tracker"):
        found: Tracks = called("tracker", function, list(channel), poses, survey)
        return found
    return estimate_tracks(channel, poses, survey, config.tracks)


def echo_survey(config: CampaignConfig, scene: Scene, tx: AnyTx, stop: IntArray) -> EchoSurvey:
    """What the tracker knows beside paths and receiver states, at some stops of a world that moves."""
    poses = transmitters_of(tx).poses
    return EchoSurvey(
        stop=stop,
        time_s=campaign_clock(config, scene).middle_s[stop],
        tx_m=np.array([pose.position_m for pose in poses]),
        tx_heading_rad=np.array([pose.heading_rad for pose in poses]),
        wavelength_m=SPEED_OF_LIGHT_M_S / (1e9 * config.waveform.carrier_ghz),
        tx_panel_rad=np.deg2rad(config.tx_array.panel_azimuth_deg),
        rx_panel_rad=np.deg2rad(config.rx_array.panel_azimuth_deg),
    )


def learned_mapping(
    config: CampaignConfig,
    channel: Sequence[ChannelEstimate],
    tx_pose: AnyTx,
    poses: PoseEstimates,
    heights: KnownHeights | None = None,
) -> MappingConfig:
    """The settings of mapping with the noise that the paths show at given states; unchanged for other states."""
    channel = still_paths(channel).channel
    seen = seen_from_above(channel, poses.tx_clock_bias_s, heights)
    spatial = is_spatial(channel, use_elevation=config.mapping.use_elevation)
    return with_learned_noise(seen, poses, tx_pose, config.mapping, spatial=spatial)


def locate_or_take(
    config: CampaignConfig,
    channel: Sequence[ChannelEstimate],
    tx_pose: AnyTx,
    receiver: PoseEstimates | None = None,
    heights: KnownHeights | None = None,
    trajectory: TrajectoryConfig | None = None,
    mapping: MappingConfig | None = None,
) -> tuple[PoseEstimates, IncidencePoints]:
    """Receiver states and incidence points: the given states and their points, or both found together (SLAM).

    SLAM solves every stop alone, or all stops together with a `trajectory`. Both work in space where elevations
    were estimated, else with the `heights` that are known. `mapping` is `learned_mapping` of the given states,
    where the caller has it. Functions of the settings take their place; raises `EstimatorError` where one fails.
    Paths that move are left out; points have the numbers of their paths among all.
    """
    still = still_paths(channel)
    poses, ips = _located(config, still.channel, tx_pose, receiver, heights, trajectory, mapping)
    return poses, replace(ips, path=still.of_all(ips.stop, ips.path))


def _located(
    config: CampaignConfig,
    channel: Sequence[ChannelEstimate],
    tx_pose: AnyTx,
    receiver: PoseEstimates | None,
    heights: KnownHeights | None,
    trajectory: TrajectoryConfig | None,
    mapping: MappingConfig | None,
) -> tuple[PoseEstimates, IncidencePoints]:
    """As `locate_or_take`, from paths that stand."""
    if receiver is None:
        if function := config.functions.of("slam"):
            found: tuple[PoseEstimates, IncidencePoints] = called(
                "slam", function, list(channel), tx_pose, heights
            )
            return found
        slam = config.slam.model_copy(update={"consider": with_array_pointing(config.slam.consider, channel)})
        return locate_and_map(channel, tx_pose, slam, trajectory, config.mapping, heights)
    if function := config.functions.of("mapping"):
        return receiver, called("mapping", function, list(channel), tx_pose, receiver)
    seen = seen_from_above(channel, receiver.tx_clock_bias_s, heights)
    spatial = is_spatial(channel, use_elevation=config.mapping.use_elevation)
    mapping = mapping or learned_mapping(config, channel, tx_pose, receiver, heights)
    return receiver, map_each_tx(map_stops_spatial if spatial else map_stops, seen, receiver, tx_pose, mapping)


def with_shapes(
    config: CampaignConfig,
    channel: Sequence[ChannelEstimate],
    tx_pose: AnyTx,
    poses: PoseEstimates,
    ips: IncidencePoints,
    label: IntArray | None = None,
    heights: KnownHeights | None = None,
    mapping: MappingConfig | None = None,
) -> MapResult:
    """The map with the paper's shapes of its clusters and our contours of its objects.

    `label` (ip,) is the cluster of every incidence point, -1 for none; without it DBSCAN finds the clusters.
    `mapping` is `learned_mapping` of the states, where the caller has it. A function of the settings may take the
    place of our contours; raises `EstimatorError` where it fails. Paths that move are left out.
    """
    still, every = still_paths(channel), ips
    channel, ips = still.channel, replace(ips, path=still.of_still(ips.stop, ips.path))
    shapes = estimate_shapes(ips, config.shapes) if label is None else fit_shapes(ips, label, config.shapes)
    if function := config.functions.of("shapes"):
        return MapResult(poses, every, shapes, called("shapes", function, list(channel), tx_pose, poses, ips))
    mapping = mapping or learned_mapping(config, channel, tx_pose, poses, heights)
    ends = () if heights is None else heights.of_paths(channel)
    channel = seen_from_above(channel, poses.tx_clock_bias_s, heights)
    common = None if config.functions.of("slam") else with_array_pointing(config.slam.consider, channel)
    contours = estimate_contours(
        channel, tx_pose, poses, ips, shapes.label, mapping.noise, config.contours, ends, common
    )
    return MapResult(poses, every, shapes, contours)


def without_map(
    config: CampaignConfig,
    channel: Sequence[ChannelEstimate],
    tx_pose: AnyTx,
    poses: PoseEstimates,
    ips: IncidencePoints,
    problem: str,
) -> MapResult:
    """The map where a user's function failed: the states and points that there are, clusters, and no contours."""
    ours = config.contours.model_copy(update={"method": "none"})
    without = config.model_copy(update={"contours": ours, "functions": UserFunctions()})
    return replace(with_shapes(without, channel, tx_pose, poses, ips), problem=problem)
