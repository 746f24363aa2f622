"""A made-up measurement of a small room: its own simulated paths with known offsets, floor and object gains."""

from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from isac_arena.campaign.measured import MeasuredCampaign, MeasuredTruth
from isac_arena.insight.twin.twin import MODELS, simulate_stops
from isac_arena.scoring.provenance import path_origin
from scenes.config import load_scene
from scenes.pose import Pose
from scenes.scene import Scene
from sim.propagation.paths import Paths

REFERENCE_DBM, FLOOR_DBM = 55.0, -60.0
DELAY_OFFSET_S = 0.7e-9
TX_OFFSET_RAD = np.deg2rad([-4.6, -0.9])  # of the two sessions
SESSION_STOP, N_STOPS = 6, 12
BIAS_S = 33e-9
GAINS_DB = {"pillar": 2.0, "wall_south": -3.0}


@dataclass(frozen=True)
class Made:
    scene: Scene
    campaign: MeasuredCampaign
    simulated: list[Paths]
    heading_error_rad: np.ndarray


def make(rng, *, blind=(), gains=None, noise=(0.0, 0.0)) -> Made:
    """The room measured at 12 stops; `blind` stops lose their line of sight, `noise`: std of delay, angles."""
    scene = replace(
        load_scene("box_room"), ceiling=None
    )  # as far from the devices as the floor: indistinguishable
    poses = [Pose(np.array([x, 2.0, 1.5]), np.pi) for x in np.linspace(3.0, 8.5, N_STOPS)]
    empty = MeasuredCampaign(scene.tx, (), tuple(truth_of(pose, stop) for stop, pose in enumerate(poses)))
    simulated = list(simulate_stops(scene, empty, MODELS["one_bounce"], 60e9))
    heading_error = np.deg2rad(rng.uniform(-6, 6, N_STOPS))
    channel, truths = [], []
    for stop, (pose, all_paths) in enumerate(zip(poses, simulated, strict=True)):
        seen = all_paths.take("path", ~all_paths.is_los) if stop in blind else all_paths
        paths = seen.take("path", np.argsort(seen.delay_s))
        channel.append(estimate_of(stop, pose, paths, scene, heading_error[stop], gains or {}, noise, rng))
        truths.append(truth_of(pose, stop, paths))
    return Made(scene, MeasuredCampaign(scene.tx, tuple(channel), tuple(truths)), simulated, heading_error)


def estimate_of(stop, pose, paths, scene, heading_error, gains, noise, rng) -> ChannelEstimate:
    n = len(paths)
    tx_offset = TX_OFFSET_RAD[int(stop >= SESSION_STOP)]
    signal_db = REFERENCE_DBM + 10 * np.log10(paths.power)
    signal_db += [gains.get(name, 0.0) for name in path_origin(paths).object]
    level_dbm = 10 * np.log10(10 ** (signal_db / 10) + 10 ** (FLOOR_DBM / 10))
    draw = rng.standard_normal((3, n))
    return ChannelEstimate(
        stop=stop,
        delay_s=paths.delay_s + DELAY_OFFSET_S + BIAS_S + noise[0] * draw[0],
        aod_azimuth_rad=paths.aod_azimuth_rad - scene.tx.heading_rad - tx_offset + noise[1] * draw[1],
        aoa_azimuth_rad=paths.aoa_azimuth_rad - pose.heading_rad - heading_error + noise[1] * draw[2],
        power_dbm=level_dbm,
        beam_loss_db=np.zeros(n),
        snr_db=np.zeros(n),
        covariance=np.tile(np.eye(3), (n, 1, 1)),
        is_los=paths.is_los,
    )


def truth_of(pose, stop, paths=None) -> MeasuredTruth:
    n = 0 if paths is None else len(paths)
    return MeasuredTruth(
        rx_pose=pose,
        stop=stop,
        clock_bias_s=BIAS_S,
        is_los=np.zeros(0, bool) if paths is None else paths.is_los,
        is_single_bounce=np.zeros(0, bool) if paths is None else paths.is_single_bounce,
        landmark_m=np.full((n, 2), np.nan),
    )


def with_weak_path(made: Made, power_dbm: float) -> MeasuredCampaign:
    """The campaign with one more path at every stop that nothing explains, at the given power."""
    channel, truths = [], []
    for estimate, truth in zip(made.campaign.channel, made.campaign.truths, strict=True):
        n = len(estimate)
        doubled = np.append(np.arange(n), n - 1)
        last = np.arange(n + 1) == n
        estimate, truth = (one.take("path", doubled) for one in (estimate, truth))  # noqa: PLW2901
        channel.append(
            replace(
                estimate,
                delay_s=np.where(last, 500e-9, estimate.delay_s),
                power_dbm=np.where(last, power_dbm, estimate.power_dbm),
            )
        )
        truths.append(replace(truth, is_single_bounce=truth.is_single_bounce | last, is_los=truth.is_los & ~last))
    return MeasuredCampaign(made.campaign.tx, tuple(channel), tuple(truths))
