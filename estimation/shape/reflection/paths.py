"""The paths of a campaign as data of the reflection law: bounces, lines of sight, poses and sessions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.laws.plane import measurement_vectors
from estimation.laws.raised import PathHeights
from estimation.shape.config import ContourConfig, ReflectionConfig
from estimation.shape.reflection.levels import is_level
from estimation.shape.reflection.raised import UprightPaths
from estimation.shape.reflection.reflections import Reflections
from estimation.shape.reflection.tx_sessions import Sessions, los_sessions, stop_rows
from estimation.slam.config import PathNoise
from estimation.slam.record import IncidencePoints, PoseEstimates, SolveStatus
from estimation.slam.transmitters import AnyTx, Transmitters, of_tx, rows_of_tx, transmitters_of
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray, IntArray, concatenate

KNOWN_CLOCK_STD_NS = 1e-3  # of a device that hears itself: one clock sends and receives
_CLASS_RIGHT = (0.2, 0.8)  # four of five classes are right: rows `class_right` of the halls
_TO_METRES = np.array([1.0, 1.0, 1.0, SPEED_OF_LIGHT_M_S])


@dataclass(frozen=True)
class CampaignPaths:
    """The data of the contours with their priors."""

    bounces: Reflections  # of the incidence points `upright`
    los: Reflections
    stop: IntArray  # (stop,) all stops of the campaign
    sessions: Sessions  # of these stops, with the offsets removed from the departures
    widening: float  # factor on the standard deviations of poses that were found from these paths
    config: ReflectionConfig  # with the priors of the offsets that are observable
    upright: IntArray  # rows of the incidence points that are on neither floor nor ceiling
    may_turn: bool = False  # poses found stop by stop: the TX heading may jump between them

    def only(self, upright: UprightPaths) -> "CampaignPaths":
        """The data without what is on floor and ceiling."""
        return replace(self, bounces=upright.of(self.bounces), upright=self.upright[upright.kept])


def campaign_paths(
    channel: Sequence[ChannelEstimate],
    tx_pose: AnyTx,
    poses: PoseEstimates,
    ips: IncidencePoints,
    noise: PathNoise,
    config: ContourConfig,
    heights: Sequence[PathHeights] = (),
) -> CampaignPaths:
    """Paths with the poses of mapping or of SLAM; those not among the incidence points are lines of sight.

    A given pose has the accuracy of the survey. A pose of SLAM was found from the same paths and gets a wider
    covariance, so that no path counts twice. With SLAM an offset that all sessions share is unobservable, since
    it rotates everything about the TX; offsets that jump between sessions are observable. So are those of several
    TX, which all have offsets of their own. `heights` are those of every estimate, none where they are not known.
    """
    every, key = _all_paths(channel, tx_pose, poses, noise, config)
    every = _with_heights(every, key, channel, heights)
    row = {pair: k for k, pair in enumerate(key)}
    bounce = np.array([row[pair] for pair in zip(ips.stop.tolist(), ips.path.tolist(), strict=True)], int)
    direct = np.setdiff1d(np.arange(len(every)), bounce)
    upright = np.flatnonzero(~is_level(ips, _device_heights_m(tx_pose, poses)))
    bounces, los = every.take("path", bounce[upright]), every.take("path", direct)
    if poses.n_tx > 1:
        widening = 1.0 if poses.is_given else config.slam_widening
        every_tx = transmitters_of(tx_pose)
        return _of_several_tx(bounces, los, every_tx, poses.stop, widening, config.reflection, upright)
    sessions = los_sessions(los, transmitters_of(tx_pose).poses[0], poses.stop)
    if poses.is_given:
        joined = [replace(data, session=sessions.of_stop[stop_rows(data, poses.stop)]) for data in (bounces, los)]
        unknown = sessions._replace(offset_rad=0 * sessions.offset_rad, std_rad=0 * sessions.std_rad)
        return CampaignPaths(joined[0], joined[1], poses.stop, unknown, 1.0, config.reflection, upright)
    turned = [_turned(data, sessions.of_paths(data, poses.stop)) for data in (bounces, los)]
    anchored = config.reflection.model_copy(update={"aod_offset_std_deg": 0.0})
    alone = not poses.is_of_walk.any()
    return CampaignPaths(
        turned[0], turned[1], poses.stop, sessions, config.slam_widening, anchored, upright, alone
    )


def _of_several_tx(
    bounces: Reflections,
    los: Reflections,
    every: Transmitters,
    stop: IntArray,
    widening: float,
    config: ReflectionConfig,
    upright: IntArray,
) -> CampaignPaths:
    """Paths of several TX, the sessions of one TX after those of another; stops have those of the first."""
    parts = [los_sessions(los.take("path", los.clock == k), pose, stop) for k, pose in enumerate(every.poses)]
    count = np.array([len(part.offset_rad) for part in parts])
    of_link = np.array([part.of_stop for part in parts]) + (np.cumsum(count) - count)[:, None]
    joined = [replace(data, session=of_link[data.clock, stop_rows(data, stop)]) for data in (bounces, los)]
    none = np.zeros(int(count.sum()))
    return CampaignPaths(joined[0], joined[1], stop, Sessions(of_link[0], none, none), widening, config, upright)


def _device_heights_m(tx_pose: AnyTx, poses: PoseEstimates) -> tuple[float, float]:
    """The lowest and the highest known height of a device."""
    height = np.array([*(pose.position_m[2] for pose in transmitters_of(tx_pose).poses), *poses.height_m])
    return float(np.nanmin(height)), float(np.nanmax(height))


def in_plane(estimate: ChannelEstimate, covariance: FloatArray, bias_m: float) -> tuple[FloatArray, FloatArray]:
    """Measurements (path, 3) and covariances (path, 3, 3) of the paths projected on the plane, in m and rad.

    Upright surfaces keep the magnitude of the elevation of a ray: the length, without the clock bias, shrinks by
    its cosine. Where the elevation at one end is unknown that of the other end is used; without both the path is
    level.
    """
    measured = measurement_vectors(estimate.delay_s, estimate.aod_azimuth_rad, estimate.aoa_azimuth_rad)
    elevation = np.column_stack([estimate.aod_elevation_rad, estimate.aoa_elevation_rad])
    known = np.isfinite(elevation)
    share = known / np.maximum(known.sum(axis=1, keepdims=True), 1)
    elevation = np.where(known, elevation, 0.0)
    cosine = np.where(known.any(axis=1), np.sum(share * np.cos(elevation), axis=1), 1.0)
    length = measured[:, 0] - bias_m
    measured[:, 0] = bias_m + length * cosine
    scale = np.column_stack([cosine, np.ones((len(cosine), 2))])
    covariance = covariance * scale[:, :, None] * scale[:, None, :]
    if estimate.covariance.shape[-1] > measured.shape[1]:
        slope = -length[:, None] * share * np.sin(elevation)
        variance = np.nan_to_num(np.diagonal(estimate.covariance[:, 3:, 3:], axis1=1, axis2=2))
        covariance[:, 0, 0] += np.sum(slope**2 * variance, axis=1)
    return measured, covariance


def _all_paths(
    channel: Sequence[ChannelEstimate],
    tx_pose: AnyTx,
    poses: PoseEstimates,
    noise: PathNoise,
    config: ContourConfig,
) -> tuple[Reflections, list[tuple[int, int]]]:
    """Paths of the solved stops, all in one session, with the stop and the index of each."""
    every = transmitters_of(tx_pose)
    if poses.n_tx > 1:
        return _paths_by_tx(channel, every, poses, noise, config)
    if every.hears_itself is not None and every.hears_itself[0]:
        config = config.model_copy(update={"survey_clock_std_ns": KNOWN_CLOCK_STD_NS})
    state = np.column_stack([poses.position_m, poses.heading_rad, SPEED_OF_LIGHT_M_S * poses.clock_bias_s])
    solved = (poses.status != SolveStatus.FAILED) & np.isfinite(state).all(axis=1)
    estimate = {item.stop: item for item in channel}
    used = [(k, estimate[stop]) for k, stop in enumerate(poses.stop.tolist()) if solved[k]]
    parts = [in_plane(item, noise.covariance(item), float(state[k, 3])) for k, item in used]
    row = np.repeat([k for k, _ in used], [len(item) for _, item in used]).astype(int)
    n = len(row)
    data = Reflections(
        measured=np.concatenate([np.zeros((0, 3)), *(part[0] for part in parts)]),
        covariance=np.concatenate([np.zeros((0, 3, 3)), *(part[1] for part in parts)]),
        tx=np.tile(every.rows[0], (n, 1)),
        rx_state=state[row],
        rx_covariance=_pose_covariance(poses, config)[row],
        session=np.zeros(n, dtype=np.int64),
        stop=poses.stop[row],
        specular_probability=np.concatenate([np.zeros(0), *(_specular_probability(item) for _, item in used)]),
    )
    return data, [(item.stop, path) for _, item in used for path in range(len(item))]


def _specular_probability(estimate: ChannelEstimate) -> FloatArray:
    """Probability (path,) of each path to be specular, by its class in a hall that was read."""
    if estimate.hall is None:
        return np.full(len(estimate), 0.5)
    return np.clip(estimate.hall.specular_probability, *_CLASS_RIGHT)


def _paths_by_tx(
    channel: Sequence[ChannelEstimate],
    every: Transmitters,
    poses: PoseEstimates,
    noise: PathNoise,
    config: ContourConfig,
) -> tuple[Reflections, list[tuple[int, int]]]:
    """`_all_paths` of several TX, one TX after the other."""
    parts: list[Reflections] = []
    keys: list[tuple[int, int]] = []
    for index in range(len(every)):
        data, key = _all_paths(of_tx(channel, index), every.alone(index), poses.of_tx(index), noise, config)
        rows = dict(zip((item.stop for item in channel), rows_of_tx(channel, index), strict=True))
        parts.append(replace(data, clock=np.full(len(data), index)))
        keys += [(stop, int(rows[stop][path])) for stop, path in key]
    return concatenate(parts, "path"), keys


def _with_heights(
    paths: Reflections,
    key: Sequence[tuple[int, int]],
    channel: Sequence[ChannelEstimate],
    heights: Sequence[PathHeights],
) -> Reflections:
    """Paths of the stops and indices `key` with what their heights need; not where elevations are known."""
    if not heights or not len(paths):
        return paths
    own = {estimate.stop: pair for pair in zip(channel, heights, strict=True) for estimate in pair[:1]}
    difference_m, boresight_rad = paths.difference_m.copy(), paths.boresight_rad.copy()
    for row, (stop, path) in enumerate(key):
        estimate, ends = own[stop]
        if not np.isfinite([estimate.aod_elevation_rad[path], estimate.aoa_elevation_rad[path]]).any():
            difference_m[row], boresight_rad[row] = ends.difference_m[path], ends.boresight_rad[path]
    return replace(paths, difference_m=difference_m, boresight_rad=boresight_rad)


def _pose_covariance(poses: PoseEstimates, config: ContourConfig) -> FloatArray:
    """Covariance (stop, 4, 4) in m, m, rad, m: that of SLAM, or of the survey where the pose was given."""
    survey = np.diag(config.survey_std**2)
    covariance = poses.covariance * np.outer(_TO_METRES, _TO_METRES)
    unknown = ~np.isfinite(covariance).all(axis=(1, 2)) | (poses.status == SolveStatus.GIVEN)
    return np.where(unknown[:, None, None], survey, covariance)


def _turned(data: Reflections, offset_rad: FloatArray) -> Reflections:
    """Paths without an offset (path,) of the departures."""
    shift = np.zeros((len(data), 3))
    shift[:, 1] = offset_rad
    return replace(data, measured=data.measured - shift)
