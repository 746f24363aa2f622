"""Sessions of a campaign: stretches between which the heading offset of the TX jumps.

At given poses the lines of sight show the offsets. Poses that SLAM found stop by stop hide them: an error of the
TX heading turns everything of a stop about the TX, its receiver included, and no stop by itself can tell. Objects
that several stops see do tell: a stop turned against the others misses them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimation.laws.plane import bounce_jacobian_rx, predict_los, residual
from estimation.shape.reflection.bundle import fit_bundle
from estimation.shape.reflection.bundle_kinds import BundleObject
from estimation.shape.reflection.objects import Found
from estimation.shape.reflection.path_likelihood import N_COMMON
from estimation.shape.reflection.reflections import ReflectionConfig, Reflections, ray_points
from estimation.slam.walk.sessions import segment_offsets
from scenes.pose import Pose
from scenes.record import FloatArray, IntArray

MIN_SESSION_STOPS = 3
MIN_GAIN_NAT = 8.0  # of the log likelihood by a jump
_MAX_GROUPS = 60  # of stops that are given an offset each
_NORMAL_MEDIAN = 0.6745  # of the size of a standard normal number
_LEAST_SCATTER = 0.25  # stated accuracies are believed to be pessimistic by this factor at most


class Sessions(NamedTuple):
    """Sessions with the offsets of their departures relative to the longest one."""

    of_stop: IntArray  # (stop,) session of every stop
    offset_rad: FloatArray  # (session,)
    std_rad: FloatArray  # (session,)

    def of_paths(self, data: Reflections, stop: IntArray) -> FloatArray:
        """Offset (path,) of each path; `stop` (stop,) are the stops that the sessions are of."""
        return np.asarray(self.offset_rad[self.of_stop[rows_of(data, stop)]])


def one_session(stop: IntArray) -> Sessions:
    """All stops (stop,) in one session."""
    return Sessions(np.zeros(len(stop), dtype=np.int64), np.zeros(1), np.zeros(1))


def rows_of(data: Reflections, stop: IntArray) -> IntArray:
    """Row (path,) in `stop` (stop,) of the stop of each path."""
    row = {number: k for k, number in enumerate(stop.tolist())}
    return np.array([row[number] for number in data.stop.tolist()], dtype=np.int64)


def los_sessions(los: Reflections, tx_pose: Pose, stop: IntArray) -> Sessions:
    """Sessions by the departures of the lines of sight; one session without enough of them."""
    if len(los) < 2 * MIN_SESSION_STOPS:
        return one_session(stop)
    order = np.argsort(los.stop, kind="stable")
    expected = predict_los(tx_pose, los.rx_state[order])
    departure = residual(los.measured[order], expected)[:, 1]
    reach = np.hypot(*(los.rx_state[order, :2] - tx_pose.position_m[:2]).T)
    sideways = np.einsum("nii->n", los.rx_covariance[order][:, :2, :2]) / 2 / np.maximum(reach, 0.1) ** 2
    std = np.sqrt(los.covariance[order, 1, 1] + sideways)
    return _segmented(los.stop[order], departure, std * _scatter(departure / std), stop)


def object_sessions(
    objects: list[Found],
    bounces: Reflections,
    los: Reflections,
    stop: IntArray,
    config: ReflectionConfig,
) -> Sessions:
    """Sessions by how far every stop (stop,) has to turn about the TX to see the objects where the others do.

    Paths stand as SLAM left them; the objects are those of the `loosened` paths. All objects, states and offsets
    are solved together, first with an offset for every stop, or every few of them in a long campaign, which shows
    where the heading jumps; then with one for each session. Errors of stops that follow each other are alike, so
    a jump has to stand out of the errors of the sessions' offsets as well.
    """
    group = np.arange(len(stop)) * min(_MAX_GROUPS, len(stop)) // max(len(stop), 1)
    used = np.concatenate([np.zeros(0, dtype=np.int64), *(each.paths for each in objects)])
    seen = np.unique(group[rows_of(bounces, stop)[used]])
    if len(seen) < 2 * MIN_SESSION_STOPS:
        return one_session(stop)
    alone = Sessions(group, np.zeros(len(stop)), np.zeros(len(stop)))
    turn, covariance = _solved(objects, bounces, los, alone, stop, config)
    found = _segmented(seen, turn[seen], np.sqrt(np.diagonal(covariance))[seen], group)
    while len(found.offset_rad) > 1:
        offset, covariance = _solved(objects, bounces, los, found, stop, config)
        step = np.diff(np.eye(len(offset)), axis=0)
        gain = 0.5 * (step @ offset) ** 2 / np.diagonal(step @ covariance @ step.T)
        least = int(np.argmin(gain))
        if gain[least] >= MIN_GAIN_NAT:
            return _anchored(Sessions(found.of_stop, offset, np.sqrt(np.diagonal(covariance))))
        merged = found.of_stop - (found.of_stop > least)
        found = Sessions(merged, np.zeros(len(offset) - 1), np.zeros(len(offset) - 1))
    return found


def refined_sessions(
    objects: list[Found],
    bounces: Reflections,
    los: Reflections,
    sessions: Sessions,
    stop: IntArray,
    config: ReflectionConfig,
) -> Sessions:
    """The same sessions with the offsets that objects found after their turns show.

    Paths stand as SLAM left them.
    """
    turned = [turned_about_tx(data, sessions.of_paths(data, stop)) for data in (bounces, los)]
    left, covariance = _solved(objects, turned[0], turned[1], sessions, stop, config)
    if len(left) < len(sessions.offset_rad):
        return sessions
    return _anchored(Sessions(sessions.of_stop, sessions.offset_rad + left, np.sqrt(np.diagonal(covariance))))


def loosened(data: Reflections, config: ReflectionConfig) -> Reflections:
    """Paths whose covariances hold an error of the TX heading that SLAM took for true, as large as may be.

    It turns departure and receiver together, so that of the three measurements at fixed objects only one
    combination is lost.
    """
    by_rx = bounce_jacobian_rx(data.tx, data.rx_state, ray_points(data)[0])
    slope = np.einsum("nai,ni->na", by_rx, _turning(data))
    slope[:, 1] -= 1.0
    variance = np.deg2rad(config.aod_offset_std_deg) ** 2
    return replace(data, covariance=data.covariance + variance * slope[:, :, None] * slope[:, None, :])


def turned_about_tx(data: Reflections, offset_rad: FloatArray) -> Reflections:
    """Paths and poses with an error (path,) of the TX heading taken out that SLAM had taken for true."""
    cosine, sine = np.cos(offset_rad), np.sin(offset_rad)
    turn = np.zeros((len(data), 4, 4))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = cosine, sine, -sine, cosine
    turn[:, 2, 2], turn[:, 3, 3] = 1.0, 1.0
    state, measured = data.rx_state.copy(), data.measured.copy()
    state[:, :2] = data.tx[:, :2] + np.einsum(
        "nij,nj->ni", turn[:, :2, :2], data.rx_state[:, :2] - data.tx[:, :2]
    )
    state[:, 2] -= offset_rad
    measured[:, 1] -= offset_rad
    covariance = turn @ data.rx_covariance @ np.swapaxes(turn, 1, 2)
    return replace(data, measured=measured, rx_state=state, rx_covariance=covariance)


def _solved(
    objects: list[Found],
    bounces: Reflections,
    los: Reflections,
    sessions: Sessions,
    stop: IntArray,
    config: ReflectionConfig,
) -> tuple[FloatArray, FloatArray]:
    """Offsets (session,) of the departures, relative to their mean, and their covariance by all objects together.

    A point cannot tell a turn from a size, so points are taken as small circles.
    """
    free = [_free_to_turn(data, sessions, stop, config) for data in (bounces, los)]
    members = [
        BundleObject("wall" if each.kind == "wall" else "circle", free[0].take("path", each.paths))
        for each in objects
    ]
    bundle = fit_bundle(members, free[1], config)
    n = len(bundle.offset) - N_COMMON
    # A turn of all of them together moves no path against another: what counts is each against their mean.
    apart = np.eye(n) - 1 / n
    covariance = apart @ bundle.offset_covariance[N_COMMON:, N_COMMON:] @ apart
    return apart @ bundle.offset[N_COMMON:], covariance


def _segmented(seen: IntArray, turn_rad: FloatArray, std_rad: FloatArray, stop: IntArray) -> Sessions:
    """Sessions of stops by the turns (n,) of those `seen` (n,), in order."""
    first, offset = segment_offsets(turn_rad, std_rad, min_length=MIN_SESSION_STOPS, min_gain=MIN_GAIN_NAT)
    of_stop = np.searchsorted(seen[first[1:]], stop, side="right")
    information = np.add.reduceat(std_rad**-2.0, first)
    return _anchored(Sessions(np.asarray(of_stop, dtype=np.int64), offset, information**-0.5))


def _anchored(sessions: Sessions) -> Sessions:
    """Offsets relative to the longest session, which no measurement can turn."""
    anchor = int(np.argmax(np.bincount(sessions.of_stop, minlength=len(sessions.offset_rad))))
    std = np.hypot(sessions.std_rad, sessions.std_rad[anchor])
    std[anchor] = 0.0
    return sessions._replace(offset_rad=sessions.offset_rad - sessions.offset_rad[anchor], std_rad=std)


def _scatter(deviation: FloatArray) -> float:
    """Standard deviation of deviations (n,) from one to the next, which jumps do not raise, inside its limits."""
    median = float(np.median(np.abs(np.diff(deviation))))
    return float(np.clip(median / (_NORMAL_MEDIAN * np.sqrt(2)), _LEAST_SCATTER, 1.0))


def _free_to_turn(
    data: Reflections, sessions: Sessions, stop: IntArray, config: ReflectionConfig
) -> Reflections:
    """Paths of sessions whose poses are free to turn about the TX by what an error of its heading turns them."""
    lever, variance = _turning(data), np.deg2rad(config.aod_offset_std_deg) ** 2
    freed = data.rx_covariance + variance * lever[:, :, None] * lever[:, None, :]
    return replace(data, rx_covariance=freed, session=sessions.of_stop[rows_of(data, stop)])


def _turning(data: Reflections) -> FloatArray:
    """Derivative (path, 4) of the RX states by a turn about the TX."""
    away = data.rx_state[:, :2] - data.tx[:, :2]
    return np.column_stack([-away[:, 1], away[:, 0], np.ones(len(data)), np.zeros(len(data))])
