"""The paths of a stop that move, as echoes of movers: measurements, covariances, and the ends of their way."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from estimation.channel.record import AngleKind, ChannelEstimate
from estimation.channel.still import still_motion
from estimation.laws.level import nearest_boresight
from estimation.laws.plane import start_point
from estimation.slam.record import PoseEstimates, SolveStatus
from estimation.tracks.config import TrackConfig
from estimation.tracks.law import HEIGHT, N_MEASURED, N_STATE, POSITION, VELOCITY, EchoGeometry, echo_of, residual
from estimation.tracks.record import EchoSurvey
from scenes.pose import SPEED_OF_LIGHT_M_S
from scenes.record import FloatArray

UNKNOWN_POSE_STD_M = 0.02  # of a receiver state without covariance


@dataclass(frozen=True)
class Echo:
    """One path that moves."""

    stop: int
    path: int
    measured: FloatArray  # (4,) as `estimation.tracks.law`
    covariance: FloatArray  # (4, 4) with the floors of the settings and the errors of the receiver state
    geometry: EchoGeometry


@dataclass(frozen=True)
class OneBounce:
    """An echo as that of one bounce: linear in the state of a mover near the one that it shows."""

    echo: Echo
    state: FloatArray  # (5,) that fits best
    spread: FloatArray  # (5, 5) its covariance
    chi_square: float  # squared deviations, usual speeds and height included: 2 degrees of freedom
    slope: FloatArray  # (4, 5)
    measured: FloatArray  # (4,) of which `slope` times the state is the prediction


def moving_echoes(
    channel: Sequence[ChannelEstimate], poses: PoseEstimates, survey: EchoSurvey, config: TrackConfig
) -> list[list[Echo]]:
    """The echoes of every stop, in the order of the paths; none where the receiver state is unknown."""
    return [_of_stop(estimate, row, poses, survey, config) for row, estimate in enumerate(channel)]


def _of_stop(
    estimate: ChannelEstimate, row: int, poses: PoseEstimates, survey: EchoSurvey, config: TrackConfig
) -> list[Echo]:
    still, own_hz = still_motion(estimate)
    motion, position = estimate.motion, poses.position_m[row]
    if motion is None or still.all() or not np.isfinite([*position, poses.heading_rad[row]]).all():
        return []
    heading = float(poses.heading_rad[row])
    c, s = np.cos(heading), np.sin(heading)
    own = np.append(survey.wavelength_m * np.array([(c, -s), (s, c)]) @ own_hz, 0.0)
    echoes = []
    for path in np.flatnonzero(~still & motion.is_moving).tolist():  # frozen ones show nothing
        tx_m = survey.tx_m[estimate.tx[path]]
        height = poses.height_m[row] if np.isfinite(poses.height_m[row]) else tx_m[2]
        geometry = EchoGeometry(
            tx_m, float(survey.tx_heading_rad[estimate.tx[path]]), np.append(position, height), heading, own,
            _boresights(estimate, path, survey), float(motion.seen_s[path]),
        )  # fmt: skip
        bias_s = poses.tx_clock_bias_s[row, estimate.tx[path]]
        length_m = SPEED_OF_LIGHT_M_S * (estimate.delay_s[path] - bias_s)
        if not length_m > np.linalg.norm(geometry.rx_m - geometry.tx_m):
            continue  # no echo is shorter than the line of sight
        angles = estimate.aod_azimuth_rad[path], estimate.aoa_azimuth_rad[path]
        measured = np.array([length_m, *angles, -survey.wavelength_m * motion.doppler_hz[path]])
        covariance = _covariance(estimate, path, row, poses, survey, config, length_m)
        echoes.append(Echo(row, path, measured, covariance, geometry))
    return echoes


def _boresights(estimate: ChannelEstimate, path: int, survey: EchoSurvey) -> FloatArray:
    ends = (
        (estimate.aod_angle_kind, estimate.aod_azimuth_rad, survey.tx_panel_rad),
        (estimate.aoa_angle_kind, estimate.aoa_azimuth_rad, survey.rx_panel_rad),
    )
    return np.array(
        [
            float(nearest_boresight(azimuth[path : path + 1], panel)[0]) if kind == AngleKind.CONE else np.nan
            for kind, azimuth, panel in ends
        ]
    )


def _covariance(
    estimate: ChannelEstimate, path: int, row: int, poses: PoseEstimates, survey: EchoSurvey, config: TrackConfig,
    length_m: float,
) -> FloatArray:  # fmt: skip
    """Covariance (4, 4) of an echo: its own, the floors, and what the receiver state adds, as seen at half way."""
    assert estimate.motion is not None
    scale = np.array([SPEED_OF_LIGHT_M_S, 1.0, 1.0])
    found = np.zeros((4, 4))
    found[:3, :3] = estimate.plane_covariance[path] * scale * scale[:, None]
    std_hz = estimate.motion.doppler_std_hz[path]
    found[3, 3] = np.square(survey.wavelength_m * (std_hz if np.isfinite(std_hz) else 1.0))
    angle = np.deg2rad(config.floor_angle_deg)
    found += np.diag(np.square([config.floor_range_m, angle, angle, config.floor_rate_m_s]))
    state = poses.covariance[row][:4, :4]
    if not np.isfinite(state).all():
        std_m = 0.0 if poses.status[row] == SolveStatus.GIVEN else UNKNOWN_POSE_STD_M
        state = np.diag(np.square([std_m, std_m, 0.0, 0.0]))
    place = float(np.trace(state[:2, :2])) / 2
    clock_m2 = state[3, 3] * SPEED_OF_LIGHT_M_S**2
    return found + np.diag([place + clock_m2, 0.0, state[2, 2] + place / (length_m / 2) ** 2, 0.0])


def as_one_bounce(echo: Echo, config: TrackConfig) -> OneBounce:
    """The mover that an echo of one bounce shows best, with the height and the speeds that movers have."""
    from scipy.optimize import least_squares  # noqa: PLC0415  (slow to import)

    ends = echo.geometry
    row = np.array([*ends.tx_m[:2], ends.tx_heading_rad])
    state = np.array([*ends.rx_m[:2], ends.rx_heading_rad, 0.0])
    start = np.zeros(N_STATE)
    start[POSITION], start[HEIGHT] = start_point(row, state, echo.measured[:3]), config.height_m
    root = np.linalg.cholesky(echo.covariance)
    prior = np.array([*VELOCITY, HEIGHT])
    mean, std = start[prior], np.array([config.speed_std_m_s, config.speed_std_m_s, config.height_std_m])

    def off(mover: FloatArray) -> FloatArray:
        ray = residual(echo.measured, echo_of(ends, mover))
        return np.concatenate([solve_triangular(root, ray, lower=True), (mover[prior] - mean) / std])

    found = least_squares(off, start, jac="3-point")
    slope = -root @ found.jac[:N_MEASURED]
    about = residual(echo.measured, echo_of(ends, found.x)) + slope @ found.x
    spread = np.linalg.inv(found.jac.T @ found.jac)
    return OneBounce(echo, found.x, spread, float(2 * found.cost), slope, about)
