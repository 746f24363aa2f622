"""Tracks of a campaign from its paths and a map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from estimation.channel.record import ChannelEstimate
from estimation.slam.record import PoseEstimates
from estimation.tracks.config import TrackConfig
from estimation.tracks.echoes import OneBounce, as_one_bounce, moving_echoes
from estimation.tracks.law import HEIGHT, N_STATE, POSITION, VELOCITY
from estimation.tracks.record import EchoSurvey, Tracks

if TYPE_CHECKING:
    from estimation.tracks.tracker import Tracked


def estimate_tracks(
    channel: Sequence[ChannelEstimate], poses: PoseEstimates, survey: EchoSurvey, config: TrackConfig
) -> Tracks | None:
    """The tracks of what moves; None where no estimate knows motion, or the settings ask for none."""
    if config.method == "none" or not any(estimate.motion is not None for estimate in channel):
        return None
    bounces = echoes_of_one_bounce(channel, poses, survey, config)
    from estimation.tracks.nearest import track_nearest  # noqa: PLC0415  (brings Stone Soup, slow to import)
    from estimation.tracks.tracker import track_echoes  # noqa: PLC0415

    method = track_echoes if config.method == "bernoulli" else track_nearest
    tracked = method(bounces, survey.time_s, config)
    rows = np.array([row for one in tracked for row in one.rows], int)
    states = [state for one in tracked for state in one.track]
    mean = np.array([np.ravel(state.state_vector) for state in states], float).reshape(-1, N_STATE)
    order = [*POSITION, *VELOCITY, HEIGHT]
    covariance = np.array([state.covar for state in states], float).reshape(-1, N_STATE, N_STATE)
    length = [len(one.rows) for one in tracked]
    owner = {
        id(echo): number
        for number, one in enumerate(tracked)
        for echo in [*one.echoes.values(), *(each for _, each in one.body)]
    }
    echoes = [one for found in bounces for one in found]
    return Tracks(
        survey=survey,
        track=np.repeat(np.arange(len(tracked)), length),
        stop=survey.stop[rows],
        position_m=mean[:, POSITION],
        velocity_m_s=mean[:, VELOCITY],
        height_m=mean[:, HEIGHT],
        covariance=covariance[:, order][:, :, order],
        existence=np.array([value for one in tracked for value in one.existence]),
        extent_m=np.repeat([_extent_m(one) for one in tracked], length),
        echo_stop=survey.stop[[one.echo.stop for one in echoes]],
        echo_path=np.array([one.echo.path for one in echoes], int),
        echo_track=np.array([owner.get(id(one), -1) for one in echoes], int),
    )


def echoes_of_one_bounce(
    channel: Sequence[ChannelEstimate], poses: PoseEstimates, survey: EchoSurvey, config: TrackConfig
) -> list[list[OneBounce]]:
    """All paths that move, stop by stop, as echoes of one bounce."""
    return [
        [as_one_bounce(echo, config) for echo in found] for found in moving_echoes(channel, poses, survey, config)
    ]


def _extent_m(one: Tracked) -> float:
    """Root mean square distance in m of the further echoes of a body to its track, beyond their own errors."""
    place = {row: np.ravel(state.state_vector)[POSITION] for row, state in zip(one.rows, one.track, strict=True)}
    excess = [
        np.square(echo.state[POSITION] - place[row]).sum() - np.trace(echo.spread[np.ix_(POSITION, POSITION)])
        for row, echo in one.body
        if row in place
    ]
    return float(np.sqrt(max(np.mean(excess), 0.0))) if excess else 0.0
