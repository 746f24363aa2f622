"""Sessions of a campaign: groups of successive stops between which the heading offset of the TX jumps.

At given poses the lines of sight show the offsets. In poses that SLAM found stop by stop the offset is
unobservable: an error of the TX heading rotates everything at a stop about the TX, its receiver included.
Objects that several stops see show it: a stop that is rotated against the others does not fit them.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimation.laws.plane import bounce_jacobian_rx, predict_los, residual
from estimation.shape.config import ReflectionConfig
from estimation.shape.reflection.bundle import NORMAL_MEDIAN, BundleObject, fit_bundle
from estimation.shape.reflection.objects import FoundObject
from estimation.shape.reflection.reflections import Reflections, ray_points
from estimation.shape.reflection.search import N_COMMON
from estimation.slam.walk.sessions import segment_offsets
from scenes.pose import Pose
from scenes.record import FloatArray, IntArray

MIN_SESSION_STOPS = 3
MIN_GAIN_NAT = 8.0  # least gain of log likelihood that makes a jump
_MAX_GROUPS = 60  # of stops with an offset each
_LEAST_SCATTER = 0.25  # stated standard deviations may be too large by the inverse of this at most


class Sessions(NamedTuple):
    """Sessions with the offsets of their departures relative to the longest one."""

    of_stop: IntArray  # (stop,) session of every stop
    offset_rad: FloatArray  # (session,)
    std_rad: FloatArray  # (session,)

    def of_paths(self, data: Reflections, stop: IntArray) -> FloatArray:
        """Offset (path,) of each path; `stop` (stop,) are the stops of `of_stop`."""
        return np.asarray(self.offset_rad[self.of_stop[stop_rows(data, stop)]])


def one_session(stop: IntArray) -> Sessions:
    """All stops (stop,) in one session."""
    return Sessions(np.zeros(len(stop), dtype=np.int64), np.zeros(1), np.zeros(1))


def stop_rows(data: Reflections, stop: IntArray) -> IntArray:
    """Row (path,) in `stop` (stop,) of the stop of each path."""
    row = {number: k for k, number in enumerate(stop.tolist())}
    return np.array([row[number] for number in data.stop.tolist()], dtype=np.int64)


def los_sessions(los: Reflections, tx_pose: Pose, stop: IntArray) -> Sessions:
    """Sessions from the departures of the lines of sight; one session where there are too few."""
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
    objects: list[FoundObject], bounces: Reflections, los: Reflections, stop: IntArray, config: ReflectionConfig
) -> Sessions:
    """Sessions from the rotation about the TX with which every stop (stop,) agrees with the others on the objects.

    Paths are those of SLAM; the objects are those of the paths `with_heading_error`. All objects, states and
    offsets are estimated together: first with an offset per stop, or per group of stops in a long campaign,
    which shows where the heading jumps; then with one per session. Errors of neighbouring stops are correlated,
    so a jump must also exceed the errors of the offsets of the sessions.
    """
    group = np.arange(len(stop)) * min(_MAX_GROUPS, len(stop)) // max(len(stop), 1)
    used = np.concatenate([np.zeros(0, dtype=np.int64), *(each.paths for each in objects)])
    seen = np.unique(group[stop_rows(bounces, stop)[used]])
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
    objects: list[FoundObject],
    bounces: Reflections,
    los: Reflections,
    sessions: Sessions,
    stop: IntArray,
    config: ReflectionConfig,
) -> Sessions:
    """The same sessions; the objects found after the rotation correct the offsets. Paths are those of SLAM."""
    turned = [rotated_about_tx(data, sessions.of_paths(data, stop)) for data in (bounces, los)]
    change, covariance = _solved(objects, turned[0], turned[1], sessions, stop, config)
    if len(change) < len(sessions.offset_rad):
        return sessions
    std = np.sqrt(np.diagonal(covariance))
    return _anchored(Sessions(sessions.of_stop, sessions.offset_rad + change, std))


def with_heading_error(data: Reflections, config: ReflectionConfig) -> Reflections:
    """Paths whose covariances include an error of the TX heading, with the prior variance of the departure offset.

    The error rotates departure and receiver together: at fixed objects it affects one combination of the three
    measurements.
    """
    by_rx = bounce_jacobian_rx(data.tx, data.rx_state, ray_points(data)[0])
    slope = np.einsum("nai,ni->na", by_rx, _by_rotation(data))
    slope[:, 1] -= 1.0
    variance = np.deg2rad(config.aod_offset_std_deg) ** 2
    return replace(data, covariance=data.covariance + variance * slope[:, :, None] * slope[:, None, :])


def rotated_about_tx(data: Reflections, offset_rad: FloatArray) -> Reflections:
    """Paths and poses of SLAM, corrected for an error (path,) of the TX heading."""
    cosine, sine = np.cos(offset_rad), np.sin(offset_rad)
    turn = np.zeros((len(data), 4, 4))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = cosine, sine, -sine, cosine
    turn[:, 2, 2], turn[:, 3, 3] = 1.0, 1.0
    state, measured = data.rx_state.copy(), data.measured.copy()
    state[:, :2] = data.tx[:, :2] + np.einsum("nij,nj->ni", turn[:, :2, :2], data.rx_state[:, :2] - data.tx[:, :2])
    state[:, 2] -= offset_rad
    measured[:, 1] -= offset_rad
    covariance = turn @ data.rx_covariance @ np.swapaxes(turn, 1, 2)
    return replace(data, measured=measured, rx_state=state, rx_covariance=covariance)


def _solved(
    objects: list[FoundObject],
    bounces: Reflections,
    los: Reflections,
    sessions: Sessions,
    stop: IntArray,
    config: ReflectionConfig,
) -> tuple[FloatArray, FloatArray]:
    """Offsets (session,) of the departures, relative to their mean, and their covariance.

    Edges are fitted as circles, because a point would turn the size of an object into a rotation.
    """
    free = [_free_to_rotate(data, sessions, stop, config) for data in (bounces, los)]
    members = [
        BundleObject("wall" if each.kind == "wall" else "circle", free[0].take("path", each.paths))
        for each in objects
    ]
    bundle = fit_bundle(members, free[1], config)
    n = len(bundle.offset) - N_COMMON
    # A common rotation of all sessions is unobservable: only the differences from the mean count.
    centred = np.eye(n) - 1 / n
    covariance = centred @ bundle.offset_covariance[N_COMMON:, N_COMMON:] @ centred
    return centred @ bundle.offset[N_COMMON:], covariance


def _segmented(seen: IntArray, turn_rad: FloatArray, std_rad: FloatArray, stop: IntArray) -> Sessions:
    """Sessions of stops from the rotations (n,) of those `seen` (n,), in order."""
    first, offset = segment_offsets(turn_rad, std_rad, min_length=MIN_SESSION_STOPS, min_gain=MIN_GAIN_NAT)
    of_stop = np.searchsorted(seen[first[1:]], stop, side="right")
    information = np.add.reduceat(std_rad**-2.0, first)
    return _anchored(Sessions(np.asarray(of_stop, dtype=np.int64), offset, information**-0.5))


def _anchored(sessions: Sessions) -> Sessions:
    """Offsets relative to the longest session, since a common rotation is unobservable."""
    anchor = int(np.argmax(np.bincount(sessions.of_stop, minlength=len(sessions.offset_rad))))
    std = np.hypot(sessions.std_rad, sessions.std_rad[anchor])
    std[anchor] = 0.0
    return sessions._replace(offset_rad=sessions.offset_rad - sessions.offset_rad[anchor], std_rad=std)


def _scatter(deviation: FloatArray) -> float:
    """Robust standard deviation of the deviations (n,) from their successive differences, within limits.

    Jumps between sessions hardly affect it.
    """
    median = float(np.median(np.abs(np.diff(deviation))))
    return float(np.clip(median / (NORMAL_MEDIAN * np.sqrt(2)), _LEAST_SCATTER, 1.0))


def _free_to_rotate(
    data: Reflections, sessions: Sessions, stop: IntArray, config: ReflectionConfig
) -> Reflections:
    """Paths in their sessions; the poses may rotate about the TX as an error of its heading rotates them."""
    lever, variance = _by_rotation(data), np.deg2rad(config.aod_offset_std_deg) ** 2
    freed = data.rx_covariance + variance * lever[:, :, None] * lever[:, None, :]
    return replace(data, rx_covariance=freed, session=sessions.of_stop[stop_rows(data, stop)])


def _by_rotation(data: Reflections) -> FloatArray:
    """Derivative (path, 4) of the RX states by a rotation about the TX."""
    away = data.rx_state[:, :2] - data.tx[:, :2]
    return np.column_stack([-away[:, 1], away[:, 0], np.ones(len(data)), np.zeros(len(data))])
