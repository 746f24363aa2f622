"""A measured campaign: surveyed poses and labels in place of simulated paths, and the channel estimates."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.checks import check_estimates
from estimation.slam.config import PathNoise
from scenes.pose import SPEED_OF_LIGHT_M_S, Pose, wrap_angle
from scenes.record import BoolArray, FloatArray, IntArray, Record, array

INITIAL_BIAS_M = 10.0
BIAS_STEP_STD_M = 1.0
STRAIGHT_RAD = np.deg2rad(3.0)  # of a path along the straight line: errors of headings and of angles
PUBLISHED_TX_OFFSET_DEG = -1.6
# The published measurement covariance of the GP paper; the file holds none.
PUBLISHED_NOISE = PathNoise(source="fixed", delay_std_ns=1.0, angle_std_deg=1.0)
# The residuals are 0.6 ns and 0.6 deg: the covariances are too wide, and so the default of `SnapshotConfig`.
PUBLISHED_MAX_POSITION_STD_M = 2.5


@dataclass(frozen=True)
class MeasuredTruth(Record):
    """One measured stop: the surveyed receiver and the labels of its paths, ordered as its channel estimate.

    The pose is NaN where it was not surveyed, and there are no labels where the paths were not labelled.
    """

    rx_pose: Pose
    stop: int = array(dtype=int, doc="index of the receiver stop")
    clock_bias_s: float = array(unit="s", doc="receiver minus transmitter clock, as added at the import, or NaN")
    is_los: BoolArray = array("path", dtype=bool, doc="labelled as line of sight")
    is_single_bounce: BoolArray = array("path", dtype=bool, doc="labelled as single bounce")
    landmark_m: FloatArray = array("path", "xy", unit="m", doc="labelled IP; NaN unless a single bounce")


@dataclass(frozen=True)
class MeasuredCampaign:
    """All stops of a measurement file. The TX heading holds its mounting offset."""

    tx: Pose
    channel: tuple[ChannelEstimate, ...]
    truths: tuple[MeasuredTruth, ...]


@dataclass(frozen=True)
class MeasuredStop:
    """One stop as the file has it: paths in the file's own order, angles in the array frames.

    What is None is not in the file: then noise and height of the campaign hold, and elevations are unknown.
    """

    rx: FloatArray  # (3,) x, y, heading in m, m, rad
    measured: FloatArray  # (path, 3) range without clock bias, AoD, AoA in m, rad, rad
    power_dbm: FloatArray  # (path,)
    is_los: BoolArray  # (path,)
    is_single_bounce: BoolArray  # (path,)
    landmark_m: FloatArray  # (path, xy)
    height_m: float | None = None  # of the receiver
    covariance: FloatArray | None = None  # (path, 3, 3), or (path, 5, 5) with elevations, in (s, rad, ...)^2
    elevation_rad: FloatArray | None = None  # (path, 2) of departure and arrival
    is_los_estimate: BoolArray | None = None  # (path,) taken as line of sight; by default the label


@dataclass(frozen=True)
class MeasuredFile:
    """The TX and all stops of a file of measured paths, and the clock bias (stop,) that it states, if any.

    NaN is a bias that is not known: the measured ranges contain it.
    """

    tx: Pose
    stops: list[MeasuredStop]
    bias_m: FloatArray | None = None


def unlabelled_stop(stop: int, rx_pose: Pose | None) -> MeasuredTruth:
    """A stop without labels, whose receiver was surveyed or not; its clock bias is not known."""
    return MeasuredTruth(
        rx_pose=rx_pose or Pose(np.full(3, np.nan), np.nan),
        stop=stop,
        clock_bias_s=np.nan,
        is_los=np.zeros(0, bool),
        is_single_bounce=np.zeros(0, bool),
        landmark_m=np.zeros((0, 2)),
    )


def with_clock(truth: MeasuredTruth, estimate: ChannelEstimate, tx: Pose) -> MeasuredTruth:
    """A stop whose clock bias, where it is not known, is that of its line of sight.

    That is the first path along the straight line between the devices; without one the bias stays unknown.
    """
    along_m = truth.rx_pose.position_m - tx.position_m
    if np.isfinite(truth.clock_bias_s) or not np.isfinite(along_m).all():
        return truth
    azimuth = np.arctan2(along_m[1], along_m[0])
    aod = wrap_angle(estimate.aod_azimuth_rad - azimuth + tx.heading_rad)
    aoa = wrap_angle(estimate.aoa_azimuth_rad - azimuth - np.pi + truth.rx_pose.heading_rad)
    straight = np.flatnonzero(np.maximum(np.abs(aod), np.abs(aoa)) < STRAIGHT_RAD)
    if not len(straight):
        return truth
    clock_s = estimate.delay_s[straight[0]] - np.linalg.norm(along_m) / SPEED_OF_LIGHT_M_S
    return replace(truth, clock_bias_s=float(clock_s))


def clock_walk_m(n_stops: int, rng: np.random.Generator) -> FloatArray:
    """Clock bias (stop,) in m of the published loader: from 10 m, a random walk of variance 1 m^2 per stop."""
    steps = BIAS_STEP_STD_M * rng.standard_normal(n_stops)
    return np.asarray(INITIAL_BIAS_M + np.cumsum(steps) - steps[:1].sum())


def measured_campaign(
    tx: Pose,
    stops: Sequence[MeasuredStop],
    bias_m: FloatArray,
    height_m: float = 0.0,
    noise: PathNoise = PUBLISHED_NOISE,
) -> MeasuredCampaign:
    """Channel estimates and labels of all stops, the paths sorted by delay and the clock bias (stop,) added.

    A bias of NaN is not known, and the ranges contain it.

    A path whose covariance is not in the file has that of `noise`; a line of sight is by default the labelled one.

    Raises `ValueError` where a stop repeats a path, or holds NaN or angles in degrees.
    """
    channel, truths = [], []
    for index, (stop, bias) in enumerate(zip(stops, bias_m, strict=True)):
        order = np.argsort(stop.measured[:, 0], kind="stable")
        estimate = _channel_estimate(index, stop, order, float(np.nan_to_num(bias)), noise)
        channel.append(estimate)
        truths.append(
            MeasuredTruth(
                rx_pose=Pose(
                    np.array([*stop.rx[:2], height_m if stop.height_m is None else stop.height_m]),
                    float(stop.rx[2]),
                ),
                stop=index,
                clock_bias_s=float(bias) / SPEED_OF_LIGHT_M_S,
                is_los=stop.is_los[order],
                is_single_bounce=stop.is_single_bounce[order],
                landmark_m=stop.landmark_m[order],
            )
        )
    check_estimates(channel, tx)
    return MeasuredCampaign(tx, tuple(channel), tuple(truths))


def _channel_estimate(
    index: int, stop: MeasuredStop, order: IntArray, bias_m: float, noise: PathNoise
) -> ChannelEstimate:
    n, angle_std_rad = len(order), np.deg2rad(noise.angle_std_deg)
    std = np.array([1e-9 * noise.delay_std_ns, angle_std_rad, angle_std_rad], float)
    fixed = np.tile(np.diag(std**2), (n, 1, 1))
    is_los = stop.is_los if stop.is_los_estimate is None else stop.is_los_estimate
    elevation = np.full((n, 2), np.nan) if stop.elevation_rad is None else stop.elevation_rad[order]
    return ChannelEstimate(
        stop=index,
        delay_s=(stop.measured[order, 0] + bias_m) / SPEED_OF_LIGHT_M_S,
        aod_azimuth_rad=stop.measured[order, 1],
        aoa_azimuth_rad=stop.measured[order, 2],
        power_dbm=stop.power_dbm[order],
        beam_loss_db=np.zeros(n),
        snr_db=np.zeros(n),
        covariance=fixed if stop.covariance is None else stop.covariance[order],
        is_los=is_los[order],
        aod_elevation_rad=elevation[:, 0],
        aoa_elevation_rad=elevation[:, 1],
    )
