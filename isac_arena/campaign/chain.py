"""The functions of the estimation chain: sweeps to channel estimates, to maps, to shapes. Records in, records out.

`driver.py` calls them in order.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from estimation.channel.calibration.self_calibration import Calibration
from estimation.channel.estimate import ChannelEstimator, estimate_channel
from estimation.channel.interference import whitened
from estimation.channel.model.delay import hann_window
from estimation.channel.power.detect import noise_threshold
from estimation.channel.record import ChannelEstimate
from estimation.channel.still import still_paths
from estimation.shape.contours import estimate_contours
from estimation.shape.gp.estimate import estimate_shapes, fit_shapes
from estimation.slam.checks import check_estimates
from estimation.slam.config import MappingConfig, TrajectoryConfig
from estimation.slam.level import KnownHeights, seen_from_above
from estimation.slam.mapping.incidence_points import map_stops
from estimation.slam.mapping.noise import with_learned_noise
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.slam.space.mapping import map_stops_spatial
from estimation.slam.space.problem import is_spatial
from estimation.slam.stops import locate_and_map
from estimation.slam.transmitters import AnyTx, Transmitters, map_each_tx, transmitters_of
from estimation.tracks.estimate import estimate_tracks
from estimation.tracks.record import EchoSurvey, Tracks
from isac_arena.campaign.config import CampaignConfig, with_own_level
from isac_arena.campaign.measured import MeasuredTruth
from isac_arena.campaign.results import MapResult
from isac_arena.scoring.config import Significance
from isac_arena.user_functions.config import UserFunction, UserFunctions, with_functions
from isac_arena.user_functions.room import called, caller
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose
from scenes.record import FloatArray, IntArray
from scenes.scene import Scene
from scenes.walks.trajectory import follow_one_another
from sim.clock import campaign_clock
from sim.config import ArrayConfig
from sim.observation import BeamSweep
from sim.signal.link import Link, line_of_sight_at_1m_dbm
from sim.transmitters import TxLink, tx_links
from sim.truth import Truth


def links_of(config: CampaignConfig, scene: Scene) -> tuple[TxLink[CampaignConfig], ...]:
    """The TX of a campaign; of one TX these settings and this scene.

    Raises `ValueError` as `sim.transmitters.tx_links` does, and where a function of a user is to see several TX.
    """
    found = tx_links(config, scene)
    own = [stage for stage in ("mapping", "slam", "shapes") if config.functions.of(stage) is not None]
    if own and len(found) > 1:
        raise ValueError(
            f"functions.{own[0]}: takes the paths of one TX, with {len(found)} TX only channel is allowed"
        )
    return tuple(replace(link, config=with_own_level(config, link.config)) for link in found)


def all_tx(configs: Sequence[CampaignConfig], poses: Sequence[Pose]) -> AnyTx:
    """The TX as mapping and SLAM take them: the pose of one, or all of several."""
    if len(poses) == 1:
        return poses[0]
    level_dbm = np.array([line_of_sight_at_1m_dbm(config) for config in configs])
    sync_ns = configs[0].slam.tx_sync_std_ns
    return Transmitters(tuple(poses), level_dbm - level_dbm[0], None if sync_ns is None else 1e-9 * sync_ns)


def channel_estimator(
    config: CampaignConfig, calibration: Calibration | None = None, *, is_disturbed: bool = False
) -> ChannelEstimator:
    """The channel estimator to run: the method of the settings, or the user's function that they name.

    A calibration replaces the nominal codebooks for the methods of the settings; where the sweep `is_disturbed` by
    another TX, they get the noise that it shows. A user's function gets the sweep as it is. Raises as
    `user_estimator` does.
    """
    if function := config.functions.of("channel"):
        return _user_estimator(function)
    whitens = is_disturbed and config.channel.interference == "whiten"

    def estimate(sweep: BeamSweep) -> ChannelEstimate:
        """The estimate by the method of the settings."""
        sweep = whitened(sweep) if whitens else sweep
        return estimate_channel(
            sweep if calibration is None else calibration.applied(sweep), config=config.channel
        )

    return estimate


def user_estimator(name: str) -> ChannelEstimator:
    """A user's channel estimator by name: it takes a `BeamSweep`, returns a `ChannelEstimate`.

    Raises `EstimatorError`, one line, where the name has another form, cannot be imported or is no function; and,
    when called, where the function fails or returns something else than the `ChannelEstimate` of the same stop.
    """
    named = with_functions(CampaignConfig(name="any", scene="any"), {"channel": name})
    return channel_estimator(named)


def _user_estimator(function: UserFunction) -> ChannelEstimator:
    call = caller("channel", function)

    def estimate(sweep: BeamSweep) -> ChannelEstimate:
        """The checked estimate of the user's function."""
        found: ChannelEstimate = call(sweep, where=f"stop {sweep.stop}: ")
        return found

    return estimate


