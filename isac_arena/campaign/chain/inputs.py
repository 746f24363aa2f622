"""What the stages of the chain take: links, channel estimators, known states and heights."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from estimation.channel.calibration.record import Calibration
from estimation.channel.interference import whitened
from estimation.channel.model.delay import hann_window
from estimation.channel.power.detect import noise_threshold
from estimation.channel.record import ChannelEstimate, ChannelEstimator
from estimation.slam.config import TrajectoryConfig
from estimation.slam.level import KnownHeights
from estimation.slam.record import PoseEstimates, SolveStatus
from estimation.slam.transmitters import AnyTx, Transmitters
from isac_arena.campaign.config import CampaignConfig, with_own_level
from isac_arena.campaign.measured import MeasuredTruth
from isac_arena.scoring.config import Significance
from isac_arena.user_functions.config import UserFunction, with_functions
from isac_arena.user_functions.room import caller
from scenes.arguments import need_each
from scenes.pose import Pose
from scenes.record import FloatArray
from scenes.scene import Scene
from scenes.walks.trajectory import follow_one_another
from sim.config import ArrayConfig, LinkKind
from sim.links import TxLink, tx_links
from sim.observation import BeamSweep
from sim.signal.link import Link, line_of_sight_at_1m_dbm
from sim.truth import Truth


def links_of(config: CampaignConfig, scene: Scene) -> tuple[TxLink[CampaignConfig], ...]:
    """The links of a campaign; of one TX these settings and this scene.

    Raises `ValueError` as `sim.links.tx_links` does, and where a function of a user is to see several TX.
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
    hears_itself = np.array([config.role.kind == LinkKind.MONOSTATIC for config in configs])
    if len(poses) == 1 and not hears_itself.any():
        return poses[0]
    level_dbm = np.array([line_of_sight_at_1m_dbm(config) for config in configs])
    sync_ns = configs[0].slam.tx_sync_std_ns
    sync_s = None if sync_ns is None else 1e-9 * sync_ns
    return Transmitters(tuple(poses), level_dbm - level_dbm[0], sync_s, hears_itself)


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
        # slow to import, kept estimates need none
        from estimation.channel.calibration.remaining import likelihood_settings, with_pointing_errors  # noqa: PLC0415
        from estimation.channel.estimate import estimate_channel  # noqa: PLC0415

        sweep = whitened(sweep) if whitens else sweep
        if calibration is None:
            return estimate_channel(sweep, config=config.channel)
        settings = likelihood_settings(config.channel, calibration)
        found = estimate_channel(calibration.applied(sweep), config=settings)
        return with_pointing_errors(found, calibration)

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


def known_receiver(truths: Iterable[Truth | MeasuredTruth], n_tx: int = 1) -> PoseEstimates:
    """The true receiver states as given poses: the input of mapping; SLAM does not use them.

    A stop that was not surveyed, or whose clock bias is unknown, counts as unsolved: mapping leaves it out. The
    truths of several TX at a stop, one after the other, are one state with a clock bias for each; that of a TX
    without a link there is NaN. There are clock biases of `n_tx` TX at least, also where the stops have fewer.
    """
    need_each("truths", truths, Truth, MeasuredTruth)
    states = [(t.stop, *(p := _stop_pose(t)).position_m, p.heading_rad, t.clock_bias_s, _tx(t)) for t in truths]
    table = np.array(states, float).reshape(-1, 7)
    tx, row = table[:, 6].astype(int), np.cumsum(np.diff(table[:, 0], prepend=np.nan) != 0) - 1
    clock_s = np.full((row.max(initial=-1) + 1, max(tx.max(initial=0) + 1, n_tx)), np.nan)
    clock_s[row, tx] = table[:, 5]
    table = table[np.unique(row, return_index=True)[1]]
    return PoseEstimates(
        stop=table[:, 0].astype(int),
        position_m=table[:, 1:3],
        heading_rad=table[:, 4],
        clock_bias_s=table[:, 5],
        status=np.where(np.isfinite(table[:, 4:6]).all(axis=1), SolveStatus.GIVEN, SolveStatus.FAILED),
        n_inliers=np.zeros(len(table), int),
        cost=np.zeros(len(table)),
        height_m=table[:, 3],
        height_std_m=np.zeros(len(table)),
        tx_clock_bias_s=clock_s,
    )


def _stop_pose(truth: Truth | MeasuredTruth) -> Pose:
    return truth.stop_pose if isinstance(truth, Truth) else truth.rx_pose


def _tx(truth: Truth | MeasuredTruth) -> int:
    return truth.tx if isinstance(truth, Truth) else 0


def known_heights(
    config: CampaignConfig,
    tx_poses: Sequence[Pose],
    receiver: PoseEstimates | None = None,
    rx_height_m: FloatArray | None = None,
    arrays: Sequence[tuple[ArrayConfig, ArrayConfig]] = (),
) -> KnownHeights | None:
    """The heights that mapping and SLAM may use; None if the receiver's are unknown or `heights.use` is false.

    `arrays` are those of the TX and the receiver of every link (of an uplink as if it were a downlink), by default
    those of the settings for all.
    """
    if rx_height_m is None and receiver is not None and np.isfinite(receiver.height_m).all():
        rx_height_m = receiver.height_m
    if rx_height_m is None or not config.heights.use:
        return None
    ends = arrays or len(tx_poses) * (config.end_arrays,)
    every = [
        KnownHeights(
            pose.position_m[2] - rx_height_m,
            config.heights.std_m,
            np.deg2rad(both[0].panel_azimuth_deg),
            np.deg2rad(both[1].panel_azimuth_deg),
        )
        for pose, both in zip(tx_poses, ends, strict=True)
    ]
    return replace(every[0], others=tuple(every[1:]))


def walk_settings(config: CampaignConfig, position_m: FloatArray) -> TrajectoryConfig | None:
    """Settings with which the stops at `position_m` (stop, xyz) are solved together; None where each is alone."""
    method = config.trajectory.method
    alone = method == "single" or (method == "auto" and not follow_one_another(position_m))
    return None if alone else config.trajectory


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
