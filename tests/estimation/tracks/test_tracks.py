"""Tracks of movers from made echoes: the law of an echo, association, ghosts, and velocities at their bound."""

from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest

from estimation.channel.record import AngleKind, ChannelEstimate, PathMotion
from estimation.slam.record import PoseEstimates, SolveStatus
from estimation.tracks.bounds import velocity_bounds
from estimation.tracks.config import TrackConfig
from estimation.tracks.echoes import as_one_bounce, moving_echoes
from estimation.tracks.estimate import estimate_tracks
from estimation.tracks.law import EchoGeometry, echo_of
from estimation.tracks.models import transition
from estimation.tracks.record import EchoSurvey
from scenes.pose import SPEED_OF_LIGHT_M_S

STD = np.array([0.01, 0.001, 0.001, 0.005])  # m, rad, rad, m/s
CONFIG = TrackConfig(floor_range_m=0.0, floor_angle_deg=0.0, floor_rate_m_s=0.0)
WAVELENGTH_M = 0.005
SURVEY = EchoSurvey(
    np.arange(8), 0.4 * np.arange(8), np.array([[0.0, 0.0, 1.8]]), np.array([0.3]), WAVELENGTH_M,
    np.array([0.0]), np.deg2rad([-135.0, -45.0, 45.0, 135.0]),
)  # fmt: skip
RX_M = np.column_stack([2.0 + 0.4 * np.arange(8), np.full(8, -3.0)])
HEADING_RAD = 0.7
OWN_M_S = np.array([1.0, 0.0, 0.0])


def _geometry(stop, boresight_rad=(0.0, np.nan), seen_s=0.003):
    return EchoGeometry(
        SURVEY.tx_m[0], 0.3, np.append(RX_M[stop], 1.8), HEADING_RAD, OWN_M_S, np.array(boresight_rad), seen_s
    )


def _poses():
    n = len(RX_M)
    return PoseEstimates(
        SURVEY.stop, RX_M, np.full(n, HEADING_RAD), np.full(n, 3e-8), np.full(n, SolveStatus.GIVEN),
        np.zeros(n, int), np.zeros(n), height_m=np.full(n, 1.8), height_std_m=np.zeros(n),
    )  # fmt: skip


def _estimate(stop, echoes):
    """Echoes (echo, 4) and four still paths that give away how the receiver moves."""
    n, still = len(echoes), np.deg2rad([0.0, 80.0, 170.0, -100.0])
    level = OWN_M_S[:2] @ np.stack([np.cos(still + HEADING_RAD), np.sin(still + HEADING_RAD)])
    still_rows = np.column_stack([np.full(4, 30.0), 0 * still, still, -level])
    rows = np.vstack([np.reshape(echoes, (n, 4)), still_rows])
    delay_s = rows[:, 0] / SPEED_OF_LIGHT_M_S + 3e-8
    order = np.argsort(delay_s, kind="stable")
    scale = np.array([1 / SPEED_OF_LIGHT_M_S, 1.0, 1.0])
    rows, delay_s, zero = rows[order], delay_s[order], np.zeros(n + 4)
    return ChannelEstimate(
        stop, delay_s, rows[:, 1], rows[:, 2], zero - 60.0, zero, zero + 40.0,
        np.tile(np.diag((STD[:3] * scale) ** 2), (n + 4, 1, 1)), zero.astype(bool), aod_angle_kind=AngleKind.CONE,
        motion=PathMotion(
            zero == 0, -rows[:, 3] / WAVELENGTH_M, zero + STD[3] / WAVELENGTH_M, zero + 0.003
        ),
    )  # fmt: skip


def _channel(states, rng, ghosts=0):
    """Estimates of movers (mover, stop, 5), with ghosts whose rays do not meet."""
    channel = []
    for stop in range(len(RX_M)):
        echoes = np.array([echo_of(_geometry(stop), one[stop]) for one in states]) + STD * rng.normal(
            size=(len(states), 4)
        )
        false = np.column_stack(
            [rng.uniform(12, 25, ghosts), *rng.uniform(-1, 1, (2, ghosts)), rng.uniform(-2, 2, ghosts)]
        )
        channel.append(_estimate(stop, np.vstack([echoes, false])))
    return channel


def _straight(start_m, velocity_m_s, height_m=0.9):
    t = SURVEY.time_s[:, None]
    place = np.asarray(start_m) + t * np.asarray(velocity_m_s)
    speed = np.broadcast_to(velocity_m_s, place.shape)
    return np.column_stack([place[:, 0], speed[:, 0], place[:, 1], speed[:, 1], np.full(len(t), height_m)])


