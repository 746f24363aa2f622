"""What echoes allow to know of the velocities of movers."""

from collections.abc import Sequence
from datetime import timedelta

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.record import PoseEstimates
from estimation.tracks.config import TrackConfig
from estimation.tracks.echoes import Echo, moving_echoes
from estimation.tracks.law import HEIGHT, N_STATE, VELOCITY, echo_of, residual
from estimation.tracks.record import EchoSurvey
from scenes.record import FloatArray

GATE = 4.0
NEAR = np.array([0.1, np.deg2rad(1.0), np.deg2rad(1.0), 0.1])  # m, rad, rad, m/s: of bodies that are no points


def velocity_bounds(
    channel: Sequence[ChannelEstimate],
    poses: PoseEstimates,
    survey: EchoSurvey,
    config: TrackConfig,
    state: FloatArray,
) -> FloatArray:
    """Bound (mover, stop) in m/s of the root mean square error of the velocity in the plan, both axes together.

    `state` (mover, stop, 5) are the true states. The information of the direct echoes of a mover that were found,
    at the covariances that channel estimation states for them and those of the receiver states, is joined with
    that of the motion model of `config`. The inverse is the posterior Cramer-Rao bound of a smoother (Tichavsky et
    al., IEEE Trans. SP 46(5), 1998): the mean over movers that the motion model draws. NaN before the first echo
    and after the last. An echo is of a mover if it is within `GATE` deviations of what the truth predicts, each
    `NEAR` at the least.
    """
    exact = config.model_copy(update=dict.fromkeys(("floor_range_m", "floor_angle_deg", "floor_rate_m_s"), 0.0))
    echoes = moving_echoes(channel, poses, survey, exact)
    bound = np.full(state.shape[:2], np.nan)
    for mover, states in enumerate(state):
        own = {row: found for row, of in enumerate(echoes) if (found := _direct(of, states[row])) is not None}
        if own:
            rows = np.arange(min(own), max(own) + 1)
            information = _of_motion(survey.time_s[rows], config)
            for row, one in own.items():
                here = slice((row - rows[0]) * N_STATE, (row - rows[0] + 1) * N_STATE)
                information[here, here] += _of_echo(one, states[row])
            variance = np.diag(np.linalg.inv(information)).reshape(-1, N_STATE)
            bound[mover, rows] = np.sqrt(variance[:, VELOCITY].sum(axis=1))
    return bound


def _direct(echoes: Sequence[Echo], state: FloatArray) -> Echo | None:
    """The echo that is nearest to what a mover shows; None where none is near."""
    off = [
        (residual(one.measured, echo_of(one.geometry, state)) ** 2 / (np.diag(one.covariance) + NEAR**2)).sum()
        for one in echoes
    ]
    return echoes[int(np.argmin(off))] if off and min(off) < GATE**2 else None


def _of_echo(one: Echo, state: FloatArray) -> FloatArray:
    """Information (5, 5) of an echo about the state of its mover."""
    from scipy.optimize import approx_fprime  # noqa: PLC0415  (slow to import)

    slope = approx_fprime(state, lambda mover: echo_of(one.geometry, mover), 1e-6)
    return np.asarray(slope.T @ np.linalg.solve(one.covariance, slope))


def _of_motion(time_s: FloatArray, config: TrackConfig) -> FloatArray:
    """Information of the motion model about the states at some times, (5 times, 5 times)."""
    from estimation.tracks.models import transition  # noqa: PLC0415  (brings Stone Soup, slow to import)

    n = len(time_s)
    information = np.zeros((n * N_STATE, n * N_STATE))
    information[VELOCITY, VELOCITY] = config.speed_std_m_s**-2.0
    information[HEIGHT, HEIGHT] = config.height_std_m**-2.0
    model = transition(config)
    for row, step_s in enumerate(np.diff(time_s)):
        step = timedelta(seconds=float(step_s))
        forward = np.hstack([-model.matrix(time_interval=step), np.eye(N_STATE)])
        both = slice(row * N_STATE, (row + 2) * N_STATE)
        information[both, both] += forward.T @ np.linalg.solve(model.covar(time_interval=step), forward)
    return information