def known_receiver(truths: Iterable[Truth | MeasuredTruth]) -> PoseEstimates:
    """The true receiver states as given poses: the input of mapping; SLAM does not use them.

    A stop that was not surveyed counts as unsolved: mapping leaves it out. The truths of several TX at a stop, one
    after the other, are one state with a clock bias for each.
    """
    states = [(t.stop, *t.rx_pose.position_m, t.rx_pose.heading_rad, t.clock_bias_s, _tx(t)) for t in truths]
    table = np.array(states, float).reshape(-1, 7)
    n_tx = int(table[:, 6].max(initial=0)) + 1
    clock_s, table = table[:, 5].reshape(-1, n_tx), table[::n_tx]
    return PoseEstimates(
        stop=table[:, 0].astype(int),
        position_m=table[:, 1:3],
        heading_rad=table[:, 4],
        clock_bias_s=table[:, 5],
        status=np.where(np.isfinite(table[:, 4]), SolveStatus.GIVEN, SolveStatus.FAILED),
        n_inliers=np.zeros(len(table), int),
        cost=np.zeros(len(table)),
        height_m=table[:, 3],
        height_std_m=np.zeros(len(table)),
        tx_clock_bias_s=clock_s,
    )


def _tx(truth: Truth | MeasuredTruth) -> int:
    return truth.tx if isinstance(truth, Truth) else 0


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
    check_estimates(channel, tx_pose)
    heights = known_heights(config, transmitters_of(tx_pose).poses, receiver, rx_height_m)
    mapping = None if receiver is None else learned_mapping(config, channel, tx_pose, receiver, heights)
    poses, ips = locate_or_take(config, channel, tx_pose, receiver, heights, config.trajectory, mapping)
    return with_shapes(config, channel, tx_pose, poses, ips, heights=heights, mapping=mapping)


def known_heights(
    config: CampaignConfig,
    tx_poses: Sequence[Pose],
    receiver: PoseEstimates | None = None,
    rx_height_m: FloatArray | None = None,
    tx_arrays: Sequence[ArrayConfig] = (),
) -> KnownHeights | None:
    """The heights that mapping and SLAM may use; None if the receiver's are unknown or `heights.use` is false.

    `tx_arrays` are those of the TX, by default that of the settings for all.
    """
    if rx_height_m is None and receiver is not None and np.isfinite(receiver.height_m).all():
        rx_height_m = receiver.height_m
    if rx_height_m is None or not config.heights.use:
        return None
    rx_panel_rad = np.deg2rad(config.rx_array.panel_azimuth_deg)
    every = [
        KnownHeights(
            pose.position_m[2] - rx_height_m,
            config.heights.std_m,
            np.deg2rad(array.panel_azimuth_deg),
            rx_panel_rad,
        )
        for pose, array in zip(tx_poses, tx_arrays or len(tx_poses) * (config.tx_array,), strict=True)
    ]
    return replace(every[0], others=tuple(every[1:]))


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


def walk_settings(config: CampaignConfig, position_m: FloatArray) -> TrajectoryConfig | None:
    """Settings with which the stops at `position_m` (stop, xyz) are solved together; None where each is alone."""
    method = config.trajectory.method
    alone = method == "single" or (method == "auto" and not follow_one_another(position_m))
    return None if alone else config.trajectory


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
        return locate_and_map(channel, tx_pose, config.slam, trajectory, config.mapping, heights)
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
    channel = seen_from_above(channel, poses.tx_clock_bias_s, heights)
    contours = estimate_contours(channel, tx_pose, poses, ips, shapes.label, mapping.noise, config.contours)
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


def unsolved_poses(stops: Sequence[int], n_tx: int = 1) -> PoseEstimates:
    """The receiver states of a SLAM that solved no stop."""
    n = len(stops)
    unknown = np.full(n, np.nan)
    return PoseEstimates(
        stop=np.array(stops, int), position_m=np.full((n, 2), np.nan), heading_rad=unknown, clock_bias_s=unknown,
        status=np.full(n, SolveStatus.FAILED), n_inliers=np.zeros(n, int), cost=unknown,
        tx_clock_bias_s=np.full((n, n_tx), np.nan),
    )  # fmt: skip


def significance(config: CampaignConfig, link: Link) -> Significance:
    """Which true paths the power-only method has a fair chance to detect: its dynamic range and its threshold."""
    n_tx, n_subcarriers = link.prs_symbol.shape
    false_alarm = config.channel.power.false_alarm_probability
    threshold = noise_threshold(n_tx * len(link.rx_codebook) * n_subcarriers, false_alarm)
    noise_mw = link.noise_power_mw.max() * (hann_window(n_subcarriers) ** 2).sum() / n_subcarriers**2
    return Significance(
        dynamic_range_db=config.channel.power.dynamic_range_db,
        noise_threshold_dbm=float(10 * np.log10(threshold * noise_mw)),
    )