def test_the_rate_of_an_echo_is_the_derivative_of_its_length():
    state, step_s = np.array([3.0, 0.8, 2.0, -0.5, 0.9]), 1e-5
    lengths = []
    for sign in (-1, 1):
        moved = state + sign * step_s * np.array([0.8, 0, -0.5, 0, 0])
        there = replace(_geometry(0), rx_m=_geometry(0).rx_m + sign * step_s * OWN_M_S)
        lengths.append(echo_of(there, moved)[0])
    length, _, aoa, rate = echo_of(_geometry(0, seen_s=0.0), state)
    assert rate == pytest.approx(np.diff(lengths)[0] / (2 * step_s), rel=1e-7)
    assert length == pytest.approx(np.hypot(np.hypot(3, 2), 0.9) + np.hypot(np.hypot(1, 5), 0.9))
    assert aoa == pytest.approx(np.arctan2(5, 1) - HEADING_RAD)


def test_an_echo_of_one_bounce_shows_its_mover_and_a_ghost_none():
    state = _straight([4.0, 1.0], [0.5, 0.8])
    channel = _channel([state], np.random.default_rng(1))
    (echo,) = moving_echoes(channel, _poses(), SURVEY, CONFIG)[2]
    found = as_one_bounce(echo, CONFIG)
    assert np.hypot(*(found.state[[0, 2]] - state[2, [0, 2]])) < 0.05 and found.chi_square < 9
    detour = replace(echo, measured=echo.measured + np.array([2.0, 0, 0, 0]))
    assert as_one_bounce(detour, CONFIG).chi_square > CONFIG.most_chi_square


def test_two_movers_are_followed_among_ghosts():
    states = [_straight([4.0, 1.0], [0.5, 0.8]), _straight([5.5, 3.0], [-0.6, -0.4], 0.3)]
    channel = _channel(states, np.random.default_rng(2), ghosts=4)
    tracks = estimate_tracks(channel, _poses(), SURVEY, CONFIG)
    nearest = [np.linalg.norm(tracks.position_m - one[tracks.stop][:, [0, 2]], axis=1) for one in states]
    for near, other in (nearest, nearest[::-1]):
        own = near < 0.1
        assert sorted(tracks.stop[own]) == list(range(8)) and len(set(tracks.track[own])) == 1
        assert (other[own] > 0.1).all()
    assert tracks.n_tracks <= 4 and (tracks.extent_m >= 0).all()
    again = estimate_tracks(channel, _poses(), SURVEY, CONFIG)
    assert (again.position_m == tracks.position_m).all()
    plain = estimate_tracks(channel, _poses(), SURVEY, CONFIG.model_copy(update={"method": "nearest"}))
    assert plain.n_tracks > 2 * tracks.n_tracks


def test_no_motion_no_tracks():
    channel = _channel([_straight([4.0, 1.0], [0.5, 0.8])], np.random.default_rng(3))
    assert estimate_tracks(channel, _poses(), SURVEY, CONFIG.model_copy(update={"method": "none"})) is None
    frozen = [replace(one, motion=None) for one in channel]
    assert estimate_tracks(frozen, _poses(), SURVEY, CONFIG) is None
    lost = replace(_poses(), position_m=np.full((8, 2), np.nan))
    assert estimate_tracks(channel, lost, SURVEY, CONFIG).n_tracks == 0


def test_velocities_reach_their_bound():
    """Movers drawn from the motion model, alone: the smoother is as good as the bound allows."""
    rng = np.random.default_rng(4)
    model, errors, bounds = transition(CONFIG), [], []
    step = timedelta(seconds=0.4)
    forward, noise = model.matrix(time_interval=step), model.covar(time_interval=step)
    for _ in range(25):
        state = [np.array([5.0, *rng.normal(0, 1, 1), 2.0, *rng.normal(0, 1, 1), 0.8])]
        for _ in range(7):
            state.append(rng.multivariate_normal(forward @ state[-1], noise))
        states = np.array(state)
        channel = _channel([states], rng)
        bound = velocity_bounds(channel, _poses(), SURVEY, CONFIG, states[None])[0]
        tracks = estimate_tracks(channel, _poses(), SURVEY, CONFIG)
        own = tracks.track == 0
        errors.append(np.linalg.norm(tracks.velocity_m_s[own] - states[tracks.stop[own]][:, [1, 3]], axis=1))
        bounds.append(bound[tracks.stop[own]])
    ratio = np.sqrt(np.mean(np.concatenate(errors) ** 2) / np.mean(np.concatenate(bounds) ** 2))
    assert 0.8 < ratio < 1.25
